"""Programs: graphs of scalar operations as numbers, which `interpreter.c` runs over blocks of points.

A program is data. It is checked before use: operations, slots, bounds of tables and places.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from hpcinv.physics.points.scalar_graph import Node, NotAnalytic, ScalarGraph

type Integers = npt.NDArray[np.int32]
type Doubles = npt.NDArray[np.float64]
type Place = tuple[str, int]
"""kind of an integral, and its number among the form's integrals of this kind"""
EXPRESSION: Place = "expression", 0

OPERATIONS = (
    *("gather", "constant", "number", "add", "subtract", "multiply", "divide", "multiply_add", "subtract_product"),
    *("scale", "shift", "negate", "<", "<=", "==", "select", "abs", "sign", "sqrt", "power"),
    *("exp", "ln", "sin", "cos", "tan", "sinh", "cosh", "tanh", "asin", "acos", "atan", "erf"),
)
"""in the order of the interpreter"""
_CODES = {name: code for code, name in enumerate(OPERATIONS)}
_INDEXED = ("gather", "constant", "number")
_WITH_NUMBER = ("scale", "shift")
_BLOCKS = (4, 8, 16)
"""points that the interpreter does at once"""


def lanes_of(points: int) -> int:
    """Return the size of the blocks in which a number of points is done."""
    return next((lanes for lanes in _BLOCKS if points <= lanes), _BLOCKS[-1])


@dataclass(frozen=True)
class Code:
    """Operations of a graph.

    Attributes:
        rows: operation, three arguments, result (n, 5); a result is a slot, an argument a slot or a number of an input.
        numbers: the literals.
        slots: number of slots.
        outputs: slots of the outputs.
    """

    rows: Integers
    numbers: Doubles
    slots: int
    outputs: list[int]


def code_of(graph: ScalarGraph, outputs: Sequence[Node], place: Callable[[Any], tuple[str, int]]) -> Code:
    """Return the operations for some nodes, with slots that are used again after their last use.

    Args:
        place: operation, ``gather`` or ``constant``, and number of an input or leaf.
    """
    return _Coder(graph, outputs, place).code()


class _Coder:
    def __init__(self, graph: ScalarGraph, outputs: Sequence[Node], place: Callable[[Any], tuple[str, int]]) -> None:
        self._graph, self._outputs, self._place = graph, outputs, place
        self._numbers: dict[float, int] = {}
        nodes = graph.needed_values(outputs)
        self._uses = Counter([*outputs, *(a for node in nodes for a in graph.value_arguments(node))])
        self._lowered: dict[Node, tuple[Any, ...]] = {}
        wanted = set(outputs)
        for node in reversed(nodes):  # only what is still wanted after products became parts of sums
            if node in wanted:
                self._lowered[node] = lowered = self._lower(node)
                wanted.update(self._slots_of(lowered))

    def code(self) -> Code:
        order = sorted(self._lowered)
        last = {a: node for node in order for a in self._slots_of(self._lowered[node])}
        last |= dict.fromkeys(self._outputs, -1)
        slot, free, rows, size = dict[Node, int](), list[int](), list[tuple[int, ...]](), 0
        for node in order:
            name, *arguments = self._lowered[node]
            nodes = self._slots_of(self._lowered[node])
            given = list(arguments) if name in _INDEXED else [slot[a] for a in nodes]
            if name in _WITH_NUMBER:
                given.append(arguments[1])
            if not free:
                free.append(size)
                size += 1
            slot[node] = free.pop()
            rows.append((_CODES[name], *given, *(3 - len(given)) * [0], slot[node]))
            free.extend({slot[a] for a in nodes if last[a] == node})
        table = np.array(rows, dtype=np.int32).reshape(-1, 5)
        numbers = np.array(list(self._numbers) or [0.0])
        return Code(table, numbers, size, [slot[output] for output in self._outputs])

    def _slots_of(self, lowered: tuple[Any, ...]) -> tuple[Node, ...]:
        name, *arguments = lowered
        if name in _INDEXED:
            return ()
        return tuple(arguments[:1] if name in _WITH_NUMBER else arguments)

    def _number(self, value: float) -> int:
        return self._numbers.setdefault(value, len(self._numbers))

    def _value(self, node: Node) -> float | None:
        operation = self._graph.operations[node]
        return operation[1] if operation[0] == "number" else None

    def _lower(self, node: Node) -> tuple[Any, ...]:
        graph = self._graph
        match graph.operations[node]:
            case ("leaf" | "input", number):
                return self._place(graph.inputs[number] if graph.operations[node][0] == "input" else number)
            case ("number", value):
                return "number", self._number(value)
            case ("add", a, b):
                return self._sum(a, b)
            case ("multiply", a, b):
                for x, y in ((a, b), (b, a)):
                    if (value := self._value(x)) is not None:
                        return ("negate", y) if value == -1 else ("scale", y, self._number(value))
                return "multiply", a, b
            case ("divide", a, b):
                return "divide", a, b
            case ("power", a, n):
                return ("sqrt", a) if self._value(n) == 0.5 else ("power", a, n)
            case ("function" | "integral", name, x, *_) if name in _CODES:
                return name, x
            case ("compare", relation, a, b):
                return relation, a, b
            case ("select", condition, a, b):
                return "select", condition, a, b
            case ("choose", _, _, series, closed, _):
                return "select", graph.conditions[node], series, closed
            case ("abs" | "sign" as name, x):
                return name, x
        raise NotAnalytic(f"it has '{' '.join(map(str, graph.operations[node][:2]))}'")

    def _sum(self, a: Node, b: Node) -> tuple[Any, ...]:
        """Return a sum; a product that is used nowhere else becomes part of it."""
        for x, y in ((a, b), (b, a)):
            if (value := self._value(x)) is not None:
                return "shift", y, self._number(value)
        for x, y in ((b, a), (a, b)):
            operation, *factors = self._graph.operations[x]
            if operation != "multiply" or self._uses[x] > 1:
                continue
            values = [self._value(factor) for factor in factors]
            if -1.0 in values:
                (part,) = (factor for factor, value in zip(factors, values, strict=True) if value != -1)
                inner, *inner_factors = self._graph.operations[part]
                if inner == "multiply" and self._uses[part] == 1 and None is self._value(inner_factors[0]):
                    return "subtract_product", *inner_factors, y
                return "subtract", y, part
            if values == [None, None]:
                return "multiply_add", *factors, y
        return "add", a, b


