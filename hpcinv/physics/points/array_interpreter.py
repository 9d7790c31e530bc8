"""NumPy's interpreter of programs, for machines without a C compiler: slower than `interpreter.c`, with its results.

Each operation is done for the points of hundreds of cells at once. DOLFINx calls a kernel cell by cell. So its
functions that assemble are replaced, once, by others that note for which cells they will call it. The first call
computes all cells of a chunk, and each call adds its cell's part. A cell that comes unexpectedly is computed alone.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache, wraps
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import cpp

from hpcinv.physics.points.program import EXPRESSION, OPERATIONS, Doubles, Place, Program

type _Values = Any
type _Ready = tuple[Doubles, bytes, int]
"""part of a cell, coordinates of its nodes as bytes, local number of its facet"""

_POINTS = 4096
"""points done at once: with fewer, the calls of NumPy take the time; with more, values leave the cache of a core"""
_FUNCTION = ctypes.CFUNCTYPE(None, *7 * (ctypes.c_void_p,))


def _sign(x: _Values) -> _Values:
    return np.greater(x, 0) * 1.0 - np.less(x, 0)


def _erf(x: _Values) -> _Values:
    from scipy.special import erf  # slow to import, and rarely needed

    return erf(x)


ELEMENTARY: Mapping[str, tuple[int, Callable[..., _Values]]] = {
    **{name: (2, f) for name, f in (("add", np.add), ("subtract", np.subtract), ("multiply", np.multiply))},
    **{name: (2, f) for name, f in (("divide", np.divide), ("power", np.power))},
    "<": (2, lambda a, b: np.less(a, b) * 1.0),
    "<=": (2, lambda a, b: np.less_equal(a, b) * 1.0),
    "==": (2, lambda a, b: np.equal(a, b) * 1.0),
    "multiply_add": (3, lambda a, b, c: a * b + c),
    "subtract_product": (3, lambda a, b, c: c - a * b),
    "select": (3, lambda condition, a, b: np.where(np.not_equal(condition, 0), a, b)),
    "negate": (1, np.negative),
    "abs": (1, np.abs),
    "sign": (1, _sign),
    "erf": (1, _erf),
    "ln": (1, np.log),
    **{name: (1, getattr(np, name)) for name in ("sqrt", "exp", "sin", "cos", "tan", "sinh", "cosh", "tanh")},
    **{name: (1, getattr(np, f"arc{name[1:]}")) for name in ("asin", "acos", "atan")},
}
"""operations on numbers: how many they take, and their function"""


class ArrayKernel:
    """Programs that together make an element's number, vector, matrix or the values of an expression.

    Attributes:
        address: of the function with the signature of a kernel that runs them.
        chunk: cells that are done at once.
        size: numbers of an element's vector or matrix.
        has_facets: whether they differ by the local number of a facet.
    """

    def __init__(self, programs: Sequence[Program], place: Place) -> None:
        _follow_assemblies()
        self._programs, self._place = [_Evaluation(program) for program in programs], place
        self.chunk = max(_POINTS // max(program.points for program in programs), 1)
        self.size = max(program.size for program in self._programs)
        self._numbers = ctypes.c_double * self.size
        self.has_facets = any(program.has_facets for program in self._programs)
        self._function = _FUNCTION(self._add)
        self.address = ctypes.cast(self._function, ctypes.c_void_p).value

    def evaluate(
        self, w: Doubles, constants: Doubles, x: Doubles, facets: npt.NDArray[np.int32] | None = None
    ) -> Doubles:
        """Return what the programs make of some cells (cells, `size`).

        Args:
            w: nodal values of the functions (cells, any number).
            x: coordinates of the nodes (cells, 3 nodes).
            facets: local numbers of the facets (cells,); ``None`` for cells.
        """
        results = np.zeros((len(x), self.size))
        facets = np.zeros(len(x), dtype=np.int32) if facets is None else facets
        for facet in np.unique(facets):
            chosen = np.flatnonzero(facets == facet)
            part = np.zeros((len(chosen), self.size))
            for program in self._programs:
                program.add(part, w[chosen], constants, x[chosen], int(facet))
            results[chosen] = part
        return results

    def _add(self, A: int, w: int, c: int, x: int, facet: int, _permutation: int, _data: int) -> None:
        """Add a cell's part at an address."""
        target = np.frombuffer(self._numbers.from_address(A))
        assembly = _assemblies[-1] if _assemblies else None
        if assembly is not None and assembly.fault is not None:
            return
        if self._place == EXPRESSION:
            target[:] = 0.0
        try:
            number = ctypes.c_int32.from_address(facet).value if self.has_facets else 0
            foreseen = None if assembly is None else assembly.next_part(self._place, self, w, x, number)
            target += self._of_cell(w, c, x, number) if foreseen is None else foreseen
        except BaseException as error:
            target[:] = np.nan
            if assembly is None:
                raise  # Python prints it
            assembly.fault = assembly.fault or error

    def _of_cell(self, w: int, c: int, x: int, facet: int) -> Doubles:
        """Return the part of one cell with data at addresses."""
        needs = [max(counts) for counts in zip(*(program.needs for program in self._programs), strict=True)]
        values, constants, nodes = (_doubles_at(a, n) for a, n in zip((w, c, x), needs, strict=True))
        (part,) = self.evaluate(values[None], constants, nodes[None], np.array([facet], dtype=np.int32))
        return np.asarray(part)


