"""Spaces in which functions jump from one layer of cells to the next, distributed over the ranks.

A degree of freedom has one copy for each layer around it, however the cells of a layer touch there, and on whichever
rank they are. One copy keeps the number; the others get numbers after those that their owner has. A copy belongs to the
owner of the degree of freedom if that has a cell of the layer there, else to the first rank that has one.
"""

from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import cpp, fem

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh.source import Ints

_TAG = 1  # of messages by which ranks agree on a map
MOST_LAYERS = 4
"""Layers around a degree of freedom above which it stays continuous. With more copies than that, as where each
tetrahedron is a layer of its own, displacements of degree 2 do not hold all pressures: the inf-sup constant, 0.16 and
above with 4, falls to 0 with 6."""
_KEPT = -1  # owner of a copy that keeps its number


def split(space: fem.FunctionSpace, columns: slice, layers: Ints) -> fem.FunctionSpace:
    """Return a space like ``space``, whose functions jump where layers meet; collective.

    Args:
        space: with blocks of size 1.
        columns: degrees of freedom of a cell that are split, the others stay continuous.
        layers: number of the layer of each local cell.
    """
    mesh, dofmap = space.mesh, space.dofmap
    dofs = dofmap.list.copy()
    copies = _Copies(mesh.comm, dofmap.index_map, dofs[:, columns], layers, mesh.topology.index_map(3).size_local)
    dofs[:, columns] = copies.cell_copies
    index_map, dofs = copies.numbered(dofs)
    split_map = cpp.fem.DofMap(dofmap.dof_layout, index_map, 1, cpp.graph.AdjacencyList_int32(dofs), 1)
    cpp_space = cpp.fem.FunctionSpace_float64(mesh._cpp_object, space.element._cpp_object, split_map)
    return fem.FunctionSpace(mesh, space.ufl_element(), cpp_space)


class _Copies:
    """Copies of degrees of freedom by layers; collective.

    Args:
        numbers: map of the degrees of freedom.
        dofs: of the local cells that are split, (cells, n).
        owned: number of owned cells.

    Attributes:
        cell_copies: copies in each cell, numbered after all ``dofs`` of the map unless they keep their
            number, (cells, n).
    """

    def __init__(self, comm: MPI.Intracomm, numbers: Any, dofs: Ints, layers: Ints, owned: int) -> None:
        self._comm, self._numbers = comm, numbers
        local = numbers.size_local + numbers.num_ghosts
        known = np.unique(np.concatenate(comm.allgather(np.unique(layers))))
        width = max(len(known), 1)
        keys = dofs.astype(np.int64) * width + np.searchsorted(known, layers)[:, None]
        unique, inverse = np.unique(keys, return_inverse=True)
        dof, layer = np.divmod(unique, width)
        is_in_own_cell = np.zeros(len(unique), dtype=bool)
        is_in_own_cell[inverse.reshape(keys.shape)[:owned]] = True
        names = numbers.local_to_global(np.arange(local, dtype=np.int32))[dof] * width + layer  # on all ranks the same
        rank_of_dof = np.full(len(dof), comm.rank, dtype=np.int64)
        is_ghost = dof >= numbers.size_local
        rank_of_dof[is_ghost] = np.asarray(numbers.owners)[dof[is_ghost] - numbers.size_local]

        owners = self._owners(width, names, is_in_own_cell, rank_of_dof)
        is_new, is_mine = owners != _KEPT, owners == comm.rank
        copy = np.where(is_new, 0, dof)
        copy[is_new] = local + np.arange(np.count_nonzero(is_new))
        self.cell_copies: Ints = copy[inverse].reshape(keys.shape)
        self._is_mine, self._owners_of_new = is_mine[is_new], owners[is_new]
        self._names_of_new = names[is_new]

    def _owners(self, width: int, names: Ints, is_in_own_cell: npt.NDArray[np.bool_], rank_of_dof: Ints) -> Ints:
        """Return the rank that owns each copy of this rank, `_KEPT` for one that keeps its number."""
        comm = self._comm
        destinations = [np.flatnonzero(rank_of_dof == rank) for rank in range(comm.size)]
        received = comm.alltoall([np.stack([names[rows], is_in_own_cell[rows]], axis=1) for rows in destinations])
        rank = np.repeat(np.arange(comm.size), [len(part) for part in received])
        table = np.concatenate(received)
        here = rank == comm.rank
        # Ranks with a cell of their own come first, among them the owner of the degree of freedom.
        order = np.lexsort((rank, ~here, table[:, 1] == 0, table[:, 0]))
        name, first, number = np.unique(table[order, 0], return_index=True, return_inverse=True)
        owner = rank[order][first]
        # The first copy of the owner keeps the number.
        dof = name // width
        dof_order = np.lexsort((name, owner != comm.rank, dof))
        kept = dof_order[np.unique(dof[dof_order], return_index=True)[1]]
        owner[kept] = _KEPT
        _, which, copies = np.unique(dof, return_inverse=True, return_counts=True)
        owner[copies[which] > MOST_LAYERS] = _KEPT
        answers = np.empty(len(table), dtype=np.int64)
        answers[order] = owner[number]
        returned = comm.alltoall(np.split(answers, np.cumsum([len(part) for part in received])[:-1]))
        result = np.empty(len(names), dtype=np.int64)
        result[np.concatenate(destinations)] = np.concatenate(returned)
        return result

    def numbered(self, dofs: Ints) -> tuple[Any, npt.NDArray[np.int32]]:
        """Return a map with the copies, and local numbers in it instead of the numbers of `cell_copies`."""
        comm, numbers = self._comm, self._numbers
        owned, local = numbers.size_local, numbers.size_local + numbers.num_ghosts
        mine, other = np.flatnonzero(self._is_mine), np.flatnonzero(~self._is_mine)
        old_begins, begins = (np.cumsum([0, *comm.allgather(n)]) for n in (owned, owned + len(mine)))

        used = np.unique(dofs)
        ghosts = used[(used >= owned) & (used < local)] - owned  # without dofs that have only copies left
        owners = np.asarray(numbers.owners, dtype=np.int64)[ghosts]
        names = np.asarray(numbers.ghosts)[ghosts] - old_begins[owners] + begins[owners]

        destinations = [other[self._owners_of_new[other] == rank] for rank in range(comm.size)]
        order = np.argsort(self._names_of_new[mine])
        sought = comm.alltoall([self._names_of_new[rows] for rows in destinations])
        places = [owned + order[np.searchsorted(self._names_of_new[mine], rows, sorter=order)] for rows in sought]
        answers = comm.alltoall([begins[comm.rank] + place for place in places])
        other = np.concatenate(destinations)

        renumbered = np.zeros(local + len(self._is_mine), dtype=np.int32)
        renumbered[:owned] = np.arange(owned)
        renumbered[local + mine] = owned + np.arange(len(mine))
        renumbered[owned + ghosts] = owned + len(mine) + np.arange(len(ghosts))
        renumbered[local + other] = owned + len(mine) + len(ghosts) + np.arange(len(other))
        all_names = np.concatenate([names, *answers]).astype(np.int64)
        all_owners = np.concatenate([owners, self._owners_of_new[other]]).astype(np.int32)
        index_map = cpp.common.IndexMap(comm, owned + len(mine), all_names, all_owners, _TAG)
        return index_map, renumbered[dofs]
