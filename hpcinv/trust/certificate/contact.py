"""Contacts: what determined their pressure, and whether the body lies on the obstacle where that acts."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf, log
from typing import Any

import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.units import readable
from hpcinv.base.updates import Anderson
from hpcinv.model.assembly.system import System
from hpcinv.model.contact_reports import ContactReport
from hpcinv.results.displacement_scale import displacement_scale
from hpcinv.trust.certificate.certify import Check, CheckedRun
from hpcinv.trust.certificate.check import Line, Verdict, topic, upper_bound_line
from hpcinv.trust.stability.forward_factors import TangentSolver

CONTACT = topic(
    "contact on '…'",
    "What was found where the body touches an obstacle.",
    "Refine the mesh where the body touches, and check the place of the obstacle.",
    computed="penetration, or where a known pressure acts the distance from the obstacle",
    thresholds="above 16 tolerances or 0.01 of the body, or without contact; never",
)
PENALTY = topic(
    f"{CONTACT.name}: change of the shape if the penalty is doubled",
    CONTACT.meaning,
    CONTACT.remedy,
    computed="[slope of the shape](../how-to/contact.md) by the penalty of a rigid obstacle",
    thresholds="above 0.05; never",
    costs="up to 20 solutions with stability's factors",
)
_RIGID = 16.0  # tolerated penetrations
_GIVEN = 1e-2  # of the body's length
_STEP = 2.0**-8  # of differences by the logarithm of the penalty; larger ones reach points that come into contact
_UPDATES = 20  # of pressures that follow the penalty; each is one solution with known factors
_SETTLED = 0.05  # change of the rate by an update, relative to it
_PENALTY = 0.05  # of the displacement, as for the error of the discretisation


class ContactCheck(Check):
    """Check the place where the body touches each obstacle."""

    name, order = "contact", 30

    def lines(self, run: CheckedRun) -> Iterator[Line]:
        body = run.equations.body
        for contact in run.solution.contacts:
            yield _line(contact, _GIVEN * body.length * body.length_scale)

    def applies(self, run: CheckedRun) -> bool:
        return super().applies(run) and bool(run.solution.contacts)


class PenaltyCheck(Check):
    """Check how much the shape of a forward solution depends on the penalties of rigid obstacles.

    Vertices lie on the obstacle, and the pressure between them is the interpolated one and the penalty of the gap.
    """

    name, order = "penalty", 130

    def applies(self, run: CheckedRun) -> bool:
        is_asked = super().applies(run) and run.solution.job.certificate.stability
        return is_asked and any(contact.tolerance is not None for contact in run.solution.contacts)

    def lines(self, run: CheckedRun) -> Iterator[Line]:
        equations, solution, forward = run.equations, run.solution, run.forward
        if solution.direction != "forward" or not any(contact.largest_pressure for contact in solution.contacts):
            return
        contacts = {contact.where: contact for contact in solution.contacts}
        size = displacement_scale(equations, solution).length
        solver = forward.factors if forward.affordable else forward.multigrid
        if solver is None:
            return
        with forward.tangent() as equilibrium:
            for obstacle in equilibrium.system.weak_form.contacts.rigid():
                contact = contacts[obstacle.where]
                if contact.largest_pressure:
                    about = PENALTY.placed(contact.region)
                    rate = _rate(equilibrium.system, solver, obstacle)
                    if rate is None:
                        note = "the pressures that follow it do not settle"
                        yield Line(about, None, "", "must be known", Verdict.UNDECIDED, note)
                        continue
                    change = log(2) * rate * equations.scales.length
                    note = f"{readable(change, 'm')}, relative to the displacement"
                    yield upper_bound_line(about, change / size if size else 0.0, _PENALTY, inf, note=note)


def _rate(system: System, solver: TangentSolver, obstacle: Any) -> float | None:
    """Return the largest rate of the displacement by the logarithm of a penalty, with the pressures that follow it.

    Pressures ``q`` at vertices follow by Uzawa's method for the linearised equations, ``q' -= penalty g'``, accelerated
    by Anderson's. The rate is ``None`` if that does not settle.
    """
    unknowns = system.weak_form.unknowns
    start, rate, b = system.position(), system.rhs.duplicate(), system.rhs.duplicate()
    pressing, _ = obstacle.vertex_values()
    update = Anderson(1.0, _UPDATES, lambda a, b: float(system.comm.allreduce(float(a @ b))))
    rates, largest, settled, rate_limit = np.zeros(len(pressing)), 0.0, 0, None
    for _ in range(_UPDATES):
        b.set(0.0)
        for sign in (-1, 1):
            with obstacle.moved(sign * _STEP, rates):
                system.residual(system.rhs)
            b.axpby(1.0, -1.0, system.rhs)
        b.scale(-1 / (2 * _STEP))
        if not solver.solve(b, rate):
            break
        gaps = []
        for sign in (-1, 1):
            moved = start.copy()
            moved.axpy(sign * _STEP, rate)
            system.set_state(moved)
            gaps.append(obstacle.vertex_values()[1])
            moved.destroy()
        system.set_state(start)
        change = np.where(pressing > 0, obstacle.penalty * (gaps[1] - gaps[0]) / (2 * _STEP), 0.0)
        rates = rates + update.step(rates, change)
        moved = rate.array[unknowns.owned_displacement_dofs].reshape(-1, 3)
        previous, largest = largest, float(np.linalg.norm(moved, axis=1).max(initial=0.0))
        largest = system.comm.allreduce(largest, op=MPI.MAX)
        settled = settled + 1 if abs(largest - previous) <= _SETTLED * largest else 0
        if settled == 2:  # one small change may be an accident of the acceleration
            rate_limit = largest
            break
    for vector in (start, rate, b):
        vector.destroy()
    return rate_limit


def _line(contact: ContactReport, far: float) -> Line:
    about = CONTACT.placed(contact.region)
    if contact.largest_pressure == 0.0:
        note = f"{contact.assumption}; the body does not touch the obstacle"
        return Line(about, 0.0, "m²", "area in contact; warning if there is none", Verdict.WARN, note)
    if contact.tolerance is not None:
        limit, note = _RIGID * contact.tolerance, "penetration between vertices"
        rule = f"penetration; warning above {readable(limit, 'm')}"
        verdict = Verdict.PASS if contact.penetration <= limit else Verdict.WARN
        note = contact.assumption if verdict is Verdict.PASS else f"{contact.assumption}; {note}"
        return Line(about, contact.penetration, "m", rule, verdict, note)
    if contact.is_given:
        verdict = Verdict.PASS if contact.distance <= far else Verdict.WARN
        rule = f"distance from the obstacle where the pressure acts; warning above {readable(far, 'm')}"
        return Line(about, contact.distance, "m", rule, verdict, contact.assumption)
    return Line(
        about, contact.penetration, "m", "penetration of the layer; no threshold", Verdict.PASS, contact.assumption
    )