class _Evaluation:
    """A program as NumPy takes it.

    Attributes:
        size: numbers of an element's vector or matrix that it has.
        needs: least numbers of nodal values of functions, of constants, and of coordinates of nodes.
    """

    def __init__(self, program: Program) -> None:
        self._program, self.has_facets = program, bool(program.entity_size)
        self._tables = program.tables[..., : program.points]
        self._rows = [(OPERATIONS[row[0]], *row[1:]) for row in program.rows.tolist()]
        self._gathers, self._bases = program.gathers.tolist(), program.bases.tolist()
        self._results = program.results.tolist()
        ends = [(source, offset + stride * (count - 1) + 1) for source, offset, stride, count, _ in self._gathers]
        constants = [row[1] + 1 for row in self._rows if row[0] == "constant"]
        own, nodes = (max([end for source, end in ends if source == wanted], default=0) for wanted in (0, 1))
        self.needs = own, max(constants, default=0), nodes
        self.size = self._size()

    def _size(self) -> int:
        program = self._program
        if program.rank < 0:
            return program.points * program.width
        ends = [offset + stride * (count - 1) + 1 for offset, stride, count, _ in self._bases]
        rows = max((ends[row] for _, row, _ in self._results if row >= 0), default=1)
        return rows * (program.columns if program.rank == 2 else 1)

    def add(self, results: Doubles, w: Doubles, constants: Doubles, x: Doubles, facet: int) -> None:
        """Add what it makes of cells (cells, numbers of an element)."""
        program, tables = self._program, self._tables[facet if self.has_facets else 0]
        with np.errstate(all="ignore"):
            slots = self._run(w, constants, x, tables)
        shape = len(x), program.points
        outputs = [(np.broadcast_to(slots[slot], shape), row, column) for slot, row, column in self._results]
        if program.rank < 0:
            for values, row, _ in outputs:
                results[:, row : program.points * program.width : program.width] += values
        elif program.rank == 0:
            results[:, 0] += sum(values.sum(axis=1) for values, _, _ in outputs)
        elif program.rank == 1:
            for values, row, _ in outputs:
                places, table = self._basis(row, tables)
                results[:, places] += values @ table.T
        else:
            self._add_matrix(results[:, : self.size].reshape(len(x), -1, program.columns), outputs, tables)

    def _add_matrix(self, matrices: Doubles, outputs: Sequence[tuple[Doubles, int, int]], tables: Doubles) -> None:
        """Add moduli times basis functions of the trial, then of the test function."""
        for row in dict.fromkeys(row for _, row, _ in outputs):
            products = np.zeros((*outputs[0][0].shape, self._program.columns))
            for moduli, own_row, column in outputs:
                if own_row == row:
                    places, table = self._basis(column, tables)
                    products[..., places] += moduli[..., None] * table.T
            places, table = self._basis(row, tables)
            target = matrices[:, places]
            target[:, :, self._program.places] += table @ products

    def _basis(self, number: int, tables: Doubles) -> tuple[slice, Doubles]:
        offset, stride, count, table = self._bases[number]
        return slice(offset, offset + stride * (count - 1) + 1, stride), tables[table : table + count]

    def _run(self, w: Doubles, constants: Doubles, x: Doubles, tables: Doubles) -> list[_Values]:
        """Return the slots, each of which has numbers (cells, points) or one that they all have."""
        slots: list[_Values] = [0.0] * self._program.slots
        numbers = self._program.numbers
        for name, a, b, c, result in self._rows:
            if name in ELEMENTARY:
                count, function = ELEMENTARY[name]
                slots[result] = function(*(slots[argument] for argument in (a, b, c)[:count]))
            elif name == "scale":
                slots[result] = numbers[b] * slots[a]
            elif name == "shift":
                slots[result] = numbers[b] + slots[a]
            elif name == "gather":
                slots[result] = self._gathered(a, w, x, tables)
            else:
                slots[result] = (numbers if name == "number" else constants)[a]
        return slots

    def _gathered(self, number: int, w: Doubles, x: Doubles, tables: Doubles) -> Doubles:
        source, offset, stride, count, table = self._gathers[number]
        functions = tables[table : table + count]
        if source == 2:
            return np.asarray(functions[0])
        nodal = (x if source else w)[:, offset : offset + stride * (count - 1) + 1 : stride]
        return np.asarray(nodal @ functions)


