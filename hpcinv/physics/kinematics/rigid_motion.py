"""Finite rigid motions of a region, as displacements of points of the reference or the current body."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

type _Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class RigidMotion:
    """``x = R (X - c) + c + t``, with a rotation R by an ``angle`` (rad) about an ``axis`` through ``c``."""

    angle: float
    axis: Any
    centre: Any
    move: Any

    @property
    def rotation(self) -> _Floats:
        """Rotation (3, 3) by Rodrigues' formula."""
        axis = np.array(self.axis, dtype=float) / np.linalg.norm(self.axis)
        cross = np.cross(np.eye(3), axis)
        rotation: _Floats = np.eye(3) + np.sin(self.angle) * cross + (1 - np.cos(self.angle)) * cross @ cross
        return rotation

    def displacement(self, points: _Floats, direction: Literal["forward", "inverse"]) -> _Floats:
        """Return ``x - X`` (n, 3) of points of the body that an analysis of that direction is given."""
        rotation, centre, move = self.rotation, np.array(self.centre), np.array(self.move)
        if direction == "forward":
            moved: _Floats = (points - centre) @ rotation.T + centre + move - points
            return moved
        unmoved: _Floats = (points - centre - move) @ rotation + centre
        return points - unmoved


def rotation_matrix(vector: _Floats) -> _Floats:
    """Return the rotation (3, 3) by a rotation vector, angle (rad) times axis."""
    angle = float(np.linalg.norm(vector))
    return RigidMotion(angle, vector, np.zeros(3), np.zeros(3)).rotation if angle else np.eye(3)


def rotation_vector(rotation: _Floats) -> _Floats:
    """Return angle (rad, at most π) times axis of a rotation (3, 3).

    Source: Bar-Itzhack, J. Guid. Control Dyn. 23, 1085 (2000), doi:10.2514/2.4654 (the quaternion as an eigenvector).
    """
    quadratic = np.empty((4, 4))
    quadratic[:3, :3] = rotation + rotation.T - np.trace(rotation) * np.eye(3)
    quadratic[:3, 3] = quadratic[3, :3] = [rotation[k - 1, k - 2] - rotation[k - 2, k - 1] for k in range(3)]
    quadratic[3, 3] = np.trace(rotation)
    quaternion = np.linalg.eigh(quadratic)[1][:, -1]
    sine, cosine = float(np.linalg.norm(quaternion[:3])), float(quaternion[3])
    if not sine:
        return np.zeros(3)
    vector: _Floats = 2 * np.arctan2(sine, abs(cosine)) * np.copysign(1.0, cosine) * quaternion[:3] / sine
    return vector
