"""Fields of solutions as files for ParaView, on both bodies."""

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from dolfinx import fem

import hpcinv.base.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
import basix.ufl

from hpcinv.base.parallel.runtime import on_root
from hpcinv.base.quantity.stress_measures import COMPONENTS, MEASURES, components_of
from hpcinv.errors import OutputError
from hpcinv.job.body_kinds import SHELL
from hpcinv.job.fibres import FibreFamily
from hpcinv.mesh import Body
from hpcinv.mesh.cells import scalar_element, vtk_order
from hpcinv.mesh.distributed.rows import Rows
from hpcinv.mesh.io.vtu import CELL_TAG, NODE_TAG, VTK_TYPES
from hpcinv.mesh.io.vtu_writer import Array, Grid, attribute, write_vtu
from hpcinv.mesh.source import Floats, Ints
from hpcinv.output.surfaces.gathering import error_in
from hpcinv.results.cell_fields import nodal_layer_fields, nodal_means, projected
from hpcinv.results.cell_middles import constants_in, deformation_gradients, fibres, unit_vectors
from hpcinv.results.solution import Solution
from hpcinv.trust.certificate import Estimate

BODIES = ("undeformed", "deformed")


_ADVICE = "Is the directory writable, and space left?"


def write_fields(
    directory: Path,
    body: Body,
    solutions: Sequence[Solution],
    more: Sequence[Sequence[fem.Function]] = (),
    *,
    families: Mapping[str, FibreFamily] = MappingProxyType({}),
    estimate: Estimate | None = None,
) -> None:
    """Write ``undeformed.pvd`` and ``deformed.pvd``, which appear with their data whole or not at all; collective.

    Each has one time step for each solution. ``docs/how-to/paraview.md`` lists the arrays. A directory of that name is
    replaced.

    Args:
        solutions: the first, and the solutions of further states of the body.
        more: for each solution further fields at the nodes, by their names.
        families: fibres of the job.
        estimate: of the first solution.

    Raises:
        OutputError: on every rank, if it cannot be written.
    """
    comm = body.mesh.comm
    partial = directory.with_name(f".{directory.name}.partial")
    on_root(comm, lambda: _prepare(partial, directory))
    undeformed = dict[str, Floats]()
    for number, solution in enumerate(solutions):
        with body.at(solution.mesh_nodes):
            fields = _Fields(body, solution)
            if number == 0:
                undeformed = fibres(body, families, solution, fields.gradients, fields.cells)
            node_arrays = fields.node_arrays(more[number] if more else ())
            cell_arrays = fields.cell_arrays(estimate if number == 0 else None)
            for name, points in zip(BODIES, fields.points(), strict=True):
                fibre_arrays = fields.fibres(undeformed, name)
                path = partial / _data_file(name, solution.state)
                own_arrays = [*node_arrays, *fields.kind_arrays(name)]
                failed = write_vtu(path, comm, fields.grid(points), own_arrays, [*cell_arrays, *fibre_arrays])
                if failed is not None:
                    on_root(comm, lambda: shutil.rmtree(partial, ignore_errors=True))
                    raise OutputError(f"{directory}: cannot be written: {failed.strerror or failed}", _ADVICE) from None
    on_root(comm, lambda: _publish(partial, directory, [solution.state for solution in solutions]))


def _prepare(partial: Path, directory: Path) -> None:
    try:
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
    except OSError as exc:
        raise OutputError(f"{directory}: cannot be made: {exc.strerror or exc}", _ADVICE) from exc


def _publish(partial: Path, directory: Path, states: Sequence[str]) -> None:
    """Write the collections, and replace a directory by the finished one."""
    try:
        for name in BODIES:
            (partial / f"{name}.pvd").write_text(_collection(name, states))
        if directory.exists():
            shutil.rmtree(directory)
        partial.rename(directory)
    except OSError as exc:
        raise OutputError(f"{directory}: cannot be replaced: {exc.strerror or exc}", _ADVICE) from exc


def _data_file(body: str, state: str) -> str:
    return f"{body}-{state}.vtu" if state else f"{body}.vtu"


def _collection(body: str, states: Sequence[str]) -> str:
    steps = "".join(
        f'<DataSet timestep="{number}" name={attribute(state)} file={attribute(_data_file(body, state))}/>\n'
        for number, state in enumerate(states)
    )
    head = '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n<Collection>\n'
    return f"{head}{steps}</Collection>\n</VTKFile>\n"


