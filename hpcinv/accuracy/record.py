"""What a search for accuracy did, and what it promises."""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from hpcinv.certificate.check import Line, Verdict


class Ending(enum.Enum):
    """How a search ended: what a user is told, and what to try."""

    MET = "met", ""
    LIMIT = (
        "not met: nothing that is possible within the limits would be much more accurate",
        "raise solver.maximum_unknowns, take a machine with more memory, or demand less",
    )
    STEPS = "not met: too many steps", "the error hardly falls: give a mesh that is finer where the stress concentrates"
    UNSOLVED = (
        "not met: with a better discretisation the load was not reached",
        "perhaps no such shape exists, and a coarse mesh only seemed to find one",
    )

    def __init__(self, text: str, advice: str) -> None:
        self.text = text
        self.advice = advice


@dataclass(frozen=True)
class AccuracyStep:
    """One step: the mesh and how it came to be, and what was found on it.

    Attributes:
        errors: estimated errors of the quantities (SI), without a safety factor.
        bounds: the same with it.
        excess: the largest bound over its demand. All are ``None`` where one mesh alone cannot tell.
        left_out: what the estimate has to add, if it has no error of the geometry.
        seconds: of the whole step.
    """

    mesh: str
    cells: int
    degree: int
    unknowns: int
    values: Mapping[str, Any]
    errors: Mapping[str, float | None]
    bounds: Mapping[str, float | None]
    excess: float | None
    left_out: str
    factorizations: int
    seconds: float

    @property
    def text(self) -> str:
        """One line for a user."""
        seen = ", ".join(f"{name} ± {'?' if bound is None else f'{bound:.3g}'}" for name, bound in self.bounds.items())
        excess = "one mesh cannot tell" if self.excess is None else f"{self.excess:.2g} of what is allowed"
        return (
            f"  {self.mesh}: {self.cells} cells, degree {self.degree}, {self.unknowns} unknowns,"
            f" {self.factorizations} factorizations, {self.seconds:.1f} s: {seen} ({excess}){self.left_out}"
        )


@dataclass(frozen=True)
class AccuracyRecord:
    """The demands, the steps, and the ending.

    Attributes:
        chosen: number of the step whose result is given, from 0.
        bounds: estimated errors of that with their safety factors.
        seconds: of all steps.
    """

    demands: Mapping[str, float]
    rows: Sequence[AccuracyStep]
    chosen: int
    bounds: Mapping[str, float]
    ending: Ending
    seconds: float

    def lines(self) -> list[Line]:
        """One for the certificate from each demand."""
        return [self._line(name, demand) for name, demand in self.demands.items()]

    def _line(self, name: str, demand: float) -> Line:
        met = self.bounds[name] <= demand
        rule = f"fail above {demand:g}, which accuracy.{name} demands"
        note = "" if met else f"{self.ending.text}: {self.ending.advice}"
        note = (note + self.rows[self.chosen].left_out).removeprefix(", ")
        return Line(f"error of {name}", self.bounds[name], "", rule, Verdict.PASS if met else Verdict.FAIL, note)

    def as_data(self) -> dict[str, Any]:
        """The record as JSON data."""
        return {
            "demands": dict(self.demands),
            "ending": self.ending.name,
            "bounds": dict(self.bounds),
            "chosen": self.chosen,
            "steps": [asdict(row) for row in self.rows],
            "seconds": self.seconds,
        }
