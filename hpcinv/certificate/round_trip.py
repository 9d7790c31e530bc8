"""What the other direction says: the solve back from the body that was found, and the stability of the loaded one."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import TYPE_CHECKING

import hpcinv.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
import numpy as np

from hpcinv.certificate.check import Line, Verdict, at_most, skipped
from hpcinv.certificate.confirmation import MARGIN, Confirmed, confirm
from hpcinv.certificate.inertia import inertia
from hpcinv.job.sections import AXES
from hpcinv.parallel.runtime import MPI
from hpcinv.quantity.spatial_fields import ByFormula
from hpcinv.solver.load_stepping import follow
from hpcinv.solver.observer import SILENT, Observer

if TYPE_CHECKING:
    from dolfinx.fem import Function

    from hpcinv.effects import Direction
    from hpcinv.job.job import Job
    from hpcinv.results.solution import Solution
    from hpcinv.solver.problem import Model

ROUND_TRIP, STABILITY, LIMIT_POINTS = (
    "round trip, relative to the displacement",
    "stability",
    "limit points of the path",
)
STRAIGHT = (
    "the cells' geometry is of lower degree than the displacement, so that only their nodes can move: with"
    " 'mesh: {geometry_degree: 2}' the round trip of quadratic ones closes (for a .msh file, 'gmsh -order 2' also puts"
    " their nodes on the curved surface)"
)


def round_trip(model: Model, solution: Solution, observer: Observer = SILENT) -> Iterator[Line]:
    """Solve back from the body that a solution found, and compare the displacements; collective.

    With the cells' geometry of the displacement's degree the two directions are exact discrete inverses.
    """
    back: Direction = "forward" if solution.direction == "inverse" else "inverse"
    start = model.job.certificate.round_trip
    if start == "off":
        yield skipped(ROUND_TRIP, "switched off: certificate.round_trip")
        return
    with model.at(solution.other_nodes, *solution.fields):
        equilibrium = model.equilibrium(model.scene(back), observer)
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
    yield closure_error(model, solution, u)


def closure_error(model: Model, solution: Solution, back: np.ndarray) -> Line:
    """Compare a solution's displacements with those (m) of the solve back at the same nodes; collective."""
    largest = float(np.linalg.norm(back - solution.u, axis=1).max(initial=0.0))
    difference, size = model.body.mesh.comm.allreduce(largest, op=MPI.MAX), solution.largest_displacement
    curved = model.body.source.degree >= model.job.discretisation.displacement
    note = f"{difference:.3g} m" if curved else f"{difference:.3g} m; {STRAIGHT}"
    return at_most(ROUND_TRIP, difference / size if size else difference, warn=1e-3, fail=0.1, note=note)


def stability(model: Model, solution: Solution) -> Iterator[Line]:
    """Count the directions in which the loaded body would move away by itself; collective.

    A discrete state is stable if the tangent of the forward problem is positive definite in the displacements: with the
    pressure as an unknown, if it has one negative eigenvalue for each pressure, and no more. Others are confirmed to be
    instabilities of the body, or the line is not decided (`hpcinv.certificate.confirmation`).
    """
    if not model.job.certificate.stability:
        yield skipped(STABILITY, "switched off: certificate.stability")
        yield skipped(LIMIT_POINTS, "switched off: certificate.stability")
        return
    if not model.chooser.can_factorize_symmetric:
        yield skipped(STABILITY, f"there is no memory for factors of {model.chooser.forecast.factors / 2e9:.2g} GB")
        yield _limit_points(solution)
        return
    with model.at(solution.reference_nodes, *solution.fields):
        known = known_displacement(model)
        equilibrium = model.equilibrium(model.scene("forward", known))
        equilibrium.system.linearise(1.0)
        with model.timings("factorization"):
            found = inertia(equilibrium.system.matrix)
        model.release(equilibrium)
        pressures = model.unknowns.pressure_size
        # Zeros count: a singular tangent is not stable. Each pressure has a negative or a zero one of its own.
        unstable = None if found is None else found.negative + found.zero - pressures
        if found is None or unstable is None or unstable < 0:
            line = skipped(STABILITY, "the tangent could not be factorized")
        elif unstable == 0:
            line = _stable(found.asymmetry)
        else:
            line = _unstable(unstable, confirm(model, known), is_mixed=pressures > 0)
    yield line
    yield _limit_points(solution, has_spurious_modes=pressures > 0 and line.verdict is Verdict.UNDECIDED)


def known_displacement(model: Model) -> Function | None:
    """The state's displacement where fibres and parameters of laws were seen on the loaded body, else ``None``.

    They stay with the material as it moves on from there.
    """
    return model.unknowns.displacement() if _seen_on_the_current_body(model.job) else None


