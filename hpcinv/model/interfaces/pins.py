"""Springs for the rigid motions of a part that contact alone does not hold; no force is left in them.

A plane contact leaves a part free to move along it. The mean rigid motion of outer nodes of the contact in these
directions is measured, ``c = W u``, and the part gets the forces ``-κ Wᵀ (c - c₀)``. Motions that pressure holds are
left out of ``W``. Pressure balances the loads of the part, or nothing does: in equilibrium these forces are zero,
whatever κ is, and ``c = c₀`` says where the part is.
"""

from __future__ import annotations

import itertools

import numpy as np
from petsc4py import PETSc

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.nondimensional import Scales
from hpcinv.errors import MeshError
from hpcinv.mesh.source import Floats, Ints
from hpcinv.model.contacts import MOST_UNBALANCED
from hpcinv.model.interfaces.entries import matrix_of_entries
from hpcinv.model.spaces import Unknowns

STIFFNESS = 1.0
"""κ in scaled moduli times the length of the part. Raised or lowered by orders, the tangent is worse conditioned."""
_HELD = 1e-6
"""Share of the best held motion above which pressure holds one. Raised, springs hold motions of curved surfaces."""


class Pins:
    """Springs of one part; construction and methods are collective.

    Args:
        region: of the part, on an interface, which messages name.
        points: nodes of that region (n, 3), scaled, and the numbers of their unknowns (n, 3), on all ranks.
        normals: unit normals (m, 3) of contacts, or other held directions, at places (m, 3).

    Attributes:
        count: number of motions that pressure does not hold.
        places: ``c₀`` (count,), scaled; 0 unless it is set.
        follows: whether the part stays where the state is that a solve begins with: pressures are given.
        balance: force of the springs in the last solution, by the contact's.
        version: number of the pattern of `stiffness`, which is constant.
    """

    version = 1

    def __init__(
        self,
        region: str,
        points: tuple[Floats, Ints],
        normals: tuple[Floats, Floats],
        unknowns: Unknowns,
        comm: MPI.Intracomm,
    ) -> None:
        self.region, self._unknowns, self._comm, self.balance = region, unknowns, comm, 0.0
        self.follows = False
        places, numbers = _in_order(*points)
        self._middle = places.mean(axis=0)
        self._size = float(np.linalg.norm(places - self._middle, axis=1).max())
        free, held = _motions(np.einsum("ni,nij->nj", normals[0], self._rigid(normals[1])))
        chosen = _outer(places, self._middle)
        self.count, self._points = free.shape[1], places[chosen]
        modes = self._rigid(self._points).reshape(-1, 6) @ np.hstack([free, held])
        self.places: Floats = np.zeros(self.count)
        self._rates: Floats = np.asarray(np.linalg.pinv(modes)[: self.count], dtype=np.float64)
        rows = np.repeat(np.arange(self.count), 3 * len(chosen))
        columns = np.tile(numbers[chosen].ravel(), self.count)
        self._owned = unknowns.space.dofmap.index_map.size_local * unknowns.space.dofmap.index_map_bs
        own = slice(None if comm.rank == 0 else 0)  # every rank has computed the entries; only rank 0 adds them
        sizes = (PETSc.DECIDE, self.count), (self._owned, PETSc.DETERMINE)
        entries = (rows[own], columns[own])
        self._matrix = matrix_of_entries(comm, *sizes, entries, self._rates.ravel()[own])
        self._left, self._right = self._matrix.createVecLeft(), self._matrix.createVecRight()

    def _rigid(self, places: Floats) -> Floats:
        """Return the displacements (n, 3, 6) of places by unit motions and turns, of the length of the part."""
        arms = (places - self._middle) / self._size
        turns = np.stack([np.cross(axis, arms) for axis in np.eye(3)], axis=2)
        return np.concatenate([np.broadcast_to(np.eye(3), turns.shape), turns], axis=2)

    def add_forces(self, forces: Floats) -> None:
        """Add the forces of the springs to residuals (owned unknowns at first)."""
        self.add_products(self._unknowns.state.x.petsc_vec, forces)
        forces[: self._owned] -= self.forces_of(self.places)

    def add_products(self, x: PETSc.Vec, forces: Floats) -> None:
        """Add the stiffness times a vector of the unknowns to residuals (owned unknowns at first)."""
        forces[: self._owned] += self.forces_of(self.motion(x))

    def motion(self, x: PETSc.Vec) -> Floats:
        """Return ``W x`` (count,) of a vector of the unknowns, on all ranks."""
        self._matrix.mult(x, self._left)
        return np.concatenate(self._comm.allgather(np.array(self._left.array)))

    def forces_of(self, motion: Floats) -> Floats:
        """Return the forces ``κ Wᵀ c`` (owned unknowns, scaled) of a motion c (count,)."""
        start, end = self._left.getOwnershipRange()
        self._left.array[:] = motion[start:end]
        self._matrix.multTranspose(self._left, self._right)
        forces: Floats = STIFFNESS * self._size * self._right.array
        return forces

    def begin(self) -> None:
        """Let the part stay where it is in the present state, if it follows."""
        if self.follows:
            self.places = self.motion(self._unknowns.state.x.petsc_vec)

    def along(self, direction: Floats) -> Floats:
        """Return the motion (count,) that is nearest to a translation along a direction (3,)."""
        return self._rates @ np.tile(direction, len(self._points))

    def stiffness(self, free: PETSc.Vec) -> PETSc.Mat:
        """Return the new matrix of the springs, for 1 of ``free`` unknowns and 0 of others."""
        matrix = self._matrix.copy()
        matrix.diagonalScale(None, free)
        product = matrix.transposeMatMult(matrix)
        matrix.destroy()
        product.scale(STIFFNESS * self._size)
        return product

    def check_balance(self, contact_force: float, scales: Scales) -> None:
        """Note how the loads of the part are balanced in a solution.

        Args:
            contact_force: force by which contacts press, scaled.

        Raises:
            MeshError: on all ranks, if pressure does not balance the loads.
        """
        motion = self.motion(self._unknowns.state.x.petsc_vec) - self.places
        forces = STIFFNESS * self._size * (self._rates.T @ motion).reshape(-1, 3)
        force = forces.sum(axis=0)
        moment = np.cross(self._points - self._middle, forces).sum(axis=0)
        size = max(float(np.linalg.norm(force)), float(np.linalg.norm(moment)) / self._size)
        self.balance = size / contact_force if contact_force > 0 else float(size > 0)
        if self.balance <= MOST_UNBALANCED:
            return
        unit = scales.stress * scales.length**2
        texts = [
            f"{np.linalg.norm(v) * u:.3g} {name} ({', '.join(f'{c * u:.3g}' for c in v)})"
            for v, u, name in ((force, unit, "N"), (moment, unit * scales.length, "N m"))
        ]
        raise MeshError(
            f"interfaces: pressure does not balance the loads of the part with '{self.region}', which nothing else"
            f" holds: {' and '.join(texts)} are left",
            "Hold this motion by a support, or correct the loads; friction would hold it, too.",
        )

    def destroy(self) -> None:
        """Free PETSc objects."""
        for part in (self._matrix, self._left, self._right):
            part.destroy()


def _in_order(places: Floats, numbers: Ints) -> tuple[Floats, Ints]:
    """Return distinct nodes in an order that does not depend on ranks."""
    _, first = np.unique(numbers[:, 0], return_index=True)
    places, numbers = places[first], numbers[first]
    order = np.lexsort(np.round(places, 9).T)
    return places[order], numbers[order]


def _motions(rows: Floats) -> tuple[Floats, Floats]:
    """Return bases of the motions (6, k) that do not, and that do, change the gaps by rows (n, 6)."""
    _, sizes, axes = np.linalg.svd(np.vstack([rows, np.zeros((6, 6))]), full_matrices=False)
    is_held = sizes > _HELD * sizes[0]
    return axes[~is_held].T, axes[is_held].T


def _outer(places: Floats, middle: Floats) -> Ints:
    """Return the outermost nodes in eight directions: of a symmetric surface they are symmetric, too."""
    signs = np.array(list(itertools.product((1, -1), repeat=3)))
    return np.unique(np.round((places - middle) @ signs.T, 9).argmax(axis=0))
