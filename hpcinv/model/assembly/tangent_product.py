"""Products of the volume part of a tangent with vectors, without its matrix.

The moduli are evaluated once, at quadrature points of the residual or of the vectors; from the former they are extended
to the latter by polynomials, in each product where these are few. A product takes the gradients of the vector at the
points, the duals of these by the moduli, and the integrals of the duals times the basis functions, in C and in single
precision (``tangent_product.c``). The spaces of the vectors may have another degree than the state at which
the moduli are evaluated, and their mesh another geometry, with the same cells on the same ranks.
"""

import ctypes
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from dolfinx import la

from hpcinv.base.parallel.c_code import NoLibrary, array_type, compile_library
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.arrays import LocalIndices, Singles
from hpcinv.mesh.cells import quadrature, scalar_element
from hpcinv.mesh.source import Floats
from hpcinv.model.assembly.array_code import ProductCode, SlotNumbers
from hpcinv.model.assembly.element_matrices import directions_of, tabulated
from hpcinv.model.assembly.moduli_at_points import ModuliAtPoints
from hpcinv.model.assembly.tangent_moduli import Slot
from hpcinv.model.spaces import Unknowns

_CODE = Path(__file__).with_suffix(".c")
_LANES = 8  # cells of a group, as in the code
_CHUNK = 16  # groups at a time whose moduli are evaluated, which fit in the cache of a core
_FEW = 8  # points of given moduli: to extend them in each product takes less time than to read all
_GRADIENT = Slot(0, 3, is_gradient=True)


class TangentProduct:
    """The volume part of ``K = ∂R/∂x`` at the present state of a weak form, applied to vectors; methods are collective.

    Args:
        moduli: of the residual.
        form_unknowns: unknowns of the weak form.
        unknowns: spaces of the vectors.
        degree: of a quadrature that integrates products of gradients in these spaces.
    """

    def __init__(
        self, moduli: Sequence[ModuliAtPoints], form_unknowns: Unknowns, unknowns: Unknowns, degree: int
    ) -> None:
        dofmap = unknowns.space.dofmap
        self._x, self._y = (la.vector(dofmap.index_map, dofmap.index_map_bs, dtype=np.float32) for _ in range(2))
        self._owned = dofmap.index_map.size_local * dofmap.index_map_bs
        points, weights = quadrature(form_unknowns.mesh.basix_cell().name, degree)
        nodes = _Nodes(unknowns, points, weights)
        self._parts = [_ModuliTerm(part, form_unknowns, nodes) for part in moduli]

    def __call__(self, x: Singles) -> Singles:
        """Return ``K x``, both at the owned unknowns."""
        self._x.array[: self._owned] = x
        self._x.scatter_forward()
        self._y.array[:] = 0.0
        for part in self._parts:
            part.add_product(self._x.array, self._y.array)
        self._y.scatter_reverse(la.InsertMode.add)
        return np.array(self._y.array[: self._owned])

    def stiffness(self, most: int) -> tuple[LocalIndices, Singles]:
        """Return about ``most`` owned cells, spread evenly, and how stiff each is against displacements of its nodes.

        That is the sum over the nodes of ``‖K_ii‖/√3`` (Frobenius), with the 3 × 3 block of the cell's part of K at
        node i. It does not depend on how reference and current body are turned.
        """
        step = math.ceil(sum(len(part.cells) for part in self._parts) / most)
        cells, values = [np.zeros(0, dtype=np.int32)], [np.zeros(0, dtype=np.float32)]
        for part in self._parts:
            if part.has_gradients:
                cells.append(part.cells[::step])
                values.append(part.stiffness(step))
        return np.concatenate(cells), np.concatenate(values)