@dataclass(frozen=True)
class Program:
    """An integrand at the points of one quadrature rule, or an expression at points.

    Attributes:
        lanes: number of points of a block, which are evaluated together.
        blocks: number of blocks of a cell.
        points: number of points of a cell.
        rank: of the form; -1 for an expression.
        width: components of an expression.
        columns: basis functions of the trial function.
        slots: number of slots.
        entity_size: numbers of the tables of one facet; 0 for cells.
        rows, numbers: operations (`Code`).
        gathers: source, offset, stride, count, table of nodal values (n, 5).
        bases: offset, stride, count, table of basis functions (n, 4).
        results: slot, row, column of the outputs (n, 3), row by row.
        tables: values of functions at the points (entities, functions, padded points).
        places: column of each basis function of the trial function.
    """

    lanes: int
    blocks: int
    points: int
    rank: int
    width: int
    columns: int
    slots: int
    entity_size: int
    rows: Integers
    numbers: Doubles
    gathers: Integers
    bases: Integers
    results: Integers
    tables: Doubles
    places: Integers

    def to_arrays(self, prefix: str) -> dict[str, npt.NDArray[Any]]:
        """Return the data as named arrays, for a file."""
        return {f"{prefix}{field.name}": np.asarray(getattr(self, field.name)) for field in fields(self)}

    @classmethod
    def from_arrays(cls, arrays: Any, prefix: str) -> Program:
        """Return the program of a file, which may not be changed; raise ``ValueError`` or ``KeyError`` for damage."""
        values: dict[str, Any] = {field.name: arrays[f"{prefix}{field.name}"] for field in fields(cls)}
        for value in values.values():
            value.flags.writeable = False
        values = {name: int(value) if value.ndim == 0 else value for name, value in values.items()}
        made = cls(**values)
        made.check()
        return made

    def check(self) -> None:
        """Raise ``ValueError`` if the interpreter would read or write outside the program's arrays."""
        rows, functions = self.rows, self.tables.shape[1]
        _check_bounds((rows[:, 0], len(OPERATIONS)), (rows[:, 4], self.slots))
        names = np.array(OPERATIONS)[rows[:, 0]]
        takes_slots, takes_number = ~np.isin(names, _INDEXED), np.isin(names, _WITH_NUMBER)
        _check_bounds(
            (rows[takes_slots, 1], self.slots),
            (rows[takes_slots & ~takes_number, 2:4], self.slots),
            (rows[takes_number, 2], len(self.numbers)),
            (rows[names == "number", 1], len(self.numbers)),
            (rows[names == "gather", 1], len(self.gathers)),
            (self.gathers[:, 4], functions),
            (self.gathers[:, 4] + self.gathers[:, 3] - 1, functions),
            (self.bases[:, 3], functions),
            (self.bases[:, 3] + self.bases[:, 2] - 1, functions),
            (self.results[:, 0], self.slots),
        )


def _check_bounds(*bounds: tuple[Integers, int]) -> None:
    """Raise ``ValueError`` if numbers are negative, or not below their bound."""
    if any(numbers.size and not 0 <= numbers.min() <= numbers.max() < bound for numbers, bound in bounds):
        raise ValueError("a program refers to what it does not have")
