"""What a certificate consists of: lines, each a finding with its thresholds, and a verdict over all of them."""

from __future__ import annotations

import enum
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any


class Verdict(enum.Enum):
    """Of one finding, or of all, in the order of their severity.

    SKIPPED says that it was switched off or could not be found, UNDECIDED that what was found may be a fault of the
    body or of its discretisation.
    """

    PASS = "pass"
    SKIPPED = "not checked"
    UNDECIDED = "not decided"
    WARN = "warning"
    FAIL = "fail"

    def exit_code(self, *, strict: bool = False) -> int:
        """What the command line ends with: 0, 6 for a failed certificate; if ``strict``, 7 for what is in between."""
        if self is Verdict.FAIL:
            return 6
        return 7 if strict and self in (Verdict.WARN, Verdict.UNDECIDED) else 0


_SEVERITY = {verdict: i for i, verdict in enumerate(Verdict)}


@dataclass(frozen=True)
class Line:
    """One finding.

    Attributes:
        name: what was looked at.
        value: what was found, in ``unit`` (SI; empty for ratios and counts); ``None`` if nothing was.
        rule: the thresholds in words.
        note: what else a reader should know, or what to do about it.
    """

    name: str
    value: float | None
    unit: str
    rule: str
    verdict: Verdict
    note: str = ""


def at_most(name: str, value: float, warn: float, fail: float, unit: str = "", note: str = "") -> Line:
    """A finding that should be small; one that is not finite fails."""
    verdict = Verdict.PASS if value <= warn else Verdict.WARN if value <= fail else Verdict.FAIL
    return Line(name, value, unit, f"warning above {warn:g}, fail above {fail:g}", verdict, note)


def at_least(name: str, value: float, warn: float, fail: float, unit: str = "", note: str = "") -> Line:
    """A finding that should be large; it must be more than ``fail``, and one that is not finite fails."""
    verdict = Verdict.PASS if value >= warn else Verdict.WARN if value > fail else Verdict.FAIL
    return Line(name, value, unit, f"warning below {warn:g}, fail at {fail:g} and below", verdict, note)


def skipped(name: str, note: str) -> Line:
    """A finding that there is none of, and why."""
    return Line(name, None, "", "", Verdict.SKIPPED, note)


@dataclass(frozen=True)
class Certificate:
    """All findings on one run."""

    lines: tuple[Line, ...]

    @property
    def verdict(self) -> Verdict:
        """Fail if a finding fails, else a warning if there is one, else not decided if one is not, else pass."""
        return worst(line.verdict for line in self.lines)

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
            }
            for line in self.lines
        ]
        return {"verdict": self.verdict.value, "lines": lines}


def worst(verdicts: Iterable[Verdict]) -> Verdict:
    """The most severe of some verdicts; what was not checked does not count."""
    found = max(verdicts, key=_SEVERITY.__getitem__, default=Verdict.PASS)
    return Verdict.PASS if found is Verdict.SKIPPED else found
