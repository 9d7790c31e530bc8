"""Products of the volume part of a tangent with vectors, without its matrix.

The moduli are evaluated once, at quadrature points of the residual or of the vectors; from the former they are extended
to the latter by polynomials. A product then takes the gradients of the vector at the points, the duals of these by the
moduli, and the integrals of the duals times the basis functions: two products of matrices in BLAS and one sum over the
points, in single precision. The spaces of the vectors may have another degree than those of the state at which the
moduli are evaluated, and their mesh another geometry, with the same cells on the same ranks.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from dolfinx import la

from hpcinv.assembly.compiled_moduli import CompiledModuli
from hpcinv.assembly.element_matrices import directions_of, tabulated
from hpcinv.assembly.moduli import Slot
from hpcinv.mesh.cells import quadrature, scalar_element
from hpcinv.mesh.source import Floats
from hpcinv.model.spaces import Integers, Unknowns

type Singles = npt.NDArray[np.float32]
type Places = dict[Slot, slice]

_CHUNK = 2**15  # quadrature points at a time, whose gradients and duals fit in the cache of a core
_FEW = 128  # cells at a time whose moduli are evaluated, which fit there too


@dataclass(frozen=True)
class _Cells:
    """Some cells, with what does not change between products.

    Attributes:
        cells: their numbers.
        dofs: unknowns of displacement and pressure, (components, cells, nodes) each.
        moduli: (entries of all duals, entries of all gradients, points), times the weights.
    """

    cells: Integers
    dofs: list[npt.NDArray[np.intp]]
    moduli: Singles


class TangentProduct:
    """The volume part of ``K = ∂R/∂x`` at the present state of a scene, applied to vectors; methods are collective.

    Args:
        moduli: of the residual.
        given: unknowns of the scene.
        unknowns: spaces of the vectors.
        degree: of a quadrature that integrates products of gradients in these spaces.
    """

    def __init__(self, moduli: Sequence[CompiledModuli], given: Unknowns, unknowns: Unknowns, degree: int) -> None:
        dofmap = unknowns.space.dofmap
        self._x, self._y = (la.vector(dofmap.index_map, dofmap.index_map_bs, dtype=np.float32) for _ in range(2))
        self._owned = dofmap.index_map.size_local * dofmap.index_map_bs
        dofs = unknowns.dofs_of_cells()
        owned = np.arange(given.mesh.topology.index_map(3).size_local, dtype=np.int32)
        points, weights = quadrature(given.mesh.basix_cell().name, degree)
        tables = [tabulated(element, points).astype(np.float32) for element in unknowns.scalar_elements]
        self._parts = []
        for one in moduli:
            extended = (extension(given.mesh.basix_cell().name, one.points, points) * weights[:, None]).T
            cells = owned if one.cells is None else one.cells
            chunks = np.array_split(cells, 1 + len(cells) * len(points) // _CHUNK)
            places = _places(test for test, _ in one.pairs), _places(trial for _, trial in one.pairs)
            evaluated = [_evaluated(one, places, given, dofs, chunk, extended) for chunk in chunks]
            self._parts.append((places, tables, evaluated))

    def __call__(self, x: Singles) -> Singles:
        """Return ``K x``, both at the owned unknowns."""
        self._x.array[: self._owned] = x
        self._x.scatter_forward()
        self._y.array[:] = 0.0
        for places, tables, chunks in self._parts:
            for cells in chunks:
                self._add(*places, tables, cells)
        self._y.scatter_reverse(la.InsertMode.add)
        return np.array(self._y.array[: self._owned])

    def stiffness(self, most: int) -> tuple[Integers, Singles]:
        """Return about ``most`` owned cells, spread evenly, and how stiff each is against displacements of its nodes.

        That is the sum over the nodes of ``‖K_ii‖/√3`` (Frobenius), with the 3 × 3 block of the cell's part of K at
        node i. It does not depend on how reference and current body are turned.
        """
        gradient = Slot(0, 3, is_gradient=True)
        step = math.ceil(sum(len(one.cells) for *_, chunks in self._parts for one in chunks) / most)
        found, values = [np.zeros(0, dtype=np.int32)], [np.zeros(0, dtype=np.float32)]
        for (tests, trials), tables, chunks in self._parts:
            if gradient not in tests or gradient not in trials:
                continue
            table = tables[0][directions_of(gradient)]
            products = np.einsum("aqi,bqi->abqi", table, table)
            for one in chunks:
                moduli = one.moduli[tests[gradient], trials[gradient]]
                some = moduli.reshape(3, 3, 3, 3, -1, table.shape[1])[..., ::step, :]
                blocks = np.einsum("cadbnq,abqi->nicd", some, products, optimize=True)
                found.append(one.cells[::step])
                values.append(np.linalg.norm(blocks, axis=(2, 3)).sum(axis=1) / math.sqrt(3))
        return np.concatenate(found), np.concatenate(values)

    def _add(self, tests: Places, trials: Places, tables: list[Singles], cells: _Cells) -> None:
        at_nodes = [self._x.array[dofs] for dofs in cells.dofs]
        gradients = np.empty(cells.moduli.shape[1:], dtype=np.float32)
        for slot, rows in trials.items():
            _at_points(at_nodes[slot.part], tables[slot.part][directions_of(slot)], gradients[rows])
        duals = np.einsum("ijp,jp->ip", cells.moduli, gradients)
        for slot, rows in tests.items():
            table, dofs = tables[slot.part][directions_of(slot)], cells.dofs[slot.part]
            by_direction = duals[rows].reshape(slot.components, len(table), -1, table.shape[1])
            integrals = sum(by_direction[:, d] @ table[d] for d in range(len(table)))
            np.add.at(self._y.array, dofs.ravel(), np.ravel(integrals))


def extension(kind: str, given: Floats, points: Floats) -> Floats:
    """Values at ``points`` (m, 3) of the polynomial nearest to values at ``given`` points (n, 3): a matrix (m, n).

    The polynomial is of the highest degree that has no more coefficients than there are given points.
    """
    if np.array_equal(given, points):
        return np.eye(len(points))
    degree = 0
    while scalar_element(kind, degree + 1).dim <= len(given):
        degree += 1
    if degree == 0:
        return np.full((len(points), len(given)), 1 / len(given))
    at_given, at_points = (scalar_element(kind, degree).tabulate(0, x)[0, :, :, 0] for x in (given, points))
    return np.asarray(at_points @ np.linalg.pinv(at_given))


def _places(slots: Iterable[Slot]) -> Places:
    """Places of the entries of slots, one slot after the other."""
    places, at = dict[Slot, slice](), 0
    for slot in dict.fromkeys(slots):
        places[slot] = slice(at, at := at + math.prod(slot.shape))
    return places


def _evaluated(
    one: CompiledModuli,
    places: tuple[Places, Places],
    given: Unknowns,
    dofs: list[Integers],
    cells: Integers,
    extended: Floats,
) -> _Cells:
    singles = np.ascontiguousarray(extended, dtype=np.float32)
    tests, trials = places
    rows, columns = (max(place.stop for place in of.values()) for of in places)
    moduli = np.zeros((rows, columns, len(cells), singles.shape[1]), dtype=np.float32)
    for start in range(0, len(cells), _FEW):
        values = one.expression.eval(given.mesh, cells[start : start + _FEW])  # (cells, points, entries)
        by_entry = np.ascontiguousarray(values.transpose(2, 0, 1), dtype=np.float32)
        at = 0
        for test, trial in one.pairs:
            block = moduli[tests[test], trials[trial], start : start + _FEW]
            of_pair = by_entry[at : (at := at + block.shape[0] * block.shape[1])]
            np.matmul(of_pair.reshape(*block.shape[:3], -1), singles, out=block)
    by_component = [np.ascontiguousarray(of_part[cells].transpose(2, 0, 1), dtype=np.intp) for of_part in dofs]
    return _Cells(cells, by_component, moduli.reshape(rows, columns, -1))


def _at_points(at_nodes: Singles, table: Singles, values: Singles) -> None:
    """Set values or derivatives at points, (components × directions, cells × points).

    Args:
        at_nodes: (components, cells, nodes).
        table: (directions, points, nodes).
    """
    shape = len(at_nodes), len(table), at_nodes.shape[1], table.shape[1]
    np.matmul(at_nodes[:, None], table.transpose(0, 2, 1), out=values.reshape(shape))