def _seen_on_the_current_body(job: Job) -> bool:
    """Whether fibres or parameters of laws are given by what is known of the current body."""
    if any(family.given_on == "current" for family in job.families.values()):
        return True
    parts = (*job.laws.values(), *job.families.values())
    values = [value for part in parts for value, _ in part.quantities().values()]
    flat = [v for value in values for v in (value if isinstance(value, tuple) else (value,))]
    return any(isinstance(v, ByFormula) and not v.formula.names.isdisjoint(AXES) for v in flat)


_RULE = "no negative eigenvalue of the forward tangent; fail if some are confirmed as instabilities of the body"


def _stable(asymmetry: float) -> Line:
    note = "no negative eigenvalue of the forward tangent"
    return Line(
        STABILITY,
        0.0,
        "",
        _RULE,
        Verdict.PASS,
        "; ".join(filter(None, [note, _without_potential(asymmetry)])),
    )


def _unstable(count: int, confirmed: Confirmed | None, *, is_mixed: bool) -> Line:
    """The line for ``count`` eigenvalues of a tangent that are not positive, of which some may be ``confirmed``."""
    if confirmed is not None and confirmed.directions:
        note = "confirmed negative eigenvalues: the loaded body would buckle or snap away from this state"
        if confirmed.directions < count:
            note += f"; of the {count} that the forward tangent has, the others may be spurious modes of the elements"
        # Of a tangent that is not symmetric the symmetric part alone proves stability, but not its absence. That of
        # the confirmation is told: with the quadrature of the solve follower loads may lack symmetry for that alone.
        kind = _without_potential(confirmed.asymmetry)
        verdict = Verdict.WARN if kind else Verdict.FAIL
        note = f"{note}; {kind}" if kind else note
        return Line(STABILITY, float(confirmed.directions), "", _RULE, verdict, note)
    if confirmed is None:
        why = "the form that could confirm them could not be factorized"
    elif is_mixed:
        why = (
            "none is confirmed with the volume constraint enforced at each point: they may be spurious modes of the "
            "elements, which tetrahedra and the displacement form have fewer of, or a mode that a finer mesh confirms"
        )
    else:
        why = f"none is left with a margin of {MARGIN:.0%} of the elastic energy: the body is at a critical load"
    note = f"negative eigenvalues of the forward tangent, but {why}"
    return Line(STABILITY, float(count), "", _RULE, Verdict.UNDECIDED, note)


def _without_potential(asymmetry: float) -> str:
    return "" if asymmetry < 1e-8 else f"loads without a potential (asymmetry {asymmetry:.1g}): of the symmetric part"


def _limit_points(solution: Solution, *, has_spurious_modes: bool = False) -> Line:
    """The line on signs along the path, which modes that may be spurious change as well as a limit point does."""
    rule = "the determinant of the tangent must keep its sign from the unloaded body to the loaded one"
    turned = sum(s.turning_point for s in solution.solves)
    if turned:
        note = "another shape may carry the same load: compare with smaller steps"
        if passed := _earlier_passes([s.load for s in solution.solves if s.outcome.accepted]):
            times = "once" if passed == 1 else f"{passed} times"
            note = (
                f"{turned} limit {'point' if turned == 1 else 'points'} of the load; the path reaches the full load"
                f" {times} before, where other shapes carry it: the first is found with 'limit_points: 0'"
            )
        return Line(LIMIT_POINTS, float(turned), "", rule, Verdict.WARN, note)
    if not any(s.factorizations for s in solution.solves):
        return Line(LIMIT_POINTS, 0.0, "", rule, Verdict.PASS, "nothing moves the body")
    signs = [s.signs for s in solution.solves if s.outcome.accepted and s.signs]
    if not signs:
        return skipped(LIMIT_POINTS, "an iterative solver does not tell the sign of the tangent's determinant")
    changes = len({signs[0][0], *(of_solve[-1] for of_solve in signs)}) - 1
    if not changes:
        return Line(LIMIT_POINTS, 0.0, "", rule, Verdict.PASS, "no limit point on the way")
    note = "another shape may carry the same load: compare with smaller steps"
    if has_spurious_modes:
        note = f"a mode that may be spurious, as the stability line has it, or {note}"
        return Line(LIMIT_POINTS, 1.0, "", rule, Verdict.UNDECIDED, note)
    return Line(LIMIT_POINTS, 1.0, "", rule, Verdict.WARN, note)


def _earlier_passes(loads: list[float]) -> int:
    """How often a path from the unloaded body passes full load before it ends there."""
    path = [load - 1 for load in (0.0, *loads)]
    return sum(before * after < 0 for before, after in pairwise(path))
