"""Surfaces that an interface cannot join."""

from __future__ import annotations

from collections.abc import Callable
from typing import NoReturn

import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import MeshError
from hpcinv.job.interfaces import Interface
from hpcinv.mesh import Body
from hpcinv.mesh.source import Floats
from hpcinv.model.interfaces.facets import Facets
from hpcinv.model.interfaces.segments import segments

_OVERLAP = 2.0**-6
"""Overlap of unloaded bodies in contact that is refused, in lengths of the body."""


def refuse_surfaces(
    where: str, spec: Interface, first: Facets, second: Facets, length_scale: float, comm: MPI.Intracomm
) -> NoReturn:
    """Raise an error about surfaces that are not near each other; collective.

    Args:
        length_scale: length (m) of one unit of the facets.
    """
    (a, b), found = spec.between, segments(first, second, np.inf)
    nearest = found.gaps[np.abs(found.gaps).argmin()] if len(found.gaps) else np.inf
    gaps = np.array(comm.allgather(float(nearest)))
    gap = float(gaps[np.abs(gaps).argmin()] * length_scale)
    if not np.isfinite(gap):
        raise MeshError(
            f"{where}.between: '{a}' and '{b}' do not face each other",
            "Name two surfaces whose outer normals point to each other.",
        )
    what = "apart" if gap > 0 else "into each other"
    raise MeshError(
        f"{where}.between: '{a}' and '{b}' are {abs(gap):.3g} m {what}: they cannot be {spec.kind}",
        "Move the bodies together, or mesh them up to a common surface.",
    )


def check_overlap(where: str, spec: Interface, gaps: Floats, body: Body, place_of: Callable[[int], Floats]) -> None:
    """Raise an error if unloaded bodies overlap; collective.

    Args:
        gaps: of the functions, scaled, on all ranks.
        place_of: returns the place (m) of the node of a function.
    """
    if gaps.min(initial=0.0) >= -_OVERLAP * body.length:
        return
    worst, (a, b) = int(gaps.argmin()), spec.between
    raise MeshError(
        f"{where}.between: '{a}' and '{b}' of the unloaded bodies overlap by {-gaps[worst] * body.length_scale:.3g} m"
        f" at ({', '.join(f'{c:.4g}' for c in place_of(worst) + 0.0)}) m",
        "Move the bodies apart; a motion of a support may press them together.",
    )


def check_obstacle(where: str, region: str, gaps: Floats, body: Body, place_of: Callable[[int], Floats]) -> None:
    """Raise an error if an obstacle overlaps the unloaded body; collective, with arguments as of `check_overlap`."""
    if gaps.min(initial=0.0) >= -_OVERLAP * body.length:
        return
    worst = int(gaps.argmin())
    raise MeshError(
        f"{where}: the obstacle overlaps '{region}' of the unloaded body by {-gaps[worst] * body.length_scale:.3g} m"
        f" at ({', '.join(f'{c:.4g}' for c in place_of(worst) + 0.0)}) m",
        "Move it back and let it 'travel' into place, or turn its normal; check its unit.",
    )
