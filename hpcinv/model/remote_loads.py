"""Regions under remote loads: they move as rigid bodies, by motions that balance a force and a moment."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.job.support import Motion
from hpcinv.mesh.source import Floats
from hpcinv.model.spaces import Unknowns
from hpcinv.physics.kinematics.rigid_motion import rotation_matrix, rotation_vector


class RemoteFace:
    """Nodes of a region under a remote load, made on the given mesh.

    In the unknown body they have the places ``y = c + t + Q (p - c)``, with ``p`` their places in the mesh and ``c``
    the reference point there. The motion begins with ``Q = 1`` and ``t = 0``.

    Attributes:
        dofs: owned unknowns of the nodes, (n, 3).
        turn: Q; move: t, in scaled lengths.
    """

    def __init__(self, region: str, space: fem.FunctionSpace, nodes: LocalIndices, unknowns: Unknowns) -> None:
        self.region = region
        self._space, self._comm = space, space.mesh.comm
        dofs = unknowns.displacement_dofs_of_nodes[nodes]
        is_owned: npt.NDArray[np.bool_] = np.isin(dofs[:, 0], unknowns.owned_displacement_dofs)
        self.dofs, self._nodes = dofs[is_owned], nodes[is_owned]
        self._given_points = self._present_points()
        self.begin(np.zeros(3))

    def begin(self, about: Floats) -> None:
        """Begin with the mesh as it lies, without motion; collective.

        Args:
            about: reference point (scaled) in the given mesh; the region of this mesh is a rigid image of that one.
        """
        points = self._present_points()
        turn, (before, now) = self._fit(self._given_points, points)
        self._centre: Floats = now + turn @ (about - before)
        self._offsets = points - self._centre
        self.turn, self.move = np.eye(3), np.zeros(3)

    def offsets(self) -> Floats:
        """Return places of the nodes in the unknown body relative to its reference point, (n, 3)."""
        return np.asarray(self._offsets @ self.turn.T)

    def arms(self, sign: int) -> Floats:
        """Return places of the nodes in the loaded body relative to its reference point, (n, 3).

        Args:
            sign: of the kinematics.
        """
        return self.offsets() if sign > 0 else self._offsets

    def displacement(self, points: Floats, sign: int) -> Floats:
        """Return ``x - X`` (n, 3) of points of the mesh."""
        moved = (points - self._centre) @ (self.turn - np.eye(3)).T + self.move  # exactly 0 without a motion
        return np.asarray(sign * moved)

    def rate(self, points: Floats, sign: int, change: Floats) -> Floats:
        """Return the derivative (n, 3) of `displacement` by a translation and a spin, (6,)."""
        offsets = (points - self._centre) @ self.turn.T
        return np.asarray(sign * (change[:3] + np.cross(change[3:], offsets)))

    def change(self, change: Floats) -> None:
        """Move by a translation and a spin, (6,)."""
        self.move = self.move + change[:3]
        self.turn = rotation_matrix(change[3:]) @ self.turn

    def recover(self, displacements: Floats, sign: int) -> None:
        """Set the motion by which the nodes have ``displacements`` (n, 3); collective."""
        points = self._present_points()
        self.turn, (before, after) = self._fit(points, points + sign * displacements)
        self.move = after + self.turn @ (self._centre - before) - self._centre

    def motion(self, sign: int, length: float) -> Motion:
        """Return the motion from the unloaded to the loaded body in SI, for a unit ``length`` of scaled lengths."""
        turn, about, move = self.turn, self._centre, self.move
        if sign < 0:
            turn, about, move = turn.T, about + move, -move
        vector = rotation_vector(turn)
        angle = float(np.linalg.norm(vector))
        axis = vector / angle if angle else np.array([0.0, 0.0, 1.0])
        return Motion.model_construct(
            rotate=angle, axis=_triple(axis), about=_triple(about * length), move=_triple(move * length)
        )

    def sum(self, vectors: Floats) -> Floats:
        """Return the sum of vectors (n, …) at the owned nodes over all ranks; collective."""
        total: Floats = self._comm.allreduce(vectors.sum(axis=0), op=MPI.SUM)
        return total

    def _present_points(self) -> Floats:
        points: Floats = self._space.tabulate_dof_coordinates()[self._nodes]
        return points

    def _fit(self, points: Floats, images: Floats) -> tuple[Floats, tuple[Floats, Floats]]:
        """Return the rotation, and centres before and after it, that move points nearest to their images.

        Source: Kabsch, Acta Cryst. A32, 922 (1976), doi:10.1107/S0567739476001873.
        """
        count = self._comm.allreduce(len(points), op=MPI.SUM)
        before, after = self.sum(points) / count, self.sum(images) / count
        covariance = self.sum(np.einsum("ni,nj->nij", images - after, points - before))
        left, _, right = np.linalg.svd(covariance)
        left[:, 2] *= np.linalg.det(left @ right)
        return left @ right, (before, after)


def _triple(vector: Floats) -> tuple[float, float, float]:
    x, y, z = (float(component) for component in vector)
    return x, y, z
