"""Programs of the integrands of a form, and of expressions.

An integrand of rank 1 is a sum of test functions, and derivatives of them, times their duals. One of rank 2 also has
their derivatives by the unknown, or their coefficients of the trial function: the moduli. Both are derived in the graph
of the integrand (`hpcinv.physics.points.slopes`), the same for every law.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from ufl.algorithms.analysis import extract_arguments
from ufl.classes import Argument, CoefficientDerivative

from hpcinv.physics.points.point_scalars import PointScalars
from hpcinv.physics.points.program import Integers, Program, code_of
from hpcinv.physics.points.scalar_graph import Node, NotAnalytic, ScalarGraph
from hpcinv.physics.points.slopes import coefficients, gradient, slopes
from hpcinv.physics.points.tables import Tables

_DIRECTIONS = (-1, 0, 1, 2)  # value, and derivatives by reference coordinates


class Sources:
    """Where the nodal values and constants of a form are, which its programs share.

    Args:
        functions, constants: all of the form, in UFL's order.
    """

    def __init__(self, functions: Sequence[Any], constants: Sequence[Any]) -> None:
        self._functions, self.used = list(functions), list[int]()
        sizes = [math.prod(c.ufl_shape) for c in constants]
        starts = np.cumsum([0, *sizes[:-1]]).tolist() if sizes else []
        self._starts = dict(zip(constants, starts, strict=True))
        self._offset = 0
        self._offsets: dict[Any, int] = {}

    def offset(self, f: Any) -> int:
        """Return where the nodal values of a function begin; they come in the order of first use."""
        if f not in self._offsets:
            self.used.append(self._functions.index(f))
            self._offsets[f] = self._offset
            self._offset += f.ufl_element().dim
        return self._offsets[f]

    def constant(self, c: Any, component: int) -> int:
        return int(self._starts[c]) + component

    def number(self, f: Any) -> int:
        """Return the number of a function among the used ones."""
        return self.used.index(self._functions.index(f))


@dataclass(frozen=True)
class Slot:
    """A component of a test or trial function, or one of its derivatives by reference coordinates."""

    argument: Any
    component: int
    direction: int


class Integrand:
    """A program that is made of an integrand, with the functions that it takes.

    Raises:
        NotAnalytic: on an expression that programs do not have; the message names the reason.
    """

    def __init__(self, mesh: Any, tables: Tables, sources: Sources, graph: ScalarGraph | None = None) -> None:
        self._mesh, self._tables, self._sources = mesh, tables, sources
        self._graph = graph or ScalarGraph()
        self._gathers: list[tuple[int, ...]] = []
        self._bases: list[tuple[int, ...]] = []
        self.functions = set[Any]()

    def expression(self, expression: Any) -> Program:
        """Return the program of all components of an expression."""
        if extract_arguments(expression):
            raise NotAnalytic("it has an argument")
        return self.values(PointScalars(self._graph).of(expression))

    def values(self, nodes: Sequence[Node]) -> Program:
        """Return the program of the values of some nodes at points."""
        return self._program([(node, number, -1) for number, node in enumerate(nodes)], rank=-1, width=len(nodes))

    def form(self, integrand: Any, measure: str, rank: int) -> Program:
        """Return the program of an integrand over cells (``measure`` is ``volume``) or facets (``area``).

        If it is a derivative by one function, its integrand is made, and differentiated in its graph.
        """
        graph = self._graph
        integrand, unknown, step = _undifferentiated(integrand)
        scalars = PointScalars(graph, () if unknown is None else (unknown,))
        (root,) = scalars.of(integrand)
        found = set(graph.needed_values([root]))
        arguments = {argument.number(): argument for argument in extract_arguments(integrand)}
        if isinstance(step, Argument):
            arguments[step.number()] = step
        scale = graph.multiply(scalars.volume if measure == "volume" else scalars.area, graph.input(("weight",)))
        if rank == 1 and isinstance(step, Argument):
            slots = self._slots(scalars, unknown, found)
            return self._slopes_of_number(graph.multiply(scale, root), slots, step)
        rows = self._duals(scalars, root, scale, arguments.get(0), found)
        if rank == 2:
            places = self._slots(scalars, arguments[1] if unknown is None else unknown, found)
            return self._moduli(rows, places, arguments[1])
        if unknown is not None:
            places = self._slots(scalars, unknown, found)
            direction = {node: scalars.function(step, slot.component, slot.direction) for node, slot in places.items()}
            rows = _present(rows, slopes(graph, list(rows.values()), direction))
        return self._program([(dual, self._basis(slot), -1) for slot, dual in rows.items()], rank=rank)

    def _slopes_of_number(self, number: Node, places: Mapping[Node, Slot], test: Any) -> Program:
        """Return the program of the derivative of a number by an unknown, along a test function."""
        duals = gradient(self._graph, number, list(places))
        slots = [Slot(test, slot.component, slot.direction) for slot in places.values()]
        results = [(dual, self._basis(slot), -1) for slot, dual in _present(slots, duals).items()]
        return self._program(results, rank=1)

    def moduli(
        self, integrand: Any, test: Any, trial: Any, blocks: Sequence[Sequence[tuple[int, int]]]
    ) -> tuple[Program, list[tuple[int, int]]]:
        """Return the program of the moduli of an integrand, times the volume of the cell per volume of reference.

        Args:
            trial: the unknown by which the duals are differentiated, or the trial function of a bilinear integrand.
            blocks: components and directions of test and trial function, which are in one space.

        Returns:
            Program, and pairs of blocks of test and trial function. The values of each pair are in the order of the
            block of the test, then of the trial function.
        """
        graph = self._graph
        scalars = PointScalars(graph, () if isinstance(trial, Argument) else (trial,))
        (root,) = scalars.of(integrand)
        found = set(graph.needed_values([root]))
        duals = self._duals(scalars, root, scalars.volume, test, found)
        rows = {(slot.component, slot.direction): dual for slot, dual in duals.items()}
        columns = {
            (slot.component, slot.direction): _present(
                rows, slopes(graph, list(rows.values()), {node: graph.number(1.0)})
            )
            for node, slot in self._slots(scalars, trial, found).items()
        }
        pairs, outputs = list[tuple[int, int]](), list[Node]()
        for (i, row_block), (j, column_block) in product(enumerate(blocks), repeat=2):
            entries = [columns.get(column, {}).get(row) for row in row_block for column in column_block]
            if any(entry is not None for entry in entries):
                pairs.append((i, j))
                outputs += [graph.number(0.0) if entry is None else entry for entry in entries]
        return self.values(outputs), pairs

    def _duals(self, scalars: PointScalars, root: Node, scale: Node, test: Any, found: set[Node]) -> dict[Any, Node]:
        """Return the duals of a test function by its slots; the scaled integrand itself without one."""
        if test is None:
            return {None: self._graph.multiply(scale, root)}
        tests = self._slots(scalars, test, found)
        return _present(tests.values(), coefficients(self._graph, root, scale, list(tests)))

    def _moduli(self, rows: Mapping[Any, Node], places: Mapping[Node, Slot], trial: Any) -> Program:
        """Return the program of the slopes of duals by the slots of the unknown, or of the trial function."""
        results, columns = dict[Any, list[tuple[Node, int]]](), self._columns(trial)
        for node, slot in places.items():
            place = columns(slot)
            changes = slopes(self._graph, list(rows.values()), {node: self._graph.number(1.0)})
            for row, modulus in _present(rows, changes).items():
                results.setdefault(row, []).append((modulus, place))
        ordered = [(node, self._basis(row), place) for row, entries in results.items() for node, place in entries]
        return self._program(ordered, rank=2, trial=trial)

    def _slots(self, scalars: PointScalars, f: Any, found: set[Node]) -> dict[Node, Slot]:
        """Return the slots of a function or argument that an integrand has, by their nodes."""
        size = f.ufl_element().reference_value_size
        slots = (Slot(f, i, b) for i in range(size) for b in _DIRECTIONS)
        nodes = {scalars.function(f, slot.component, slot.direction): slot for slot in slots}
        return {node: slot for node, slot in nodes.items() if node in found}

    def _columns(self, trial: Any) -> Callable[[Slot], int]:
        """Return a function that gives the basis of a trial function, with places one component after the other."""
        starts, self._places = dict[int, int](), list[int]()
        for i in range(trial.ufl_element().reference_value_size):
            element, offset, stride = _component(trial.ufl_element(), i)
            starts[i] = len(self._places)
            self._places += [offset + stride * k for k in range(element.dim)]

        def basis(slot: Slot) -> int:
            element, _, _ = _component(trial.ufl_element(), slot.component)
            table, count = self._tables.functions(element, slot.direction)
            return self._listed(self._bases, (starts[slot.component], 1, count, table))

        return basis

    def _basis(self, slot: Slot | None) -> int:
        if slot is None:
            return -1
        element, offset, stride = _component(slot.argument.ufl_element(), slot.component)
        table, count = self._tables.functions(element, slot.direction)
        return self._listed(self._bases, (offset, stride, count, table))

    def _place(self, key: tuple[Any, ...]) -> tuple[str, int]:
        """Return operation and number of an input."""
        match key:
            case ("constant", c, component):
                return "constant", self._sources.constant(c, component)
            case ("weight",):
                return self._gather(2, 0, 0, 1, self._tables.weight)
            case ("normal", i):
                return self._gather(2, 0, 0, 1, self._tables.normal(i))
            case ("position", i, direction):
                element, _, _ = _component(self._mesh.ufl_coordinate_element(), i)
                table, count = self._tables.functions(element, direction)
                return self._gather(1, i, 3, count, table)
            case ("function", f, component, direction):
                self.functions.add(f)
                element, offset, stride = _component(f.ufl_element(), component)
                table, count = self._tables.functions(element, direction)
                return self._gather(0, self._sources.offset(f) + offset, stride, count, table)
        raise NotAnalytic(f"it has {key[0]}")

    def _gather(self, *entry: int) -> tuple[str, int]:
        return "gather", self._listed(self._gathers, entry)

    @staticmethod
    def _listed(entries: list[tuple[int, ...]], entry: tuple[int, ...]) -> int:
        if entry not in entries:
            entries.append(entry)
        return entries.index(entry)

    def _program(
        self, results: Sequence[tuple[Node, int, int]], rank: int, width: int = 0, trial: Any = None
    ) -> Program:
        code = code_of(self._graph, [node for node, _, _ in results], self._place)
        tables, entity_size = self._tables.array()
        places = self._places if trial is not None else []
        outputs = [(slot, row, column) for slot, (_, row, column) in zip(code.outputs, results, strict=True)]
        return Program(
            self._tables.lanes,
            self._tables.blocks,
            self._tables.count,
            rank,
            width,
            len(places),
            code.slots,
            entity_size,
            code.rows,
            code.numbers,
            _table(self._gathers, 5),
            _table(self._bases, 4),
            _table(outputs, 3),
            tables,
            np.array(places, dtype=np.int32),
        )


def _table(rows: Sequence[tuple[int, ...]], columns: int) -> Integers:
    return np.array(rows, dtype=np.int32).reshape(-1, columns)


def _present(keys: Iterable[Any], nodes: Sequence[Node | None]) -> dict[Any, Node]:
    """Return the nodes that do not vanish, by their keys."""
    return {key: node for key, node in zip(keys, nodes, strict=True) if node is not None}


def _undifferentiated(integrand: Any) -> tuple[Any, Any, Any]:
    """Return what an integrand differentiates, the differentiating function, and the direction.

    The last two are ``None`` for an integrand that is not such a derivative, or one by several functions at once.
    """
    if isinstance(integrand, CoefficientDerivative):
        whole, unknowns, directions, others = integrand.ufl_operands
        pairs = [*zip(unknowns.ufl_operands, directions.ufl_operands, strict=True)]
        if len(pairs) == 1 and not others.ufl_operands:
            ((unknown, direction),) = pairs
            if direction.ufl_function_space() == unknown.ufl_function_space():
                return whole, unknown, direction
    return integrand, None, None


def _component(element: Any, component: int) -> tuple[Any, int, int]:
    """Return the scalar element of a component, and offset and stride of its values among the element's."""
    if element.reference_value_size == 1 and element.block_size == 1 and str(element.pullback) == "IdentityPullback()":
        return element, 0, 1
    if element.block_size > 1 and not element.is_symmetric:
        inner, offset, stride = _component(element.sub_elements[0], 0)
        return inner, element.block_size * offset + component, element.block_size * stride
    offset, parts = 0, element.sub_elements if element.is_mixed else ()
    for part in parts:
        if component < part.reference_value_size:
            inner, inner_offset, stride = _component(part, component)
            return inner, offset + inner_offset, stride
        component, offset = component - part.reference_value_size, offset + part.dim
    raise NotAnalytic(f"it has the element {element}")
