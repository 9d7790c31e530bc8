"""What PETSc's own log has counted."""

from __future__ import annotations

import hpcinv.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
from petsc4py import PETSc


def logged_seconds() -> dict[str, float]:
    """Seconds that PETSc's log has counted on this rank, by phase."""
    if not PETSc.Log.isActive():
        PETSc.Log.begin()
    events = {"linear solve": "KSPSolve"}
    return {phase: PETSc.Log.Event(event).getPerfInfo()["time"] for phase, event in events.items()}