class _Fields:
    """Arrays of one solution, at the nodes and in the cells that this rank owns; the mesh lies as in the solution."""

    def __init__(self, body: Body, solution: Solution) -> None:
        self._body, self._solution = body, solution
        mesh = body.mesh
        self._degree = max(solution.displacement.function_space.ufl_element().degree, body.degree)
        self._spaces = {shape: self._space(shape) for shape in ((), (3,))}
        self._owned = self._spaces[()].dofmap.index_map.size_local
        self.cells = np.arange(mesh.topology.index_map(3).size_local)
        self.gradients = deformation_gradients(body, solution, self.cells)
        self._local_u = self._local_nodal(solution.displacement)
        self._u = self._local_u[: self._owned]

    def _space(self, shape: tuple[int, ...]) -> fem.FunctionSpace:
        kwargs: dict[str, Any] = {"shape": shape} if shape else {}
        cell, variant = self._body.mesh.basix_cell(), basix.LagrangeVariant.equispaced
        return fem.functionspace(self._body.mesh, basix.ufl.element("Lagrange", cell, self._degree, variant, **kwargs))

    def _nodal(self, function: fem.Function) -> Floats:
        """Values at the owned nodes, (n,) or (n, 3)."""
        return self._local_nodal(function)[: self._owned]

    def _local_nodal(self, function: fem.Function) -> Floats:
        """Values at all local nodes, (n,) or (n, 3)."""
        shape = tuple(function.ufl_shape)
        nodal = fem.Function(self._spaces[shape])
        nodal.interpolate(function)
        nodal.x.scatter_forward()
        return np.asarray(nodal.x.array.reshape(-1, *shape))

    def _mean_of_cells(self, function: fem.Function) -> Floats:
        """Values of a scalar at the owned nodes, (n,): where it jumps, means over the cells around them."""
        space, given = self._spaces[()], function.function_space
        shapes = given.element.basix_element.tabulate(0, space.element.basix_element.points)[0, :, :, 0]
        values = function.x.array[given.dofmap.list[self.cells]] @ shapes.T
        means = nodal_means(space.dofmap.index_map, space.dofmap.list[self.cells], values[:, :, None])
        return np.asarray(means[: self._owned, 0])

    def points(self) -> tuple[Floats, Floats]:
        """Positions of the owned nodes in the undeformed and in the deformed body, (n, 3) m."""
        undeformed, deformed = self._local_points()
        return undeformed[: self._owned], deformed[: self._owned]

    def _local_points(self) -> tuple[Floats, Floats]:
        """Positions of all local nodes in the undeformed and in the deformed body, (n, 3) m."""
        mesh = self._spaces[()].tabulate_dof_coordinates() * self._body.length_scale
        other = mesh + self._solution.sign * self._local_u
        return (mesh, other) if self._solution.direction == "forward" else (other, mesh)

    def kind_arrays(self, name: str) -> Iterator[Array]:
        """Arrays of the kind of the body at the owned nodes, in one of the bodies."""
        arrays = _KIND_ARRAYS.get(self._body.source.body_kind)
        return arrays(self, name) if arrays else iter(())

    def director_arrays(self, name: str) -> Iterator[Array]:
        """Director and thickness of a shell of one layer."""
        if self._body.source.layers > 1:
            return
        places = self._spaces[()].element.basix_element.points
        ends = [places * [1, 1, 0] + [0, 0, side] for side in (0.0, 1.0)]
        inner, outer = (np.abs(end[:, None] - places).max(axis=2).argmin(axis=1) for end in ends)
        points, nodes = self._local_points()[BODIES.index(name)], self._spaces[()].dofmap.list
        through = np.zeros_like(points)
        through[nodes] = points[nodes[:, outer]] - points[nodes[:, inner]]
        through = through[: self._owned]
        yield Array("director", unit_vectors(through).astype(np.float32))
        yield Array("thickness", np.linalg.norm(through, axis=1), "m")

    def grid(self, points: Floats) -> Grid:
        dofmap, kind = self._spaces[()].dofmap, self._body.source.kind
        nodes = dofmap.list[: len(self.cells)]
        numbers = dofmap.index_map.local_to_global(nodes.ravel()).reshape(nodes.shape)
        number = VTK_TYPES[kind][min(self._degree, len(VTK_TYPES[kind])) - 1]
        return Grid(points, [(numbers[:, np.argsort(vtk_order(kind, self._degree))], number)])

    def node_arrays(self, more: Sequence[fem.Function]) -> list[Array]:
        solution = self._solution
        arrays = [Array("displacement", self._u, "m")]
        arrays.append(Array(NODE_TAG, node_numbers(self._body, self._spaces[()])[: self._owned]))
        if solution.pressure is not None:
            arrays.append(Array("pressure", self._mean_of_cells(solution.pressure), "Pa"))
        for contact in solution.contacts:
            arrays.extend(Array(field.name, self._nodal(field), unit) for field, unit in contact.fields_with_units)
        arrays.extend(Array(function.name, self._nodal(function)) for function in more)
        arrays.extend(self._smooth())
        return arrays

    def _smooth(self) -> Iterator[Array]:
        """Yield stresses and volume ratio at the nodes; in a shell also stretches, at the faces as within."""
        solution, space = self._solution, self._spaces[()]
        if solution.layer is None:
            stress, J = (constants_in(function, self.cells) for function in (solution.cauchy_stress, solution.J))
            smooth = projected(self._body, np.concatenate([stress, J], axis=1), space)
            yield from _stresses(smooth[:, :9], "_projected")
            yield Array("J_projected", smooth[:, 9].astype(np.float32))
            return
        points, dofmap = space.element.basix_element.points, space.dofmap
        nodal = nodal_layer_fields(self._body, solution, solution.layer, points, dofmap.list, dofmap.index_map)
        yield from _stresses(nodal.stress[: self._owned], "_projected")
        yield Array("J_projected", nodal.J[: self._owned].astype(np.float32))
        yield Array("principal_stretches_projected", nodal.stretches[: self._owned].astype(np.float32))

    def cell_arrays(self, estimate: Estimate | None) -> list[Array]:
        solution, body = self._solution, self._body
        stress = constants_in(solution.cauchy_stress, self.cells)
        arrays = [Array("J", constants_in(solution.J, self.cells)[:, 0]), Array("cauchy_stress", stress, "Pa")]
        arrays.append(Array(CELL_TAG, cell_numbers(body)[self.cells]))
        arrays.extend(array for array in _stresses(stress) if array.name != "cauchy_stress")
        stretches = np.linalg.svd(self.gradients, compute_uv=False)
        arrays.append(Array("principal_stretches", stretches.astype(np.float32)))
        if solution.prestrain_stress is not None:
            arrays.append(Array("prestrain_stress", constants_in(solution.prestrain_stress, self.cells), "Pa"))
        if estimate is not None:
            error = error_in(body, solution, estimate, self.cells)
            arrays.append(Array("estimated_error", error.astype(np.float32)))
        for region in body.regions.values():
            if region.cell_count:
                is_inside = np.isin(self.cells, region.cells).astype(np.int32)
                arrays.append(Array(f"region:{region.name}", is_inside))
        return arrays

    def fibres(self, undeformed: Mapping[str, Floats], name: str) -> Iterator[Array]:
        """Unit directions in the cells of one of the bodies."""
        for family, directions in undeformed.items():
            moved = directions if name == BODIES[0] else np.einsum("cij,cj->ci", self.gradients, directions)
            yield Array(f"fibre:{family}", unit_vectors(moved).astype(np.float32))


