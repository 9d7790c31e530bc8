"""Functions of the mesh with the numbers of an interface at its nodes."""

from __future__ import annotations

import numpy as np
from dolfinx import fem

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh import Body
from hpcinv.mesh.cells import vertex_count
from hpcinv.mesh.source import Floats, Ints
from hpcinv.model.spaces import Unknowns


class NodalFunctions:
    """Functions that are zero outside of an interface.

    Args:
        names: sorted global numbers of nodes of the displacement that have a number.
        corners: whether these are vertices, and functions are linear between them.
    """

    def __init__(self, names: Ints, body: Body, unknowns: Unknowns, *, corners: bool) -> None:
        self._names, self._mesh, self._corners = names, body.mesh, corners
        dofmap = unknowns.displacement_space.dofmap
        index_map, self._element = dofmap.index_map, unknowns.scalar_elements[0]
        count = index_map.size_local + index_map.num_ghosts
        numbers = index_map.local_to_global(np.arange(count, dtype=np.int32))
        self._nodes = np.flatnonzero(np.isin(numbers, names))
        self._places = np.searchsorted(names, numbers[self._nodes])
        self._vertices = dofmap.list[:, : vertex_count(body.source.kind)]
        self._owned, self._count = index_map.size_local, count

    def made(self, name: str, values: Floats, *, corners: bool | None = None) -> fem.Function:
        """Return the function of a name with values at the nodes, in the order of the ``names``."""
        corners = self._corners if corners is None else corners
        element = ("Lagrange", 1) if corners else self._element
        function = fem.Function(fem.functionspace(self._mesh, element), name=name)
        nodal = np.zeros(self._count)
        nodal[self._nodes] = values[self._places]
        if corners:
            function.x.array[function.function_space.dofmap.list] = nodal[self._vertices]
        else:
            function.x.array[:] = nodal
        return function

    def values(self, function: fem.Function) -> Floats:
        """Return the values of a function, as `made` makes them, on all ranks; collective."""
        nodal = np.zeros(self._count)
        if self._corners:
            nodal[self._vertices] = function.x.array[function.function_space.dofmap.list]
        else:
            nodal[:] = function.x.array
        values = np.zeros(len(self._names))
        mine = self._nodes < self._owned
        values[self._places[mine]] = nodal[self._nodes[mine]]
        self._mesh.comm.Allreduce(MPI.IN_PLACE, values, MPI.SUM)
        return values
