"""The line on the discretisation error of the shape."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import isfinite

from hpcinv.base.quantity.units import readable
from hpcinv.on_demand import on_demand
from hpcinv.results.displacement_scale import displacement_scale
from hpcinv.solver.equations import Equations
from hpcinv.trust.certificate.certify import Check, CheckedRun
from hpcinv.trust.certificate.check import Line, Verdict, skipped, topic, upper_bound_line
from hpcinv.trust.discretisation.estimate import LINEAR, Estimate

DISCRETISATION = topic(
    "discretisation error of the shape, relative to the displacement",
    "Estimated distance of the nodes from their places on an infinitely fine mesh.",
    "Use smaller cells, 'geometry_degree: 2' on a curved solid, or demand an accuracy.",
    computed="[a Newton correction](../theory/error-estimate.md) in spaces of one degree more",
    thresholds="above 0.05; above 0.5 after a solve there",
    costs="a factorization in the finer spaces, in large bodies iterations",
    judges_mesh=True,
)
WARN = 0.05
"""Error, relative to the displacement, above which the line warns."""
UNRELIABLE = 10.0
"""Ratio of the error to an estimate that is not reliable, up to which its line is decided; larger decides fewer."""


class DiscretisationCheck(Check):
    """Estimate the discretisation error of the shape, unless that was done before."""

    name, order = "discretisation error", 70
    has_switch = True

    def lines(self, run: CheckedRun) -> Iterator[Line]:
        equations, solution = run.equations, run.solution
        if run.has_unknown_loads:
            yield skipped(DISCRETISATION, f"is not estimated where {solution.constraints[-1].what} is unknown")
            return
        if solution.job.all_interfaces:
            yield skipped(DISCRETISATION, "interfaces join surfaces: compare two meshes")
            return
        is_asked = solution.job.certificate.estimate
        if run.estimate is None and is_asked:
            estimate = on_demand("estimate of errors")
            run.estimate = estimate(equations, solution, run.computed, run.rest_correction, run.observer)
        if run.estimate is not None:
            scale = displacement_scale(equations, solution)
            yield _line(run.estimate, scale.length, scale.note, run.deviation)
        else:
            yield skipped(DISCRETISATION, _lack(equations) if is_asked else "switched off: certificate.estimate")


def _lack(equations: Equations) -> str:
    """Return why memory does not suffice for an estimate."""
    finer = on_demand("finer problem")(equations.job.mesh.kind)
    forecast = finer.forecast(equations)
    return f"there is no memory for {forecast.least / 1e9:.2g} GB{finer.attempts(forecast)}"


def _remarks(estimated: Estimate) -> Iterator[str]:
    if estimated.is_solved:
        yield f"found by a solve {estimated.finer}"
    if estimated.unreliable:
        yield f"not reliable at singular fibres: {', '.join(estimated.unreliable)}"


def _line(estimated: Estimate, scale: float, scale_note: str, deviation: float) -> Line:
    """Return the line of an estimate.

    Args:
        scale: displacement (m) that errors are relative to, with a note on it.
        deviation: standard deviation (m) of the shape by errors of the given surface, 0 if it is not known.
    """
    if not isfinite(estimated.shape):
        return _not_finite(estimated)
    note = "; ".join(filter(None, [f"{readable(estimated.shape, 'm')}{estimated.left_out}", scale_note]))
    line = upper_bound_line(DISCRETISATION, estimated.shape / scale if scale else 0.0, WARN, LINEAR)
    if line.verdict is Verdict.FAIL and not estimated.is_solved:
        note += "; too large to be estimated by one Newton step"
        if estimated.is_too_dear:
            note += ", and a solve in spaces of one degree more takes too long: raise discretisation.displacement"
        return replace(line, note=note, verdict=Verdict.UNDECIDED)
    verdict, doubt = line.verdict, estimated.limit.doubt if estimated.limit else ""
    # Where errors of opposite signs nearly cancel, the estimate may be a tenth of the error.
    if doubt and verdict is Verdict.PASS and UNRELIABLE * (line.value or 0.0) > WARN:
        verdict = Verdict.UNDECIDED
    parts = [*_remarks(estimated), doubt]
    if deviation and estimated.shape <= deviation:  # the mesh need not be better than the image deserves
        parts.append(f"the given surface is uncertain by {readable(deviation, 'm', 2)}")
        verdict = Verdict.PASS if verdict is Verdict.WARN else verdict
    return replace(line, note="; ".join(filter(None, [note, *parts])), verdict=verdict)


def _not_finite(estimated: Estimate) -> Line:
    if estimated.finer is not Estimate.finer:
        note = f"could not be estimated: no solution on this path was found {estimated.finer} in the time allowed"
        return Line(DISCRETISATION, None, "", "must be finite", Verdict.UNDECIDED, note)
    note = "could not be estimated: at the points of a finer quadrature the solution is not admissible"
    return Line(DISCRETISATION, None, "", "must be finite", Verdict.WARN, note)
