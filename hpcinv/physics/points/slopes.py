"""Derivatives of graphs of scalar operations, which are nodes of the same graph.

Source: Griewank & Walther, *Evaluating Derivatives*, 2008, ch. 3, doi:10.1137/1.9780898717761.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hpcinv.physics.points.scalar_graph import Node, NotAnalytic, ScalarGraph


def slopes(graph: ScalarGraph, outputs: Sequence[Node], seeds: Mapping[Node, Node]) -> list[Node | None]:
    """Return the derivatives of nodes along a direction, ``None`` where they vanish.

    Args:
        seeds: derivatives of the leaves along that direction; for other leaves they vanish.
    """
    known: dict[Node, Node] = dict(seeds)
    for node in graph.needed_values(outputs):
        if node not in seeds and (slope := _slope(graph, node, known)) is not None:
            known[node] = slope
    return [known.get(output) for output in outputs]


def _slope(graph: ScalarGraph, node: Node, known: Mapping[Node, Node]) -> Node | None:
    match graph.operations[node]:
        case ("add", a, b):
            return _sum(graph, known.get(a), known.get(b))
        case ("multiply", a, b):
            left = graph.multiply(known[a], b) if a in known else None
            return _sum(graph, left, graph.multiply(a, known[b]) if b in known else None)
        case ("divide", a, b):
            minus = graph.multiply(graph.number(-1.0), graph.multiply(node, known[b])) if b in known else None
            rest = _sum(graph, known.get(a), minus)
            return None if rest is None else graph.divide(rest, b)
        case ("power", a, n) if a in known:
            lower = graph.power(a, graph.add(n, graph.number(-1.0)))
            return graph.multiply(graph.multiply(n, lower), known[a])
        case ("integral", _, x, derivative) if x in known:
            return graph.multiply(derivative, known[x])
        case ("abs", x) if x in known:
            return graph.multiply(graph.sign(x), known[x])
        case ("select", condition, a, b) if a in known or b in known:
            zero = graph.number(0.0)
            return graph.select(condition, known.get(a, zero), known.get(b, zero))
        case ("choose", x, bound, a, b, _) if a in known or b in known:
            zero = graph.number(0.0)
            return graph.by_size(x, bound, known.get(a, zero), known.get(b, zero))
    return None


def _sum(graph: ScalarGraph, a: Node | None, b: Node | None) -> Node | None:
    if a is None or b is None:
        return b if a is None else a
    return graph.add(a, b)


def coefficients(graph: ScalarGraph, root: Node, factor: Node, linear: Sequence[Node]) -> list[Node | None]:
    """Return the coefficients of leaves in ``factor * root``, which must be linear in them; ``None`` where they vanish.

    They are accumulated in reverse, from the root to the leaves.

    Raises:
        NotAnalytic: it is not linear in them.
    """
    depending = set(linear)
    order = graph.needed_values([root])
    for node in order:
        if any(argument in depending for argument in graph.value_arguments(node)):
            depending.add(node)
    if root not in depending:
        return [None] * len(linear)
    adjoints: dict[Node, Node] = {root: factor}

    def share(node: Node, adjoint: Node) -> None:
        if node in depending:
            adjoints[node] = graph.add(adjoints[node], adjoint) if node in adjoints else adjoint

    for node in reversed(order):
        if node not in adjoints or node in linear:
            continue
        adjoint = adjoints.pop(node)
        match graph.operations[node]:
            case ("add", a, b):
                share(a, adjoint)
                share(b, adjoint)
            case ("multiply", a, b) if not (a in depending and b in depending):
                factor_node, part = (b, a) if a in depending else (a, b)
                share(part, graph.multiply(adjoint, factor_node))
            case ("divide", a, b) if b not in depending:
                share(a, graph.divide(adjoint, b))
            case ("select", condition, a, b) if condition not in depending:
                zero = graph.number(0.0)
                share(a, graph.select(condition, adjoint, zero))
                share(b, graph.select(condition, zero, adjoint))
            case ("choose", x, bound, a, b, _) if x not in depending:
                zero = graph.number(0.0)
                share(a, graph.by_size(x, bound, adjoint, zero))
                share(b, graph.by_size(x, bound, zero, adjoint))
            case operation:
                raise NotAnalytic(f"it is not linear in a test or trial function: '{operation[0]}' of it")
    return [adjoints.get(leaf) for leaf in linear]
