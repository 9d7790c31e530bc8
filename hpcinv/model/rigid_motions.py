"""Rigid motions of a body that supports leave free, and their descriptions.

A small rigid motion is ``u(x) = t + ω × (x - c)/ℓ``, six numbers ``(t, ω)`` in a frame of centre ``c`` and size ``ℓ``.
"""

from dataclasses import dataclass

import numpy as np

from hpcinv.job.vocabulary import AXES
from hpcinv.mesh.source import Floats

# Share of the best held motion below which one is free: above rounding errors, below any clamp that can be meshed.
_FREE = 1e-7
_SOFT = 1e-9  # likewise for the stiffness of springs
_ALONG = 0.95  # cosine of the angle to an axis up to which a direction is roughly called by its name
_TURNS = 0.1  # rotation relative to translation at the centre, above which a motion is roughly called a turn


@dataclass(frozen=True)
class Frame:
    """Frame of the six motions: ``centre`` (3,) and ``size``, in the length unit of the points."""

    centre: Floats
    size: float

    def motions(self, points: Floats) -> Floats:
        """Return displacements of ``points`` (n, 3) by the six motions, (n, 3, 6)."""
        r = (points - self.centre) / self.size
        motions = np.zeros((len(points), 3, 6))
        motions[:, range(3), range(3)] = 1.0
        motions[:, :, 3:] = np.stack([np.cross(axis, r) for axis in np.eye(3)], axis=2)
        return motions

    def moved(self, points: Floats, motion: Floats) -> Floats:
        """Return displacements (n, 3) of ``points`` (n, 3) by a ``motion`` (6,)."""
        displacements: Floats = motion[:3] + np.cross(motion[3:], (points - self.centre) / self.size)
        return displacements


def free_motions(constraints: Floats) -> Floats:
    """Return a basis (m, k) of the motions that do no work on supports.

    Args:
        constraints: rows (n, m), a prescribed displacement component for each of m motions, such as the six.
    """
    count = constraints.shape[1]
    _, singular, rows = np.linalg.svd(np.vstack([constraints, np.zeros((count, count))]), full_matrices=False)
    held = singular > _FREE * max(singular[0], np.finfo(float).tiny)
    free: Floats = rows[~held].T
    return free


def largest_stiffness(stiffness: Floats) -> float:
    """Return the largest stiffness of springs against one of the motions of a matrix (m, m)."""
    return float(np.abs(np.linalg.eigvalsh(stiffness)).max(initial=0.0))


def unsprung_basis(free: Floats, stiffness: Floats, stiffest: float) -> Floats:
    """Return a basis (m, l) of those motions of a basis (m, k) that do no work on springs.

    Args:
        stiffness: stiffness (m, m) of the springs.
        stiffest: the largest stiffness that they have against any motion of the whole body.
    """
    values, vectors = np.linalg.eigh(free.T @ stiffness @ free)
    soft: Floats = free @ vectors[:, np.abs(values) <= _SOFT * stiffest]
    return soft


def names(free: Floats, frame: Frame, length: float, unit: str = "m") -> list[str]:
    """Return descriptions of the motions of a basis (6, k), for a frame in lengths of ``length`` times ``unit``."""
    if free.shape[1] == 6:
        return ["move and turn in every way"]
    slides, turns = [], []
    for motion in _reduced(free):
        t, w = motion[:3], motion[3:] / frame.size
        if not w.any():
            slides.append(_direction(t))
            continue
        # The point on the axis of the motion that is closest to the origin.
        axis = w / np.linalg.norm(w)
        point = frame.centre + np.cross(w, t) / (w @ w)
        point = (point - (point @ axis) * axis) * length
        point[np.abs(point) < 1e-9 * length * (frame.size + np.abs(frame.centre).max())] = 0.0
        about = f"about the axis through {_triple(point)} {unit} along {_direction(w)}"
        is_screw = abs(t @ axis) > 1e-6
        turns.append(f"screw {about}" if is_screw else f"turn {about}")
    return [*([f"move along {' and '.join(slides)}"] if slides else []), *turns]


def nearest_name(motion: Floats, frame: Frame, length: float) -> str:
    """Return a description of the translation or turn that is nearest to a motion (6,); ``frame`` as for `names`."""
    size = frame.size * length
    translation, turn = motion[:3], motion[3:]
    if np.linalg.norm(turn) < _TURNS * np.linalg.norm(translation):
        return f"move along {rounded_direction(translation)}"
    # The point on the axis that is closest to the origin.
    point = frame.centre * length + np.cross(turn, translation) / (turn @ turn) * size
    point = point - (point @ turn) / (turn @ turn) * turn
    place = ", ".join(f"{c:.3g}" for c in np.round(point / size, 2) * size + 0.0)
    return f"turn about the axis through ({place}) m along {rounded_direction(turn)}"


def rounded_direction(vector: Floats) -> str:
    """Return the name of the axis that a vector (3,) is nearly along, or its direction."""
    unit = vector / np.linalg.norm(vector)
    axis = int(np.abs(unit).argmax())
    return AXES[axis] if abs(unit[axis]) > _ALONG else f"({', '.join(f'{c:.2g}' for c in unit.round(2) + 0.0)})"


def _reduced(free: Floats) -> Floats:
    """Return a basis of the same motions in reduced echelon form, rotations first, along the axes if possible."""
    rows = free.T.copy()
    done = 0
    for column in (3, 4, 5, 0, 1, 2):
        if done == len(rows):
            break
        pivot = done + int(np.argmax(np.abs(rows[done:, column])))
        if abs(rows[pivot, column]) < 1e-6:
            continue
        rows[[done, pivot]] = rows[[pivot, done]]
        rows[done] /= rows[done, column]
        others = np.arange(len(rows)) != done
        rows[others] -= np.outer(rows[others, column], rows[done])
        done += 1
    rows[np.abs(rows) < 1e-6] = 0.0
    return rows


def _direction(vector: Floats) -> str:
    unit = vector / np.linalg.norm(vector)
    axis = int(np.abs(unit).argmax())
    return AXES[axis] if abs(unit[axis]) > 1 - 1e-9 else _triple(unit)


def _triple(vector: Floats) -> str:
    return f"({', '.join(f'{c:.6g}' for c in vector + 0.0)})"
