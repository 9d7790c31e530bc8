"""Closures: what an error of the gap between given surfaces changes, and how far another assumption lies."""

from __future__ import annotations

from collections.abc import Iterator

from hpcinv.base.quantity.units import readable
from hpcinv.errors import SolveError
from hpcinv.job.interfaces import Interface
from hpcinv.on_demand import on_demand
from hpcinv.trust.certificate.certify import Check, CheckedRun
from hpcinv.trust.certificate.check import Line, Verdict, topic
from hpcinv.trust.certificate.shape import point_text

GAPS = topic(
    "change of the shape by an error of the given gaps",
    "Segmented surfaces that press on each other stand apart or overlap by an error. The line shows what it changes.",
    "Say what is 'known' of the contact, or correct the segmentation.",
    computed="slopes of a uniform error of all gaps where pressures act, of the size 'touches_within' or by default"
    " 1/1024 of the body's length",
    thresholds="never; not decided with friction, for free parts, and for a pressure of least energy",
    costs="a factorization and up to 30 substitutions",
)
CLOSURES = topic(
    "distance of the shape from another closure",
    "A given shape does not determine the contact pressure. Unloaded bodies without any fit it, too; the line shows how"
    " far they are from these.",
    "Say what is 'known' of the contact, and ask for 'uncertainty: contact'.",
    computed="change of the positions if all contact tractions were zero (`touching`), to first order",
    thresholds="never; not checked for `touching` itself, not decided for parts that contact alone holds",
    costs="a factorization and a substitution",
)
_RULE = "largest change of a position; no threshold"


class GivenGapsCheck(Check):
    """Show what the gaps between given surfaces determine."""

    name, order = "given gaps", 34

    def applies(self, run: CheckedRun) -> bool:
        return super().applies(run) and run.solution.direction == "inverse" and bool(_assumed(run))

    def lines(self, run: CheckedRun) -> Iterator[Line]:
        yield _distance(run)
        equations, solution = run.equations, run.solution
        if reason := _undecided(_assumed(run)):
            yield Line(GAPS, None, "m", _RULE, Verdict.UNDECIDED, reason)
            return
        if not any(i.assumed is not None and i.assumed.finds_pressure for i in _assumed(run)):
            note = "the pressure is assumed, whatever the gaps are: to first order they change nothing"
            yield Line(GAPS, 0.0, "m", _RULE, Verdict.PASS, note)
            return
        try:
            found = on_demand("response to gaps")(equations, solution)
        except SolveError as fault:
            yield Line(GAPS, None, "m", _RULE, Verdict.UNDECIDED, fault.message)
            return
        changes = [f"the force on '{name}' by {share:.2g} of it" for name, share in found.forces.items()]
        changes += [f"'{name}' by {readable(change, unit)}" for name, (change, unit) in found.quantities.items()]
        note = f"gaps that are {readable(found.error, 'm')} larger or smaller change {', '.join(changes)}"
        note += f"; the position at ({point_text(found.place)}) m of the given mesh changes most; to first order"
        yield Line(GAPS, found.largest, "m", _RULE, Verdict.PASS, note)


def _distance(run: CheckedRun) -> Line:
    """Return the line on bodies without contact tractions."""
    solution = run.solution
    if not any(report.largest_pressure for report in solution.contacts):
        note = "no contact presses: 'uncertainty: contact' shows how far bodies are that press on each other"
        return Line(CLOSURES, None, "m", _RULE, Verdict.SKIPPED, note)
    try:
        distance, place = on_demand("distance without tractions")(run.equations, solution)
    except SolveError as fault:
        return Line(CLOSURES, None, "m", _RULE, Verdict.UNDECIDED, fault.message)
    note = (
        f"with 'closure: touching', the position at ({point_text(place)}) m of the given mesh would change most; to"
        " first order"
    )
    return Line(CLOSURES, distance, "m", _RULE, Verdict.PASS, note)


def _assumed(run: CheckedRun) -> list[Interface]:
    interfaces = run.solution.job.all_interfaces
    return [interface for interface in interfaces if interface.kind == "contact" and interface.closure is not None]


def _undecided(interfaces: list[Interface]) -> str:
    """Return why the change is not known, or nothing."""
    if any(interface.friction for interface in interfaces):
        return "with friction, tractions depend on the history of slip"
    if any(interface.assumed is not None and interface.assumed.searched_from for interface in interfaces):
        return "the search for the least energy has no slopes by the gaps"
    return ""
