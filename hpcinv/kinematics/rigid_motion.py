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