class _Nodes:
    """Unknowns of the owned cells in vectors, and basis functions at quadrature points.

    Attributes:
        points, weights: quadrature rule on the reference cell.
        places: local numbers of the unknowns, (cells, unknowns of a cell), ordered by part, component and node.
        firsts: numbers of the first displacement and the first pressure of a cell.
        tables: values and derivatives of the functions of displacement and pressure, (points, 4, functions).
    """

    def __init__(self, unknowns: Unknowns, points: Floats, weights: Floats) -> None:
        self.points, self.weights = points, weights
        owned = unknowns.mesh.topology.index_map(3).size_local
        parts = [
            dofs[:owned].transpose(0, 2, 1).reshape(owned, dofs.shape[1] * dofs.shape[2])
            for dofs in unknowns.dofs_of_cells()
        ]
        self.places = np.concatenate(parts, axis=1)
        self.firsts = 0, parts[0].shape[1]
        self.tables = [tabulated(element, points).transpose(1, 0, 2) for element in unknowns.scalar_elements]


class _ModuliTerm:
    """Contribution of one set of moduli to products.

    Attributes:
        cells: owned cells that have these moduli.
    """

    def __init__(self, moduli: ModuliAtPoints, form_unknowns: Unknowns, nodes: _Nodes) -> None:
        self.cells = np.arange(len(nodes.places), dtype=np.int32) if moduli.cells is None else moduli.cells
        groups = -(-len(self.cells) // _LANES)
        lanes = np.resize(self.cells, groups * _LANES)  # the last group may have the first cells again
        self._tests, self._trials = (_entries(slots) for slots in zip(*moduli.pairs, strict=True))
        self._gradients = nodes.tables[0][:, directions_of(_GRADIENT)]
        extended = extension(form_unknowns.mesh.basix_cell().name, moduli.points, nodes.points)
        are_given = len(moduli.points) > _FEW or np.array_equal(moduli.points, nodes.points)
        shares = (np.eye(len(nodes.points)) if are_given else extended) * nodes.weights[:, None]
        tables = {slot: nodes.tables[slot.part][:, directions_of(slot)] for slot in {**self._tests, **self._trials}}
        places = nodes.places[lanes].reshape(groups, _LANES, nodes.places.shape[1])
        self._shares = _singles(shares)
        self._tables = _singles(np.concatenate([table.ravel() for table in tables.values()]))
        self._places = np.ascontiguousarray(places.transpose(0, 2, 1), dtype=np.int32)
        self._moduli = self._evaluated(
            moduli, form_unknowns, lanes, extended if are_given else np.eye(len(moduli.points))
        )
        self._moduli[-1:, ..., _LANES - (len(lanes) - len(self.cells)) :] = 0.0
        slots = (_slot_numbers(own, tables, nodes.firsts) for own in (self._tests, self._trials))
        self._code = self._made(form_unknowns.mesh.comm, *slots, are_points_given=are_given)

    def _made(
        self, comm: MPI.Intracomm, tests: list[SlotNumbers], trials: list[SlotNumbers], *, are_points_given: bool
    ) -> ctypes.CDLL | ProductCode:
        """Return the product in C, or in NumPy where there is no compiler; collective."""
        constants = {
            "POINTS": len(self._shares),
            "GIVEN": self._moduli.shape[1],
            "ARE_POINTS_GIVEN": int(are_points_given),
            "UNKNOWNS": self._places.shape[1],
            "ROWS": self._moduli.shape[2],
            "COLUMNS": self._moduli.shape[3],
            "TESTS": _initializer(tests),
            "TRIALS": _initializer(trials),
        }
        definitions = "".join(f"#define {name} {value}\n" for name, value in constants.items())
        try:
            code = compile_library(comm, definitions + _CODE.read_text())
        except NoLibrary:
            return ProductCode(tests, trials, are_points_given=are_points_given)
        singles, integers = array_type(np.float32), array_type(np.int32)
        code.multiply.argtypes = [ctypes.c_int64, *3 * [singles], integers, singles, singles]
        return code

    def add_product(self, x: Singles, y: Singles) -> None:
        """Add the product with ``x`` to ``y``, both at the local unknowns."""
        self._code.multiply(len(self._moduli), self._moduli, self._shares, self._tables, self._places, x, y)

    @property
    def has_gradients(self) -> bool:
        """True if displacement gradients have moduli by themselves."""
        return _GRADIENT in self._tests and _GRADIENT in self._trials

    def stiffness(self, step: int) -> Singles:
        """Return the stiffness of each ``step``-th cell."""
        group, lane = np.divmod(np.arange(0, len(self.cells), step), _LANES)
        moduli = self._moduli[:, :, self._tests[_GRADIENT], self._trials[_GRADIENT]][group, ..., lane]
        products = np.einsum("qai,qbi->qabi", self._gradients, self._gradients)
        shares = np.einsum("qg,qabi->gabi", self._shares, products)
        cell_moduli = moduli.reshape(*moduli.shape[:2], 3, 3, 3, 3)
        blocks = np.einsum("ngcadb,gabi->nicd", cell_moduli, shares, optimize=True)
        stiffness: Singles = np.linalg.norm(blocks, axis=(2, 3)).sum(axis=1) / math.sqrt(3)
        return stiffness

    def _evaluated(
        self, moduli: ModuliAtPoints, form_unknowns: Unknowns, lanes: LocalIndices, extended: Floats
    ) -> Singles:
        """Return moduli of all groups, (groups, points, all tests, all trials, lanes)."""
        rows, columns = (max(place.stop for place in slots.values()) for slots in (self._tests, self._trials))
        groups = len(lanes) // _LANES
        evaluated = np.zeros((groups, len(extended), rows, columns, _LANES), dtype=np.float32)
        for first in range(0, groups, _CHUNK):
            cells = lanes[first * _LANES : (first + _CHUNK) * _LANES]
            values = extended @ moduli.values(form_unknowns.mesh, cells)  # (cells, points, entries)
            group_values = values.reshape(-1, _LANES, *values.shape[1:]).transpose(0, 2, 3, 1)
            offset = 0
            for test, trial in moduli.pairs:
                block = evaluated[first : first + _CHUNK, :, self._tests[test], self._trials[trial]]
                end = offset + block.shape[2] * block.shape[3]
                block[:] = group_values[:, :, offset:end].reshape(block.shape)
                offset = end
        return evaluated


def _entries(slots: Iterable[Slot]) -> dict[Slot, slice]:
    """Return slots with the places of their entries, one slot after the other."""
    places, place = dict[Slot, slice](), 0
    for slot in dict.fromkeys(slots):
        places[slot] = slice(place, place := place + math.prod(slot.shape))
    return places


def _slot_numbers(slots: Iterable[Slot], tables: Mapping[Slot, Floats], firsts: tuple[int, int]) -> list[SlotNumbers]:
    """Return the slots as the code has them; their tables are one after the other."""
    sizes = [table.size for table in tables.values()]
    offsets = dict(zip(tables, np.cumsum([0, *sizes]).tolist(), strict=False))
    return [
        (firsts[slot.part], slot.components, tables[slot].shape[2], tables[slot].shape[1], offsets[slot])
        for slot in slots
    ]


def _initializer(slots: Iterable[SlotNumbers]) -> str:
    return f"{{{', '.join(f'{{{", ".join(map(str, numbers))}}}' for numbers in slots)}}}"


def _singles(values: Floats) -> Singles:
    return np.ascontiguousarray(values, dtype=np.float32)


def extension(kind: str, source_points: Floats, points: Floats) -> Floats:
    """Return the matrix (m, n) from values at ``source_points`` (n, 3) to the nearest polynomial at ``points`` (m, 3).

    The polynomial is of the highest degree that has no more coefficients than there are source points.
    """
    if np.array_equal(source_points, points):
        return np.eye(len(points))
    degree = 0
    while scalar_element(kind, degree + 1).dim <= len(source_points):
        degree += 1
    if degree == 0:
        return np.full((len(points), len(source_points)), 1 / len(source_points))
    source_values, point_values = (
        scalar_element(kind, degree).tabulate(0, x)[0, :, :, 0] for x in (source_points, points)
    )
    return np.asarray(point_values @ np.linalg.pinv(source_values))