class _Cells:
    """Cells for which one assembly calls a kernel, in this order.

    Args:
        w: nodal values of the functions (cells, any number).
        mesh: of DOLFINx in C++.
        entities: cells (n,), or cells and local facets (n, 2).
    """

    def __init__(self, w: Doubles, mesh: Any, entities: npt.NDArray[np.int32]) -> None:
        pairs = entities if entities.ndim == 2 else np.column_stack([entities, np.zeros_like(entities)])
        self._w = w if w.size else np.zeros((len(pairs), 0))  # DOLFINx has no rows where there are no functions
        self._cells, self._facets = pairs[:, 0], pairs[:, 1]
        self._nodes, self._dofs = mesh.geometry.x, mesh.geometry.dofmaps[0]
        self._address, self._step = self._w.ctypes.data, self._w.strides[0] if self._w.size else 0
        self._done = 0
        self._ready: list[_Ready] = []
        """cells of a chunk that are not yet called for, the next one last"""

    def next_part(self, kernel: ArrayKernel, constants: Doubles, w: int, x: int, facet: int) -> Doubles | None:
        """Return the part of the next cell; ``None`` if it is not the one that is computed at these addresses."""
        if not self._ready:
            self._evaluate(kernel, constants)
        if self._ready:
            part, nodes, own_facet = self._ready[-1]
            is_here = not self._step or w == self._address + self._done * self._step
            if is_here and facet == own_facet and ctypes.string_at(x, len(nodes)) == nodes:
                self._ready.pop()
                self._done += 1
                return part
        return None

    def _evaluate(self, kernel: ArrayKernel, constants: Doubles) -> None:
        """Make the next chunk of cells ready."""
        chosen = slice(self._done, self._done + kernel.chunk)
        cells, facets = self._cells[chosen], self._facets[chosen]
        x = self._nodes[self._dofs[cells]].reshape(len(cells), -1)
        parts = kernel.evaluate(self._w[chosen], constants, x, facets)
        self._ready = list(zip(parts, map(bytes, x), (facets * kernel.has_facets).tolist(), strict=True))[::-1]


@dataclass
class _Assembly:
    """Assembly of a form, or evaluation of an expression, that is under way."""

    constants: Doubles
    cells: Mapping[Place, _Cells]
    fault: BaseException | None = field(default=None)

    def next_part(self, place: Place, kernel: ArrayKernel, w: int, x: int, facet: int) -> Doubles | None:
        """Return a kernel's part of the next cell; ``None`` if that is not foreseen."""
        cells = self.cells.get(place)
        return None if cells is None else cells.next_part(kernel, self.constants, w, x, facet)


_assemblies: list[_Assembly] = []


@contextmanager
def _under_way(constants: Doubles, cells: Mapping[Place, _Cells]) -> Iterator[None]:
    """Context in which kernels know for which cells they are called; what is raised in them is raised after it."""
    _assemblies.append(_Assembly(constants, cells))
    try:
        yield
    finally:
        done = _assemblies.pop()
    if done.fault is not None:
        raise done.fault


def _cells_of(arguments: Sequence[Any]) -> tuple[Doubles, dict[Place, _Cells]]:
    """Return constants and cells of the arguments of a function of DOLFINx that assembles."""
    place = next(i for i, argument in enumerate(arguments) if type(argument).__name__.startswith(("Form", "Expr")))
    if len(arguments) < place + 3:  # they are not packed
        return np.zeros(0), {}
    item, constants, coefficients, *rest = arguments[place:]
    if isinstance(coefficients, np.ndarray):
        return constants, {EXPRESSION: _Cells(coefficients, *rest[:2])}
    domains = {
        (kind.name, number): _Cells(w, item.mesh, item.domains(kind, number))
        for (kind, number), w in coefficients.items()
    }
    return constants, domains


def _followed(assemble: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(assemble)
    def assembled(*arguments: Any, **further: Any) -> Any:
        with _under_way(*_cells_of(arguments)):
            return assemble(*arguments, **further)

    return assembled


@cache
def _follow_assemblies() -> None:
    """Replace DOLFINx' functions that call kernels."""
    for name in ("assemble_scalar", "assemble_vector", "assemble_matrix", "tabulate_expression"):
        setattr(cpp.fem, name, _followed(getattr(cpp.fem, name)))
    cpp.fem.petsc.assemble_matrix = _followed(cpp.fem.petsc.assemble_matrix)


def _doubles_at(address: int | None, count: int) -> Doubles:
    if not count:
        return np.zeros(0)
    return np.frombuffer((ctypes.c_double * count).from_address(address or 0))
