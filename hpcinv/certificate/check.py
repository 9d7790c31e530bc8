"""Parts of a certificate: lines, each with its thresholds and verdict, and the verdict on the run."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import Any


class Verdict(enum.Enum):
    """Verdict of a line or of a certificate, in order of severity.

    SKIPPED: switched off, or could not be computed. UNDECIDED: the cause may be the body or its discretisation.
    """

    PASS = "pass"
    SKIPPED = "not checked"
    UNDECIDED = "not decided"
    WARN = "warning"
    FAIL = "fail"

    def exit_code(self, *, strict: bool = False) -> int:
        """Return the exit code: 6 for a failed certificate; if ``strict``, 7 for a warning or undecided; else 0."""
        if self is Verdict.FAIL:
            return 6
        return 7 if strict and self in (Verdict.WARN, Verdict.UNDECIDED) else 0


_SEVERITY = {verdict: i for i, verdict in enumerate(Verdict)}


@dataclass(frozen=True)
class Line:
    """One check and its result.

    Attributes:
        name: what was checked.
        value: the result, in ``unit`` (SI; empty for ratios and counts); ``None`` if there is none.
        rule: the thresholds in words.
        note: an explanation, or a remedy.
        seconds: time of the check (largest over the ranks). A check may have several lines: its time is with the first
            one, and the others have ``None``, so that the sum over all lines is the time of all checks.
        state: name of the state of the body; empty in a job without states.
    """

    name: str
    value: float | None
    unit: str
    rule: str
    verdict: Verdict
    note: str = ""
    seconds: float | None = None
    state: str = ""


def upper_bound_line(name: str, value: float, warn: float, fail: float, unit: str = "", note: str = "") -> Line:
    """Return the line of a value that should be small; a value that is not finite fails."""
    verdict = Verdict.PASS if value <= warn else Verdict.WARN if value <= fail else Verdict.FAIL
    rule = f"warning above {warn:g}" + (f", fail above {fail:g}" if fail < math.inf else "")
    return Line(name, value, unit, rule, verdict, note)


def lower_bound_line(name: str, value: float, warn: float, fail: float, unit: str = "", note: str = "") -> Line:
    """Return the line of a value that must exceed ``fail``; a value that is not finite fails."""
    verdict = Verdict.PASS if value >= warn else Verdict.WARN if value > fail else Verdict.FAIL
    rule = f"warning below {warn:g}" + (f", fail at {fail:g} and below" if fail > -math.inf else "")
    return Line(name, value, unit, rule, verdict, note)


def skipped(name: str, note: str) -> Line:
    """Return the line of a check that was not made, with the reason."""
    return Line(name, None, "", "", Verdict.SKIPPED, note)


@dataclass(frozen=True)
class Certificate:
    """All checks of one run."""

    lines: tuple[Line, ...]

    @property
    def verdict(self) -> Verdict:
        """The most severe verdict of the lines; `Verdict.SKIPPED` counts only if nothing was checked."""
        verdicts = {line.verdict for line in self.lines}
        return max(verdicts - {Verdict.SKIPPED}, key=_SEVERITY.__getitem__, default=Verdict.SKIPPED)

    def as_data(self) -> dict[str, Any]:
        """The certificate as JSON data."""
        lines = [
            {
                "name": line.name,
                "value": line.value,
                "unit": line.unit,
                "rule": line.rule,
                "verdict": line.verdict.value,
                "note": line.note,
                "seconds": line.seconds,
            }
            | ({"state": line.state} if line.state else {})
            for line in self.lines
        ]
        return {"verdict": self.verdict.value, "lines": lines}
