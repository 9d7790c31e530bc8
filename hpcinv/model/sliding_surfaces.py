"""Smooth surfaces ``g = 0`` on which regions slide: of a formula, or fitted to the nodes of the region."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from hpcinv.base.parallel.ranks import on_root
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.expressions import Expression
from hpcinv.base.quantity.taylor import FUNCTIONS, Taylor
from hpcinv.errors import MeshError
from hpcinv.job.support import Support
from hpcinv.mesh.extent import diagonal
from hpcinv.mesh.source import Floats

_FARTHEST = 5e-3
"""Distance of nodes from their surface, in diagonals of their region; raised, a wrong radius may be accepted."""

_FLAT = 1e-5
"""Distance of nodes from their plane, in sizes of their region; raised, shallow curved regions are refused."""

_FITTED = {
    "sphere": "norm(x - a, y - b, z - c) - r",
    "cylinder": "norm((y - b)*w - (z - c)*v, (z - c)*u - (x - a)*w, (x - a)*v - (y - b)*u) - r",
}


@dataclass(frozen=True)
class SlidingSurface:
    """The surface on which a formula of x, y, z in m is zero; ``constants`` are values of further names."""

    formula: Expression
    constants: Mapping[str, float]

    def values(self, points: Floats) -> Taylor:
        """Return g with its derivatives at points (n, 3) in m; what does not exist is not finite."""
        variables: dict[str, Any] = {name: Taylor.variable(points[:, i], i, 3) for i, name in enumerate("xyz")}
        with np.errstate(all="ignore"):
            value: Taylor = self.formula.apply(variables | dict(self.constants), FUNCTIONS)
        return value

    def distances(self, points: Floats) -> Floats:
        """Return signed distances of points (n, 3) in m, to first order."""
        g = self.values(points)
        with np.errstate(all="ignore"):
            distances: Floats = g.value / np.linalg.norm(g.gradient, axis=1)
        return distances


def surface_of(
    spec: Support, field: str, points: Floats, normals: Floats, corners: Floats, comm: MPI.Intracomm
) -> SlidingSurface:
    """Return the surface of a support that slides; collective.

    Args:
        points, normals: of the region's boundary, (n, 3); the points in m.
        corners: geometry nodes of the region (n, 3) in m, which must be on the surface.

    Raises:
        MeshError: on all ranks, if they are not.
    """
    assert spec.surface is not None
    if spec.fitted_surface is None:
        surface = SlidingSurface(spec.surface, spec.constants)
    else:
        gathered = comm.gather((points, normals))

        def fit() -> SlidingSurface:
            assert gathered is not None
            all_points, all_normals = (np.vstack(parts) for parts in zip(*gathered, strict=True))
            if is_flat(all_points):
                raise MeshError(
                    f"{field}.surface: '{spec.region}' is flat, so that no {spec.fitted_surface} fits it",
                    "Leave 'surface' out: 'fix: [normal]' lets a flat region slide exactly.",
                )
            return _fitted(spec.surface.source, all_points, all_normals)  # type: ignore[union-attr]

        surface = on_root(comm, fit)
    distances = np.abs(surface.distances(corners))
    farthest = comm.allreduce(float(np.where(np.isfinite(distances), distances, np.inf).max(initial=0.0)), op=MPI.MAX)
    allowed = _FARTHEST * diagonal(comm, corners)
    if not farthest <= allowed:
        reason = f"nodes of '{spec.region}' are up to {farthest:.3g} m off '{spec.surface}' (allowed: {allowed:.3g} m)"
        if farthest == np.inf:
            reason = f"'{spec.surface}' has no value or no normal at some nodes of '{spec.region}'"
        raise MeshError(
            f"{field}.surface: {reason}",
            "Correct the formula (x, y, z in the given mesh), or name the region that lies on it.",
        )
    return surface


def is_flat(points: Floats) -> bool:
    """Return whether points (n, 3) are in a plane, but for rounding errors of their file."""
    arms = points - points.mean(axis=0)
    size = float(np.linalg.norm(arms, axis=1).max(initial=0.0))
    normal = np.linalg.svd(arms, full_matrices=False)[2][-1]
    return float(np.abs(arms @ normal).max(initial=0.0)) <= _FLAT * size


def _fitted(kind: str, points: Floats, normals: Floats) -> SlidingSurface:
    """Return the sphere or cylinder nearest to points (m) in the mean square."""
    from scipy.optimize import least_squares  # slow import

    middle = points.mean(axis=0)
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    arms = (points - middle) / size
    axis = np.linalg.eigh(normals.T @ normals)[1][:, 0] if kind == "cylinder" else np.zeros(3)
    flat = arms - np.outer(arms @ axis, axis)
    # |arm - c|² = r² is linear in c and r² - c².
    solution = np.linalg.lstsq(np.column_stack([2 * flat, np.ones(len(flat))]), (flat**2).sum(axis=1))[0]
    start = [*solution[:3], abs(solution[3] + solution[:3] @ solution[:3]) ** 0.5, *axis]

    def distances(p: npt.NDArray[np.float64]) -> Any:
        off = arms - p[:3]
        if kind == "cylinder":
            off = np.cross(off, p[4:] / np.linalg.norm(p[4:]))
        return np.linalg.norm(off, axis=1) - p[3]

    count = len(start) if kind == "cylinder" else 4
    best = least_squares(distances, start[:count], xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    constants = dict(zip("abcr", [*(middle + size * best[:3]), size * best[3]], strict=True))
    if kind == "cylinder":
        constants |= dict(zip("uvw", best[4:] / np.linalg.norm(best[4:]), strict=True))
    return SlidingSurface(Expression(_FITTED[kind]), {name: float(value) for name, value in constants.items()})
