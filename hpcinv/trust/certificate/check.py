"""Parts of a certificate: lines, each with its topic, thresholds and verdict, and the verdict on the run."""

from __future__ import annotations

import enum
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
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

    @classmethod
    def named(cls, text: str | None) -> Verdict:
        """Return the verdict of a record; UNDECIDED if that is missing, or of another version that has more."""
        return next((verdict for verdict in cls if verdict.value == text), cls.UNDECIDED)

    def exit_code(self, *, strict: bool = False) -> int:
        """Return the exit code: 6 for a failed certificate; if ``strict``, 7 for a warning or undecided; else 0."""
        if self is Verdict.FAIL:
            return 6
        return 7 if strict and self in (Verdict.WARN, Verdict.UNDECIDED) else 0


_SEVERITY = {verdict: i for i, verdict in enumerate(Verdict)}


@dataclass(frozen=True)
class Topic:
    """What lines of one kind are about, as certificate, report and documentation have it.

    Attributes:
        name: beginning of a line; "…" in it is a place, such as the name of a region.
        meaning: one sentence.
        remedy: what to do about a line that does not pass.
        remedy_if_undecided: the same of a line that is not decided, if that is something else.
        computed: what is computed, with links from ``docs/reference``.
        thresholds: where it warns; where it fails.
        costs: what the check takes; empty if little.
        judges_mesh: whether a line that does not pass doubts what a search for accuracy promises.
    """

    name: str
    meaning: str
    remedy: str = ""
    remedy_if_undecided: str = ""
    computed: str = ""
    thresholds: str = ""
    costs: str = ""
    judges_mesh: bool = field(default=False, kw_only=True)

    def placed(self, place: str) -> Topic:
        """Return the topic with the place of a line in its name."""
        return replace(self, name=self.name.replace("…", place))


TOPICS: dict[str, Topic] = {}
"""topics of lines by their names"""


def topic(name: str, meaning: str, *remedies: str, **table: Any) -> Topic:
    """Register a `Topic`, which has these attributes."""
    TOPICS[name] = Topic(name, meaning, *remedies, **table)
    return TOPICS[name]


@dataclass(frozen=True)
class Line:
    """One check and its result.

    Attributes:
        topic: what was checked.
        value: the result, in ``unit`` (SI; empty for ratios and counts); ``None`` if there is none.
        rule: the thresholds in words.
        note: an explanation, or a remedy.
        seconds: time of the check (largest over the ranks). A check may have several lines: its time is with the first
            one, and the others have ``None``, so that the sum over all lines is the time of all checks.
        state: name of the state of the body; empty in a job without states.
        interval: of a quantity: its name ``of``, its ends ``low`` and ``high`` (SI; ``None`` for none), its ``unit``,
            and its causes.
        point_field: what the line is the largest value of, a function (SI) at nodes; ``None`` if there is none.
    """

    topic: Topic
    value: float | None
    unit: str
    rule: str
    verdict: Verdict
    note: str = ""
    seconds: float | None = None
    state: str = ""
    interval: Mapping[str, Any] | None = None
    point_field: Any = field(default=None, compare=False)

    @property
    def name(self) -> str:
        """What was checked, in words."""
        return self.topic.name

    @property
    def remedy(self) -> str:
        """What to do about the line; empty if it passes, was not checked, or nothing is known."""
        if self.verdict in (Verdict.PASS, Verdict.SKIPPED):
            return ""
        other = self.topic.remedy_if_undecided if self.verdict is Verdict.UNDECIDED else ""
        return other or self.topic.remedy

    def as_data(self) -> dict[str, Any]:
        """The line as JSON data."""
        return {
            "name": self.name,
            "meaning": self.topic.meaning,
            "value": self.value,
            "unit": self.unit,
            "rule": self.rule,
            "verdict": self.verdict.value,
            "note": self.note,
            "remedy": self.remedy,
            "seconds": self.seconds,
            **({"state": self.state} if self.state else {}),
            **({"interval": dict(self.interval)} if self.interval is not None else {}),
        }


def upper_bound_line(topic: Topic, value: float, warn: float, fail: float, note: str = "") -> Line:
    """Return the line of a value that should be small; a value that is not finite fails."""
    verdict = Verdict.PASS if value <= warn else Verdict.WARN if value <= fail else Verdict.FAIL
    rule = f"warning above {warn:g}" + (f", fail above {fail:g}" if fail < math.inf else "")
    return Line(topic, value, "", rule, verdict, note)


def lower_bound_line(topic: Topic, value: float, warn: float, fail: float, note: str = "") -> Line:
    """Return the line of a value that must exceed ``fail``; a value that is not finite fails."""
    verdict = Verdict.PASS if value >= warn else Verdict.WARN if value > fail else Verdict.FAIL
    rule = f"warning below {warn:g}" + (f", fail at {fail:g} and below" if fail > -math.inf else "")
    return Line(topic, value, "", rule, verdict, note)


def skipped(topic: Topic, note: str) -> Line:
    """Return the line of a check that was not made, with the reason."""
    return Line(topic, None, "", "", Verdict.SKIPPED, note)


def judged_with_given_numbers(lines: Iterable[Line]) -> Iterator[Line]:
    """Yield lines of checks that keep pressures of cavities, and motions; what they do not pass is not decided.

    A body that is stable under a given pressure is stable with a given volume too, but not the other way round.
    """
    for line in lines:
        if line.verdict in (Verdict.PASS, Verdict.SKIPPED):
            yield line
        else:
            note = "checked with the pressure or motion that was found, not with the given volume, gas or load"
            yield replace(line, verdict=Verdict.UNDECIDED, note="; ".join(filter(None, [line.note, note])))


@dataclass(frozen=True)
class Certificate:
    """All checks of one run."""

    lines: tuple[Line, ...]

    @property
    def verdict(self) -> Verdict:
        """The most severe verdict of the lines; `Verdict.SKIPPED` counts only if nothing was checked."""
        verdicts = {line.verdict for line in self.lines}
        return max(verdicts - {Verdict.SKIPPED}, key=_SEVERITY.__getitem__, default=Verdict.SKIPPED)

    def point_fields(self, state: str) -> list[Any]:
        """Return the functions (SI) at nodes that lines of a state have."""
        return [line.point_field for line in self.lines if line.point_field is not None and line.state == state]

    def as_data(self) -> dict[str, Any]:
        """The certificate as JSON data."""
        return {"verdict": self.verdict.value, "lines": [line.as_data() for line in self.lines]}


def with_line(certificate: Mapping[str, Any], line: Line) -> dict[str, Any]:
    """Return the data of a certificate with one more line, which replaces an earlier one of the same name."""
    lines = [*(other for other in certificate["lines"] if other["name"] != line.name), line.as_data()]
    known = {Verdict.named(entry["verdict"]) for entry in lines} - {Verdict.SKIPPED}
    verdict = max(known, key=_SEVERITY.__getitem__, default=Verdict.SKIPPED)
    return {**certificate, "verdict": verdict.value, "lines": lines}
