"""Friction of bodies in contact: whether their tangential tractions are what friction allows."""

from __future__ import annotations

from collections.abc import Iterator

from hpcinv.base.quantity.units import readable
from hpcinv.model.contact_reports import ContactReport, FrictionReport
from hpcinv.trust.certificate.certify import Check, CheckedRun
from hpcinv.trust.certificate.check import Line, Verdict, topic

FRICTION = topic(
    "friction on '…'",
    "How much of the tangential traction that friction allows is needed where most is needed.",
    "Assume 'closure: coulomb', or check the coefficient: bodies with these tractions would slide.",
    computed="largest tangential traction over friction coefficient and pressure",
    thresholds="above 1; never",
)
_ROUNDED = 1e-6
"""Share by which tractions of surfaces that slide may exceed friction. Raised, sticking that is not possible passes."""


class FrictionCheck(Check):
    """Compare tangential tractions with friction."""

    name, order = "friction", 31

    def applies(self, run: CheckedRun) -> bool:
        return super().applies(run) and any(contact.friction is not None for contact in run.solution.contacts)

    def lines(self, run: CheckedRun) -> Iterator[Line]:
        for contact in run.solution.contacts:
            if contact.friction is not None:
                yield _line(contact, contact.friction)


def _line(contact: ContactReport, friction: FrictionReport) -> Line:
    share = friction.largest / friction.allowed if friction.allowed else 0.0
    verdict = Verdict.PASS if share <= 1 + _ROUNDED else Verdict.WARN
    place = ", ".join(f"{c:.4g}" for c in friction.place)
    at = f"{readable(friction.largest, 'Pa')} of {readable(friction.allowed, 'Pa')} at ({place}) m of the given mesh"
    if verdict is Verdict.WARN:
        note = f"surfaces that stick need {at}"
    else:
        slides = friction.sliding_area / contact.area if contact.area else 0.0
        note = f"{at}; {slides:.0%} of the area slides, {readable(friction.energy_lost, 'J')} lost"
    rule = f"tangential traction over {friction.coefficient:g} of the pressure; warning above 1"
    return Line(FRICTION.placed(contact.region), share, "", rule, verdict, note)
