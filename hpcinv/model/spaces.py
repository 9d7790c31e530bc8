"""Unknown fields: displacement, and pressure in the mixed form."""

from functools import cached_property
from typing import Any

import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.mesh.interpolation import interpolate
from hpcinv.mesh.source import Ints
from hpcinv.model.split_dofs import split


class Unknowns:
    """Finite-element spaces on one mesh, and the state of a solve.

    Args:
        displacement: polynomial degree of the displacement.
        pressure: polynomial degree of the pressure, or ``None`` for the displacement form.
        layers: number of the layer of each local cell, between which the pressure jumps; ``None`` if it is continuous.
        has_directors: whether the mesh is one layer of a shell so thin that its tangent has unknowns of its own.

    Attributes:
        state: all unknowns in one function, ``u`` or ``(u, p)``.
        scalar_elements: elements of a displacement component, and of the pressure in the mixed form.
        layers, has_directors: the arguments of these names.
        displacement_space, pressure_space: spaces of displacement and pressure; the latter in the mixed form only.
        u, p: parts of the state as UFL expressions; ``p`` is ``None`` in the displacement form.
        v, q: test functions of ``u`` and ``p``.
    """

    def __init__(
        self,
        mesh: Mesh,
        displacement: int,
        pressure: int | None,
        layers: Ints | None = None,
        *,
        has_directors: bool = False,
    ) -> None:
        self.mesh, self.layers, self.has_directors = mesh, layers, has_directors
        cell = mesh.basix_cell()
        vector = basix.ufl.element("Lagrange", cell, displacement, shape=(3,))
        degrees = (displacement,) if pressure is None else (displacement, pressure)
        self.scalar_elements = tuple(basix.ufl.element("Lagrange", cell, degree) for degree in degrees)
        self.q: Any
        self.p: Any
        if pressure is None:
            self.space = fem.functionspace(mesh, vector)
            self.state = fem.Function(self.space, name="u")
            self.u, self.p = self.state, None
            self.test = ufl.TestFunction(self.space)
            self.v, self.q = self.test, None
            self.displacement_space = self.space
            self._displacement_dofs = np.arange(self.state.x.array.size, dtype=np.int32)
        else:
            scalar = self.scalar_elements[1]
            self.space = fem.functionspace(mesh, basix.ufl.mixed_element([vector, scalar]))
            self.pressure_space = fem.functionspace(mesh, scalar)
            if layers is not None:
                self.space = split(self.space, slice(3 * self.scalar_elements[0].dim, None), layers)
                self.pressure_space = split(self.pressure_space, slice(None), layers)
            self.state = fem.Function(self.space, name="up")
            self.u, self.p = ufl.split(self.state)
            self.test = ufl.TestFunction(self.space)
            self.v, self.q = ufl.split(self.test)
            self.displacement_space = fem.functionspace(mesh, vector)
            self._displacement_dofs = _dofs_in(self.space, 0, self.displacement_space)
            self._pressure_dofs = _dofs_in(self.space, 1, self.pressure_space)

    @property
    def size(self) -> int:
        """Number of unknowns over all ranks."""
        return int(self.space.dofmap.index_map.size_global * self.space.dofmap.index_map_bs)

    @property
    def parts(self) -> tuple[int, ...]:
        """Number of components of the displacement, and of the pressure in the mixed form."""
        return (3,) if self.p is None else (3, 1)

    @property
    def pressure_size(self) -> int:
        """Number of pressures over all ranks; 0 in the displacement form."""
        return 0 if self.p is None else int(self.pressure_space.dofmap.index_map.size_global)

    @property
    def unloaded_sign(self) -> int:
        """Sign of the determinant of the unloaded body's tangent, in either direction.

        Its displacements, which supports hold, are positive eigenvalues, and each pressure is a negative one.
        """
        return -1 if self.pressure_size % 2 else 1

    @cached_property
    def has_whole_nodes(self) -> bool:
        """True if the displacements of each node are consecutive, which DOLFINx does not guarantee; collective."""
        dofmap = self.space.dofmap
        if dofmap.index_map_bs == 3:
            return True
        dofs = dofmap.list[:, : 3 * self.scalar_elements[0].dim].reshape(-1, 3)
        here = bool((np.diff(dofs, axis=1) == 1).all())
        return bool(self.mesh.comm.allreduce(here, op=MPI.LAND))

    def dofs_of_cells(self) -> list[LocalIndices]:
        """Return local unknowns of displacement and pressure in each local cell, (cells, nodes, components) each."""
        dofmap = self.space.dofmap
        bs = dofmap.index_map_bs
        cells, functions = dofmap.list.shape  # a rank without cells has functions, too
        dofs = (bs * dofmap.list[:, :, None] + np.arange(bs, dtype=np.int32)).reshape(cells, functions * bs)
        first = 3 * self.scalar_elements[0].dim
        parts = [dofs[:, :first].reshape(cells, first // 3, 3), dofs[:, first:, None]]
        return parts[: len(self.scalar_elements)]

    @cached_property
    def nodes(self) -> tuple[LocalIndices, LocalIndices]:
        """Unknowns of all ranks, by their global numbers, node by node; and where each node begins, and the end.

        The pressure at a vertex is among the unknowns of that node; other pressures are nodes by themselves. The same
        on all ranks; collective at the first access.
        """
        dofmap, comm = self.space.dofmap, self.mesh.comm
        owned = dofmap.index_map.size_local * dofmap.index_map_bs
        node = np.arange(len(self.state.x.array))
        displacement, *pressure = self.dofs_of_cells()
        node[displacement] = displacement[:, :, :1]
        for cell_dofs in pressure:
            vertices = min(cell_dofs.shape[1], self.mesh.ufl_cell().num_vertices)  # the first nodes of a cell
            node[cell_dofs[:, :vertices, 0]] = displacement[:, :vertices, 0]
        order = np.argsort(node[:owned], kind="stable")
        begins = np.diff(node[order], prepend=-1) != 0
        first = dofmap.index_map.local_range[0] * dofmap.index_map_bs
        parts = comm.allgather(((first + order).astype(np.int32), begins))
        unknowns, starts = (np.concatenate(part) for part in zip(*parts, strict=True))
        return unknowns, np.append(np.flatnonzero(starts), len(unknowns)).astype(np.int32)

    @property
    def displacement_dofs_of_nodes(self) -> npt.NDArray[np.int32]:
        """Local numbers of the displacements in the state, (nodes of the displacement's space, 3)."""
        return self._displacement_dofs.reshape(-1, 3)

    @property
    def owned_displacement_dofs(self) -> npt.NDArray[np.int32]:
        """Local numbers of the displacements in the state, without ghosts; consecutive for each node."""
        return np.extract(self._is_owned(self._displacement_dofs), self._displacement_dofs)

    @property
    def owned_pressure_dofs(self) -> npt.NDArray[np.int32]:
        """Local numbers of the pressures in the state, without ghosts."""
        return np.extract(self._is_owned(self._pressure_dofs), self._pressure_dofs)

    def owned_displacement_points(self) -> npt.NDArray[np.float64]:
        """Return present positions of the nodes of `owned_displacement_dofs`, (nodes, 3) in scaled lengths."""
        points: npt.NDArray[np.float64] = self.displacement_space.tabulate_dof_coordinates()
        return points[self._is_owned(self._displacement_dofs[::3])]

    def _is_owned(self, dofs: npt.NDArray[np.int32]) -> npt.NDArray[np.bool_]:
        dofmap = self.space.dofmap
        return np.asarray(dofs < dofmap.index_map.size_local * dofmap.index_map_bs)

    def displacement_component(self, i: int) -> fem.FunctionSpace:
        """Return the subspace of the ``i``-th displacement component, for supports."""
        space = self.space if self.p is None else self.space.sub(0)
        return space.sub(i)

    def displacement(self, state: fem.Function | None = None) -> fem.Function:
        """Return a copy of the displacement, in scaled lengths.

        Args:
            state: of which it is a part; by default the present state.
        """
        u = fem.Function(self.displacement_space, name="displacement")
        u.x.array[:] = (self.state if state is None else state).x.array[self._displacement_dofs]
        return u

    def set_displacement(self, values: npt.NDArray[np.float64]) -> None:
        """Set the displacement of the state, by values at the local degrees of freedom of its space."""
        self.state.x.array[self._displacement_dofs] = values

    def pressure(self, state: fem.Function | None = None) -> fem.Function | None:
        """Return a copy of the pressure, in scaled stresses; ``None`` in the displacement form. As `displacement`."""
        if self.p is None:
            return None
        p = fem.Function(self.pressure_space, name="pressure")
        p.x.array[:] = (self.state if state is None else state).x.array[self._pressure_dofs]
        return p

    def set_pressure(self, values: npt.NDArray[np.float64]) -> None:
        """Set the pressure of the state, by values at the local degrees of freedom of its space."""
        self.state.x.array[self._pressure_dofs] = values

    def geometry_values(self, u: fem.Function) -> npt.NDArray[np.float64]:
        """Return values of the displacement ``u`` at the geometry nodes of the mesh, (local nodes, 3).

        ``u`` may be on the same cells with another geometry.
        """
        x = self.mesh.geometry
        nodal = fem.Function(self.nodal_space)
        interpolate(u, nodal)
        nodal.x.scatter_forward()  # the same on all ranks that share a node
        values = np.empty((x.x.shape[0], 3))
        dofmap = nodal.function_space.dofmap.list
        values[x.dofmaps[0]] = nodal.x.array.reshape(-1, 3)[dofmap]
        return values

    @cached_property
    def nodal_space(self) -> fem.FunctionSpace:
        """Vector fields of the degree of the geometry."""
        # The element of the coordinates: from degree 3 on nodes of the default Lagrange element lie elsewhere.
        return fem.functionspace(self.mesh, self.mesh.ufl_domain().ufl_coordinate_element())


def _dofs_in(mixed: fem.FunctionSpace, part: int, space: fem.FunctionSpace) -> npt.NDArray[np.int32]:
    """Return the dof of a part of a ``mixed`` space that corresponds to each local dof of ``space``.

    Functions of a collapsed subspace are not continuous on tetrahedra from degree 3 on (DOLFINx 0.11): the dofs on an
    edge are then in the order of the mixed space, which forms on the collapsed space do not use.
    """
    numbers, there = fem.Function(space), fem.Function(mixed)
    numbers.x.array[:] = np.arange(1.0, len(numbers.x.array) + 1)
    there.sub(part).interpolate(numbers)  # values at the nodes of both
    place = np.flatnonzero(there.x.array)
    dofs = np.empty(len(place), dtype=np.int32)
    dofs[np.rint(there.x.array[place]).astype(np.int64) - 1] = place
    return dofs
