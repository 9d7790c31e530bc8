"""Surfaces that an interface cannot join."""

from __future__ import annotations

from typing import NoReturn

import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import MeshError
from hpcinv.job.interfaces import Interface
from hpcinv.mesh.source import Floats, Ints
from hpcinv.model.interfaces.facets import Facets
from hpcinv.model.interfaces.segments import segments


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


def refuse_overlap(
    where: str, spec: Interface, names: Ints, gaps: Floats, first: Facets, comm: MPI.Intracomm
) -> NoReturn:
    """Raise an error about unloaded bodies that overlap; collective.

    Args:
        names: global numbers of the nodes with these gaps (m), on all ranks.
        first: facets of the first surface on this rank, in m.
    """
    (a, b), worst = spec.between, int(gaps.argmin())
    found = [first.points[row, k] for row, k in np.argwhere(first.nodes == names[worst])[:1]]
    place = next(part for parts in comm.allgather(found) for part in parts)
    raise MeshError(
        f"{where}.between: '{a}' and '{b}' of the unloaded bodies overlap by"
        f" {-gaps[worst]:.3g} m at ({', '.join(f'{c:.4g}' for c in place + 0.0)}) m",
        "Move the bodies apart; a motion of a support may press them together.",
    )
