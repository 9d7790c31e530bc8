"""Derivatives of graphs of scalar operations, which are nodes of the same graph.

Source: Griewank & Walther, *Evaluating Derivatives*, 2008, ch. 3, doi:10.1137/1.9780898717761.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

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

    Raises:
        NotAnalytic: it is not linear in them.
    """
    depending = _depending(graph, root, linear)
    for node in sorted(depending.difference(linear)):
        if not _is_linear(graph.operations[node], depending):
            name = graph.operations[node][0]
            raise NotAnalytic(f"it is not linear in a test or trial function: '{name}' of it")
    return _accumulated(graph, root, factor, linear, depending)


def gradient(graph: ScalarGraph, number: Node, leaves: Sequence[Node]) -> list[Node | None]:
    """Return the derivatives of a number by each of the leaves; ``None`` where they vanish.

    Their program has a few times the operations of the number, however many leaves there are.
    """
    return _accumulated(graph, number, graph.number(1.0), leaves, _depending(graph, number, leaves))


def _depending(graph: ScalarGraph, root: Node, leaves: Sequence[Node]) -> set[Node]:
    """Return the leaves, and the nodes of the root that depend on them."""
    depending = set(leaves)
    for node in graph.needed_values([root]):
        if any(argument in depending for argument in graph.value_arguments(node)):
            depending.add(node)
    return depending


def _is_linear(operation: tuple[Any, ...], depending: set[Node]) -> bool:
    """Return whether an operation is linear in its arguments that depend on the leaves."""
    match operation:
        case ("add", _, _):
            return True
        case ("multiply", a, b):
            return not (a in depending and b in depending)
        case ("divide", _, b):
            return b not in depending
        case ("select", condition, _, _):
            return condition not in depending
        case ("choose", x, _, _, _, _):
            return x not in depending
    return False


def _accumulated(
    graph: ScalarGraph, root: Node, factor: Node, leaves: Sequence[Node], depending: set[Node]
) -> list[Node | None]:
    """Return the derivatives of ``factor * root`` by the leaves, accumulated in reverse from the root."""
    adjoints: dict[Node, Node] = {root: factor} if root in depending else {}
    for node in reversed(graph.needed_values([root])):
        if node not in adjoints or node in leaves:
            continue
        adjoint = adjoints.pop(node)
        for argument, share in _shares(graph, node, adjoint, depending):
            adjoints[argument] = graph.add(adjoints[argument], share) if argument in adjoints else share
    return [adjoints.get(leaf) for leaf in leaves]


def _shares(graph: ScalarGraph, node: Node, adjoint: Node, depending: set[Node]) -> Iterator[tuple[Node, Node]]:
    """Yield what the adjoint of a node adds to the adjoints of its arguments, of those that depend on the leaves."""
    for argument, slope in _partial_slopes(graph, node, adjoint):
        if argument in depending:
            yield argument, slope()


def _partial_slopes(graph: ScalarGraph, node: Node, adjoint: Node) -> Iterator[tuple[Node, Callable[[], Node]]]:
    """Yield each argument of a node with the adjoint times the derivative by it, to be made on demand."""
    zero = graph.number(0.0)
    match graph.operations[node]:
        case ("add", a, b):
            yield a, lambda: adjoint
            yield b, lambda: adjoint
        case ("multiply", a, b):
            yield a, lambda: graph.multiply(adjoint, b)
            yield b, lambda: graph.multiply(adjoint, a)
        case ("divide", a, b):
            yield a, lambda: graph.divide(adjoint, b)
            yield b, lambda: graph.multiply(graph.number(-1.0), graph.divide(graph.multiply(adjoint, node), b))
        case ("power", a, n):
            lower = graph.power(a, graph.add(n, graph.number(-1.0)))
            yield a, lambda: graph.multiply(adjoint, graph.multiply(n, lower))
        case ("integral", _, x, derivative):
            yield x, lambda: graph.multiply(adjoint, derivative)
        case ("abs", x):
            yield x, lambda: graph.multiply(adjoint, graph.sign(x))
        case ("select", condition, a, b):
            yield a, lambda: graph.select(condition, adjoint, zero)
            yield b, lambda: graph.select(condition, zero, adjoint)
        case ("choose", x, bound, a, b, _):
            yield a, lambda: graph.by_size(x, bound, adjoint, zero)
            yield b, lambda: graph.by_size(x, bound, zero, adjoint)