_KIND_ARRAYS: Mapping[str, Callable[[_Fields, str], Iterator[Array]]] = {SHELL.name: _Fields.director_arrays}
"""further arrays by the kind of the body"""


def _stresses(stress: Floats, suffix: str = "") -> Iterator[Array]:
    """Yield the stress (n, 9) with its von Mises stress, mean pressure and principal values, in single precision."""
    tensors = stress.reshape(-1, 3, 3)
    yield Array(f"cauchy_stress{suffix}", stress.astype(np.float32), "Pa")
    for measure, name in (("von_mises", "von_mises"), ("p", "mean_pressure")):
        values = MEASURES[measure](*(tensors[:, *COMPONENTS[component]] for component in components_of(measure)))
        yield Array(f"{name}{suffix}", np.asarray(values).astype(np.float32), "Pa")
    values = np.linalg.eigvalsh((tensors + tensors.transpose(0, 2, 1)) / 2)[:, ::-1]
    yield Array(f"principal_stress{suffix}", values.astype(np.float32), "Pa")


def cell_numbers(body: Body) -> Ints:
    """Return the numbers of the local cells in the file, in the surface of a shell, (cells,); collective."""
    source = body.source
    rows = Rows.distributed(body.mesh.comm, len(source.cells))
    numbers = np.resize(source.in_file.cell_tags, len(source.cells))
    return rows.fetch(numbers[:, None], np.asarray(body.mesh.topology.original_cell_index))[:, 0]


def node_numbers(body: Body, space: fem.FunctionSpace) -> Ints:
    """Return the numbers in the file of the local nodes of a scalar Lagrange space; collective.

    Nodes that the file does not have are 0. The nodes of a shell have the number of their node of the surface.
    """
    source, geometry = body.source, body.source_geometry
    numbers = np.resize(source.in_file.node_tags, len(source.points))
    rows = Rows.distributed(body.mesh.comm, len(source.points))
    source_numbers = rows.fetch(numbers[:, None], geometry.input_global_indices)[:, 0]
    places, own = space.element.basix_element.points, scalar_element(source.kind, source.degree).points
    distances = np.abs(places[:, None] - own).max(axis=2)
    node, point = np.nonzero(distances < 1e-9)
    dofs = space.dofmap.list
    result: Ints = np.zeros(space.dofmap.index_map.size_local + space.dofmap.index_map.num_ghosts, dtype=np.int64)
    result[dofs[:, node]] = source_numbers[geometry.dofmaps[0][:, point]]
    return result
