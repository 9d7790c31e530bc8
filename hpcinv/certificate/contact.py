"""Contacts: what determined their pressure, and whether the body lies on the obstacle where that acts."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from hpcinv.certificate.check import Line, Verdict

if TYPE_CHECKING:
    from hpcinv.model.contacts import ContactReport
    from hpcinv.results.solution import Solution
    from hpcinv.solver.problem import Model

_RIGID = 16.0  # tolerated penetrations
_GIVEN = 1e-2  # of the body's length


def contacts(model: Model, solution: Solution) -> Iterator[Line]:
    """Yield a line for each contact of a solution."""
    for contact in solution.contacts:
        yield _line(contact, _GIVEN * model.body.length_scale)


def _line(contact: ContactReport, far: float) -> Line:
    name = f"contact on '{contact.region}'"
    if contact.largest_pressure == 0.0:
        note = f"{contact.assumption}; the body does not touch the obstacle"
        return Line(name, 0.0, "m²", "area in contact; warning if there is none", Verdict.WARN, note)
    if contact.tolerance is not None:
        limit, note = _RIGID * contact.tolerance, "penetration between vertices: refine the mesh where the body touches"
        rule = f"penetration; warning above {limit:.3g} m"
        verdict = Verdict.PASS if contact.penetration <= limit else Verdict.WARN
        note = contact.assumption if verdict is Verdict.PASS else f"{contact.assumption}; {note}"
        return Line(name, contact.penetration, "m", rule, verdict, note)
    if contact.is_given:
        verdict = Verdict.PASS if contact.distance <= far else Verdict.WARN
        rule = f"distance from the obstacle where the pressure acts; warning above {far:.3g} m"
        return Line(name, contact.distance, "m", rule, verdict, contact.assumption)
    return Line(
        name, contact.penetration, "m", "penetration of the layer; no threshold", Verdict.PASS, contact.assumption
    )
