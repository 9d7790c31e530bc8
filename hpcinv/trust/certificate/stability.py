"""Stability of the loaded body."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from hpcinv.mesh.symmetry import symmetry_planes
from hpcinv.on_demand import on_demand
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.solver.observer import SILENT, Observer, freeing
from hpcinv.solver.support_checks import barely_held
from hpcinv.trust.certificate.certify import Check, CheckedRun
from hpcinv.trust.certificate.check import Line, Verdict, judged_with_given_numbers, skipped, topic
from hpcinv.trust.stability.confirmation import MARGIN, Confirmed, assembled, confirm, potential_note
from hpcinv.trust.stability.forward_factors import ForwardFactors, given_u_of

STABILITY = topic(
    "stability: unstable directions",
    "Whether the loaded body is in stable equilibrium, or would buckle or snap away.",
    "Check supports, direction of the load and stiffness.",
    "Refine the mesh; solids of tetrahedra have fewer spurious modes.",
    computed="[negative eigenvalues](../theory/stability.md) of the forward tangent, confirmed as no spurious modes",
    thresholds="any, with non-conservative loads; any, else",
    costs="a factorization, two if some are negative",
)
_RULE = "no negative eigenvalue of the forward tangent; fail if some are confirmed as instabilities of the body"


class StabilityCheck(Check):
    """Check that the loaded body is stable."""

    name, order = "stability", 110
    has_switch = True

    def lines(self, run: CheckedRun) -> Iterable[Line]:
        checked = _without_potential(run.solution, stability(run.equations, run.forward, run.observer))
        is_decided = len(run.solution.cavities) == len(run.solution.constraints)
        return checked if is_decided else judged_with_given_numbers(checked)


def _without_potential(solution: Solution, lines: Iterable[Line]) -> Iterator[Line]:
    """Yield lines of bodies whose friction has no potential: negative eigenvalues prove no instability."""
    for line in lines:
        if any(contact.friction for contact in solution.contacts) and line.verdict in (Verdict.WARN, Verdict.FAIL):
            line = replace(line, verdict=Verdict.UNDECIDED, note=f"{line.note}; with friction these prove nothing")
        yield line


def stability(equations: Equations, forward: ForwardFactors, observer: Observer = SILENT) -> Iterator[Line]:
    """Yield the line on unstable directions of the loaded body; collective.

    A discrete state is stable if the tangent of the forward problem is positive definite in the displacements: with the
    pressure as an unknown, if it has one negative eigenvalue for each pressure, and no more. Further ones are
    either confirmed to be instabilities of the body, or the line is not decided
    (`hpcinv.trust.stability.confirmation`). Where factors are not affordable, the lowest eigenvalue is sought
    iteratively, and its sign is all that is known.

    Args:
        forward: factors of the forward tangent at the solution.
        observer: of a solve back; it is also asked whether to stop.
    """
    if not forward.solution.job.certificate.stability:
        yield skipped(STABILITY, "switched off: certificate.stability")
        return
    line = _factors_line(equations, forward) if forward.affordable else _iteration_line(equations, forward, observer)
    if forward.solution.cavities:
        line = _with_cavities(equations, forward, line)
    held = _barely_held(line, equations, forward.solution)
    yield replace(line, note="; ".join([line.note, *_left_out(equations, forward), *held]))


def _with_cavities(equations: Equations, forward: ForwardFactors, line: Line) -> Line:
    """Return the line, which was checked at given pressures, of the body with its cavities; collective.

    A line that passes stays, since what holds a cavity stiffens the body, and so does one with other unknown numbers.
    Without a count of directions it is not decided.
    """
    solution = forward.solution
    if line.verdict in (Verdict.PASS, Verdict.SKIPPED) or len(solution.cavities) < len(solution.constraints):
        return line
    (undecided,) = judged_with_given_numbers([line])
    if line.value is None or not forward.affordable or forward.factors is None:
        return undecided
    factors, names = forward.factors, ", ".join(f"'{cavity.name}'" for cavity in solution.cavities)
    count = on_demand("stability with cavities")
    found, confirmed = count(equations, forward, factors, confirms=line.verdict is Verdict.FAIL)
    if found == 0:
        note = f"unstable at given pressures, but the volume, gas or windkessel of {names} holds the body"
        note = "; ".join(filter(None, [note, potential_note(factors.inertia.asymmetry)]))
        return replace(line, value=0.0, verdict=Verdict.PASS, note=note)
    if not confirmed:
        return undecided
    return replace(line, value=float(confirmed), note=f"{line.note}; what is given for {names} does not hold it")


def _left_out(equations: Equations, forward: ForwardFactors) -> Iterator[str]:
    """Yield what the line on stability leaves out."""
    nodes = forward.solution.mesh_nodes
    if planes := [f"'{plane.region}'" for plane in symmetry_planes(forward.solution.job, equations.body, nodes, nodes)]:
        yield f"motions that are not symmetric about {', '.join(planes)} are left out"


def _barely_held(line: Line, equations: Equations, solution: Solution) -> Iterator[str]:
    """Yield the rigid motion that a line that does not pass may be due to; collective."""
    is_sprung = any(effect.holds for effect in solution.job.effects)
    if (
        line.verdict is not Verdict.PASS
        and not is_sprung
        and (motion := barely_held(equations.body, equations.supports))
    ):
        yield f"the supports leave the body nearly free to {motion}: 'fix: [normal]' barely resists that"


def _factors_line(equations: Equations, forward: ForwardFactors) -> Line:
    """Return the line by the inertia of the forward tangent."""
    inertia = None if forward.factors is None else forward.factors.inertia
    pressures = equations.unknowns.pressure_size
    # Zeros count: a singular tangent is not stable. Each pressure contributes one that is negative or zero.
    unstable = None if inertia is None else inertia.negative + inertia.zero - pressures
    if inertia is None or unstable is None or unstable < 0:
        return skipped(STABILITY, "the tangent could not be factorized")
    if unstable == 0:
        return _stable(inertia.asymmetry)
    return _unstable(unstable, confirm(equations, forward.solution), is_mixed=pressures > 0)


def _iteration_line(equations: Equations, forward: ForwardFactors, observer: Observer) -> Line:
    """Return the line by the lowest eigenvalue of the forward tangent, which is found without factors."""
    lowest_eigenvalue = on_demand("lowest eigenvalue")
    lowest = lowest_eigenvalue(forward.multigrid, equations.supports, equations.timings, observer=observer)
    if lowest is None:
        note = "the lowest eigenvalue of the forward tangent was not found within the iterations that it may take"
        return Line(STABILITY, None, "", _RULE, Verdict.UNDECIDED, note)
    if not lowest.is_negative:
        how = f"estimated: the reciprocal of the lowest eigenvalue that was found is known to {lowest.error:.0%}"
        return _stable(lowest.asymmetry, how)
    with assembled(equations, forward.solution) as matrix:
        with equations.timings("factorization"):
            weak_form = equations.weak_form("forward", given_u_of(equations))
            solver = on_demand("multigrid for the certificate")(matrix, weak_form)
        with freeing(solver.destroy):
            again = lowest_eigenvalue(solver, equations.supports, equations.timings, lowest.direction, observer)
    confirmed = None if again is None else Confirmed(int(again.is_negative), again.asymmetry)
    line = _unstable(1, confirmed, is_mixed=equations.unknowns.p is not None)
    return replace(line, note=f"{line.note}; one direction was sought, there may be more")


def _stable(asymmetry: float, how: str = "") -> Line:
    note = "no negative eigenvalue of the forward tangent"
    return Line(
        STABILITY,
        0.0,
        "",
        _RULE,
        Verdict.PASS,
        "; ".join(filter(None, [note, how, potential_note(asymmetry)])),
    )


def _unstable(count: int, confirmed: Confirmed | None, *, is_mixed: bool) -> Line:
    """Return the line for ``count`` eigenvalues of the tangent that are not positive, some of them ``confirmed``."""
    if confirmed is not None and confirmed.directions:
        # For a tangent that is not symmetric, the symmetric part can prove stability but not instability. The
        # asymmetry is the confirmation's, since the solve's quadrature can make follower loads asymmetric.
        kind = potential_note(confirmed.asymmetry)
        does = "might buckle, snap away or flutter" if kind else "would buckle or snap away"
        note = f"confirmed negative eigenvalues: the loaded body {does}"
        if confirmed.directions < count:
            note += f"; others of the {count} may be spurious modes of the elements"
        verdict = Verdict.WARN if kind else Verdict.FAIL
        note = f"{note}; {kind}, which proves no instability" if kind else note
        return Line(STABILITY, float(confirmed.directions), "", _RULE, verdict, note)
    if confirmed is None:
        why = "they could not be confirmed"
    elif is_mixed:
        why = "none is confirmed: they may be spurious modes of the elements"
    else:
        why = f"none is left with a margin of {MARGIN:.0%} of the elastic energy: the body is at a critical load"
    note = f"negative eigenvalues of the forward tangent, but {why}"
    return Line(STABILITY, float(count), "", _RULE, Verdict.UNDECIDED, note)
