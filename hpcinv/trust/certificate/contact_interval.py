"""Intervals of quantities over all contact pressures that a given shape admits: what an assumption on them hides."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from hpcinv.base.quantity.units import readable
from hpcinv.errors import SolveError
from hpcinv.job.interfaces import Interface
from hpcinv.on_demand import on_demand
from hpcinv.trust.certificate.certify import Check, CheckedRun
from hpcinv.trust.certificate.check import Line, Verdict, topic

INTERVAL = topic(
    "interval of '…' over all contact pressures that the shape admits",
    "A given shape does not determine the pressure between its bodies, nor friction within its cone. The quantity may"
    " lie anywhere in this interval.",
    "Say what is 'known' of the contact, or measure a state of the bodies without it.",
    computed="linear programs, confirmed by solves ([intervals](../how-to/interfaces.md#what-a-shape-leaves-open))",
    thresholds="never; not decided where an end does not exist or settle",
    costs="for each end some factorizations, with a substitution for each pressure, with friction three",
)
ADMISSIBLE = topic(
    "contact pressures that the shape admits",
    "Whether unloaded bodies exist that do not overlap, for some contact pressure.",
    "Check supports and segmentation: bodies travel too little, or overlap.",
    computed="linear program for the widest of all smallest gaps",
    thresholds="where there is none; never",
)
_LOCKED = "; friction locks the bodies: within the cone, tractions of any size balance each other"
_OUTSIDE = "; the computed value lies outside: these unloaded bodies overlap, or contradict what is 'known'"
_UNBOUNDED = "; what is 'known' of the contact cannot bound it: measure a state of the bodies without contact"


class ContactIntervalCheck(Check):
    """Show the intervals that the job asks for."""

    name, order = "contact interval", 33

    def applies(self, run: CheckedRun) -> bool:
        is_asked = run.solution.job.uncertainty == "contact" and run.solution.direction == "inverse"
        return super().applies(run) and is_asked

    def lines(self, run: CheckedRun) -> Iterator[Line]:
        try:
            found = on_demand("contact intervals")(run.equations, run.solution, run.announce)
        except SolveError as reason:
            note = f"a body is held by contact alone, or a solve failed: {reason.message}"
            yield Line(ADMISSIBLE, None, "", "ends must exist", Verdict.UNDECIDED, note)
            return
        if found.friction is not None:
            yield _unbalanced(found.friction, run.solution.job.interfaces)
        elif found.excess:
            text = f"by at least {readable(found.excess, 'm')} more than its 'within'"
            note = f"all unloaded bodies that do not overlap miss the known 'rest_surface' {text}"
            yield Line(ADMISSIBLE, found.excess, "m", "warning if there is none", Verdict.WARN, note)
        elif found.overlap == 0.0:
            note = "what is 'known' excludes all pressures of bodies that do not overlap"
            yield Line(ADMISSIBLE, None, "", "warning if there is none", Verdict.WARN, note)
        elif found.overlap is not None:
            note = f"no unloaded bodies exist that do not overlap: by at least {readable(found.overlap, 'm')}"
            yield Line(ADMISSIBLE, found.overlap, "m", "warning if there is none", Verdict.WARN, note)
        yield from (_line(interval, found) for interval in found.intervals)
        if found.intervals:
            note = f"between two shapes at ends: {readable(found.distance, 'm')} or more is not determined"
            about = INTERVAL.placed("shape")
            yield Line(about, found.distance, "m", "distance; no threshold", Verdict.PASS, note)
        if found.width is not None:
            yield _width_line(found)


def _unbalanced(factor: float, interfaces: Sequence[Interface]) -> Line:
    """Return the line of parts that tractions within the friction cones, or pressures alone, do not balance."""
    least = ", ".join(f"{factor * i.friction:.3g} on '{i.between[0]}'" for i in interfaces if i.friction)
    note = f"they balance free parts with a friction of at least {least}" if least else ""
    if not least or factor == float("inf"):
        note = "none balance the loads of the parts that contact alone holds"
    return Line(ADMISSIBLE, None, "", "warning if there is none", Verdict.WARN, note)


def _width_line(found: Any) -> Line:
    """Return the line of the width of the positions of nodes, one of `ContactIntervals`."""
    width = found.width
    about = INTERVAL.placed("position of a node")
    rule = "largest half width; no threshold"
    if width.unbounded:
        endless = [interval for interval in found.intervals if interval.low is None or interval.high is None]
        note = "some nodes have no end"
        note += f", as '{endless[0].name}' has none" if endless else ": pressures grow without bound"
        return Line(about, None, "m", rule, Verdict.UNDECIDED, note)
    place = ", ".join(f"{x:.4g}" for x in width.place)
    note = (
        f"along x, y or z, at ({place}) m; to first order, exact for {width.rows} displacements of nodes, and a lower"
        " bound for others"
    )
    return Line(about, width.largest, "m", rule, Verdict.PASS, note, point_field=width.field)


def _line(found: Any, all_found: Any) -> Line:
    """Return the line of an `Interval`, one of `ContactIntervals` (`hpcinv.trust.intervals.contact_interval`)."""
    count, fine = all_found.count, all_found.fine
    width = None if found.low is None or found.high is None else found.high - found.low
    zero = 1e-9 * (width or 0.0)  # rounding errors
    ends = [_end(end, found.unit, zero) for end in (found.low, found.high)]
    field = f" of a coarse field of {fine} pressures" if fine else ""
    note = f"{ends[0]} to {ends[1]}, over {count} tractions{field} in {found.solves} solves"
    if width is None:
        note += _LOCKED if all_found.is_locked else ""
        remedies = " or ".join(f"'{key}'" for key in found.remedies)
        note += f"; a known {remedies} would bound it" if remedies else _UNBOUNDED
    note += "" if found.has_settled else "; an end has not settled"
    note += _OUTSIDE if _is_outside(found) else ""
    verdict = Verdict.PASS if width is not None and found.has_settled else Verdict.UNDECIDED
    data = {"of": found.name, "low": found.low, "high": found.high, "unit": found.unit}
    data |= {"by": "contact pressures", "pressures": count, "solves": found.solves}
    about = INTERVAL.placed(found.name)
    return Line(about, width, found.unit, "width; no threshold", verdict, note, interval=data)


def _is_outside(found: Any) -> bool:
    """Return whether the value of the computed bodies lies outside by more than a thousandth of the larger one."""
    ends = ((end, sign) for end, sign in ((found.low, -1.0), (found.high, 1.0)) if end is not None)
    return any(sign * (found.value - end) > 1e-3 * max(abs(found.value), abs(end)) for end, sign in ends)


def _end(value: float | None, unit: str, zero: float) -> str:
    if value is None:
        return "no end"
    return readable(value if abs(value) > zero else 0.0, unit, 4)
