"""Times from the log of PETSc."""

import hpcinv.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
from petsc4py import PETSc


def logged_seconds() -> dict[str, float]:
    """Seconds on this rank by phase, from the log of PETSc."""
    if not PETSc.Log.isActive():
        PETSc.Log.begin()
    events = {"linear solve": "KSPSolve"}
    return {phase: PETSc.Log.Event(event).getPerfInfo()["time"] for phase, event in events.items()}
