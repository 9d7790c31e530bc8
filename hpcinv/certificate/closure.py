"""What the other direction says: the solve back from the body that was found, and the stability of the loaded one."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import hpcinv.runtime  # noqa: F401  (its import order first)

# isort: split
import numpy as np

from hpcinv.certificate.inertia import inertia
from hpcinv.certificate.verdict import Line, Verdict, at_most, skipped
from hpcinv.continuation import follow
from hpcinv.placement import placed
from hpcinv.runtime import MPI
from hpcinv.sections import AXES
from hpcinv.varying import ByFormula

if TYPE_CHECKING:
    from hpcinv.effects import Direction
    from hpcinv.job import Job
    from hpcinv.model import Model
    from hpcinv.result import Leg

ROUND_TRIP, STABILITY, FOLD = "round trip, relative to the displacement", "stability", "fold of the path"
STRAIGHT = "the cells' geometry is of lower degree than the displacement, so that only their nodes can move"


def round_trip(model: Model, leg: Leg) -> Iterator[Line]:
    """Solve back from the body that a leg found, and compare the displacements; collective.

    With the cells' geometry of the displacement's degree the two directions are exact discrete inverses.
    """
    back: Direction = "forward" if leg.direction == "inverse" else "inverse"
    start = model.job.certificate.round_trip
    if start == "off":
        yield skipped(ROUND_TRIP, "switched off: certificate.round_trip")
        return
    with placed(model.body.mesh, leg.other_nodes / model.body.length_scale):
        model.set_solution(leg.displacement, leg.pressure)
        equilibrium = model.equilibrium(model.scene(back), lambda: False)
        tolerance = model.job.solver.tolerance
        solves = [equilibrium.solve(1.0, tolerance)] if start == "near" else []
        if not solves or not solves[-1].outcome.accepted:
            model.unknowns.state.x.array[:] = 0.0
            solves = list(follow(equilibrium, model.steps, tolerance))
        u = model.unknowns.at_nodes(model.solution()[0])
        model.release(equilibrium)
    last = solves[-1]
    if not (last.outcome.accepted and last.load == 1.0):
        note = f"no way back: stopped at load factor {last.load:.4g}: {last.outcome.text}"
        yield Line(ROUND_TRIP, None, "", "the solve back must converge", Verdict.FAIL, note)
        return
    yield gap(model, leg, u)


def gap(model: Model, leg: Leg, back: np.ndarray) -> Line:
    """Compare a leg's displacements with those (m) of the solve back at the same nodes; collective."""
    largest = float(np.linalg.norm(back - leg.u, axis=1).max(initial=0.0))
    difference, size = model.body.mesh.comm.allreduce(largest, op=MPI.MAX), leg.largest_displacement
    curved = model.body.source.degree >= model.job.discretisation.displacement
    note = f"{difference:.3g} m" if curved else f"{difference:.3g} m; {STRAIGHT}"
    return at_most(ROUND_TRIP, difference / size if size else difference, warn=1e-3, fail=0.1, note=note)


def stability(model: Model, leg: Leg) -> Iterator[Line]:
    """Count the directions in which the loaded body would move away by itself; collective.

    A state is stable if the tangent of the forward problem is positive definite in the displacements: with the pressure
    as an unknown, if it has one negative eigenvalue for each pressure, and no more.
    """
    if not model.job.certificate.stability:
        yield skipped(STABILITY, "switched off: certificate.stability")
        yield skipped(FOLD, "switched off: certificate.stability")
        return
    if not model.chooser.can_factorize_symmetric:
        yield skipped(STABILITY, f"there is no memory for factors of {model.chooser.forecast.factors / 2e9:.2g} GB")
        yield _fold(leg)
        return
    with placed(model.body.mesh, leg.reference_nodes / model.body.length_scale):
        model.set_solution(leg.displacement, leg.pressure)
        # Fibres and stiffness that were seen on the loaded body stay with the material as it moves on from there.
        known = model.unknowns.displacement() if _seen_on_the_current_body(model.job) else None
        equilibrium = model.equilibrium(model.scene("forward", known), lambda: False)
        equilibrium.linearise(1.0)
        with model.timings("factorization"):
            found = inertia(equilibrium.matrix)
        model.release(equilibrium)
    if found is None:
        yield skipped(STABILITY, "the tangent could not be factorized")
    else:
        yield _stability(found.negative - model.unknowns.pressure_size, found.asymmetry)
    yield _fold(leg)


def _seen_on_the_current_body(job: Job) -> bool:
    """Whether fibres or parameters of laws are given by what is known of the current body."""
    if any(family.given_on == "current" for family in job.families.values()):
        return True
    parts = (*job.laws.values(), *job.families.values())
    values = [value for part in parts for value, _ in part.quantities().values()]
    flat = [v for value in values for v in (value if isinstance(value, tuple) else (value,))]
    return any(isinstance(v, ByFormula) and not v.formula.names.isdisjoint(AXES) for v in flat)


def _stability(unstable: int, asymmetry: float) -> Line:
    rule = "number of unstable directions; fail above 0"
    kind = "" if asymmetry < 1e-8 else f"loads without a potential (asymmetry {asymmetry:.1g}): of the symmetric part"
    if unstable <= 0:
        return Line(STABILITY, float(unstable), "", rule, Verdict.PASS, kind)
    note = "the loaded body would buckle or snap away: in this state it cannot have been seen"
    # Of a tangent that is not symmetric the symmetric part alone proves stability, but not its absence.
    verdict = Verdict.WARN if kind else Verdict.FAIL
    return Line(STABILITY, float(unstable), "", rule, verdict, f"{note}; {kind}" if kind else note)


def _fold(leg: Leg) -> Line:
    rule = "the determinant of the tangent must keep its sign from the unloaded body to the loaded one"
    if not any(s.factorizations for s in leg.solves):
        return Line(FOLD, 0.0, "", rule, Verdict.PASS, "nothing moves the body")
    signs = [s.signs for s in leg.solves if s.outcome.accepted and s.signs]
    if not signs:
        return skipped(FOLD, "an iterative solver does not tell the sign of the tangent's determinant")
    changes = len({signs[0][0], *(of_solve[-1] for of_solve in signs)}) - 1
    if not changes:
        return Line(FOLD, 0.0, "", rule, Verdict.PASS)
    return Line(FOLD, 1.0, "", rule, Verdict.WARN, "another shape may carry the same load: compare with smaller steps")
