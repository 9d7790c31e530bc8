"""Axes by vectors, as the files of several programs state them."""

from typing import Any

import numpy as np


def frame_of(first: Any, second: Any) -> Any:
    """Return unit axes (3, 3), as rows: along the first vector, in the plane of both, and across it.

    ``None`` if the vectors are on one line, or not finite.
    """
    third = np.cross(first, second)
    frame = np.array([first, np.cross(third, first), third])
    lengths = np.linalg.norm(frame, axis=1)
    return frame / lengths[:, None] if np.isfinite(frame).all() and lengths.all() else None


def rotation(axis: Any, angle: float) -> Any:
    """Return Rodrigues' matrix (3, 3) of a unit vector and an angle in radians."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
