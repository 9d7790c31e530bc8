"""What a run has left behind, as figures: from its summary, PETSc's log, and the clock."""

from __future__ import annotations

import csv
import statistics
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hpcinv.parallel.timings import WORK

SOLVER = ("residual", "tangent", "factorization", "linear solve", "newton", "admissibility check")
"""Phases from the first assembly to the solution."""
_OUTSIDE = ("newton", "admissibility check")  # kernels and PETSc


@dataclass(frozen=True)
class Run:
    """What one run has left.

    Attributes:
        seconds: from command to prompt.
        cpu: seconds of processor time of all ranks together.
        summary: that of the run, ``None`` if it did not come so far.
        events: of PETSc's log, by name one entry for each rank, if it was asked for.
        ending: its exit code, and what it printed as errors.
    """

    seconds: float
    cpu: float
    summary: Mapping[str, Any] | None
    events: Mapping[str, list[Mapping[str, float]]]
    ending: str

    @property
    def solved(self) -> bool:
        return self.summary is not None and self.summary["status"] == "converged"

    @property
    def _found(self) -> Mapping[str, Any]:
        assert self.summary is not None
        return self.summary

    @property
    def unknowns(self) -> int:
        return int(self._found["mesh"]["unknowns"])

    @property
    def factorizations(self) -> int:
        return sum(leg["factorizations"] for leg in self._found["legs"])

    @property
    def newton_iterations(self) -> int:
        return sum(leg["newton_iterations"] for leg in self._found["legs"])

    @property
    def krylov_iterations(self) -> int:
        """Of all linear solves, as PETSc's log has them: applications of the preconditioner."""
        return int(self.events["PCApply"][0]["count"])

    def phase(self, name: str) -> float:
        """Seconds on the rank that took longest."""
        phases = self._found["timings"]["phases"]
        return float(phases[name]["max"]) if name in phases else 0.0

    @property
    def phases(self) -> dict[str, float]:
        return {name: self.phase(name) for name in self._found["timings"]["phases"]}

    @property
    def solver(self) -> float:
        """Seconds of `SOLVER`."""
        return sum(map(self.phase, SOLVER))

    @property
    def outside_in_solver(self) -> float:
        """Share of these seconds that is neither assembly nor linear solver."""
        return sum(map(self.phase, _OUTSIDE)) / self.solver

    @property
    def total(self) -> float:
        """Seconds of the run once all is imported, without the compilation of kernels."""
        return float(self._found["timings"]["total"]) - self.phase("compile")

    @property
    def outside(self) -> float:
        """Share of the run's wall time outside of kernels, PETSc and MPI, as the summary has it."""
        return float(self._found["timings"]["overhead"])

    @property
    def outside_before_certificate(self) -> float:
        """The same without the certificate."""
        return 1 - sum(map(self.phase, WORK)) / (self.total + self.phase("compile") - self.phase("certificate"))

    @property
    def peak_memory(self) -> int:
        """Bytes, of all ranks together."""
        return int(sum(self._found["peak_memory"]["ranks"]))

    @property
    def fullest_rank(self) -> int:
        """Bytes."""
        return int(max(self._found["peak_memory"]["ranks"]))


def median(runs: list[Run], figure: Callable[[Run], float]) -> float:
    return statistics.median(map(figure, runs))


def events_in(log: Path) -> dict[str, list[Mapping[str, float]]]:
    """Events of PETSc's log (``-log_view :FILE:ascii_csv``), on each rank; stages are added up."""
    if not log.exists():
        return {}
    found: dict[str, dict[int, dict[str, float]]] = {}
    names = {"Count": "count", "Time": "seconds", "Num Messages": "messages", "Message Length": "bytes"}
    names |= {"Num Reductions": "reductions", "FLOP": "flops"}
    with log.open(newline="") as file:
        for row in csv.DictReader(file):
            sums = found.setdefault(row["Event Name"], {}).setdefault(
                int(row["Rank"]), dict.fromkeys(names.values(), 0.0)
            )
            for column, name in names.items():
                sums[name] += float(row[column])
    return {event: [by_rank[rank] for rank in sorted(by_rank)] for event, by_rank in found.items()}
