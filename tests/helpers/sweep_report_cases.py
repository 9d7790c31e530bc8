"""Results of sweeps that reports show."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from helpers.sweeps import write_sweep
from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.sweep.sweep_plan import SweepPlan, load_sweep

MU, DENSITY = "material.mu", "effects[0].density"
NO_EQUILIBRIUM = "no equilibrium"


def plan(directory: Path, *axes: dict[str, Any], **more: Any) -> SweepPlan:
    return load_sweep(write_sweep(directory, list(axes), **more))


def statistics(**changes: Any) -> dict[str, Any]:
    """The parts of a summary that are looked at."""
    solutions = [{"factorizations": 3, "newton_iterations": 7}, {"factorizations": 2, "newton_iterations": 5}]
    whole: dict[str, Any] = {
        "mesh": {"unknowns": 375},
        "machine": {"ranks": 2},
        "solutions": solutions,
        "quantities": {"top": -0.25},
        "certificate": {"verdict": "pass", "lines": [], "estimate": None},
        "peak_memory": {"ranks": [100, 300], "phases": {}},
    }
    return whole | changes


def good(seconds: float = 1.0, **changes: Any) -> CaseRecord:
    return CaseRecord("converged", "", statistics(**changes), seconds, 1)


def bad(status: str = NO_EQUILIBRIUM, seconds: float = 1.0) -> CaseRecord:
    return CaseRecord(status, "Lower the load.", {}, seconds, 1)
