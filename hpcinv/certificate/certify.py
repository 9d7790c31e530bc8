"""All checks of a certificate, in order."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite

from hpcinv.certificate import halved_cells
from hpcinv.certificate.check import Certificate, Line, Verdict, skipped, upper_bound_line
from hpcinv.certificate.contact_check import contacts, penalties
from hpcinv.certificate.discretisation_error import LINEAR, Correction, Estimate, estimate, finer_forecast
from hpcinv.certificate.equilibrium_residual import equilibrium_residual
from hpcinv.certificate.forward_factors import ForwardFactors
from hpcinv.certificate.ineffective_loads import ineffective_loads
from hpcinv.certificate.limit_point_check import limit_points
from hpcinv.certificate.round_trip import closure_error, round_trip
from hpcinv.certificate.shape import cells, self_overlap
from hpcinv.certificate.shell_check import faces
from hpcinv.certificate.stability_check import stability
from hpcinv.certificate.two_level import MANY
from hpcinv.certificate.unknown_loads_check import (
    judged_with_given_numbers,
    no_limit_points,
    stable_motions,
    unknown_loads,
)
from hpcinv.certificate.vertex_forces import vertex_forces
from hpcinv.certificate.volume import volume
from hpcinv.job.sections import QuantityValue
from hpcinv.parallel.runtime import MPI
from hpcinv.quantity.units import readable
from hpcinv.results.displacement_scale import displacement_scale
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.solver.observer import SILENT, Observer, freeing, stop_if_asked

UNRELIABLE = 10.0
"""Ratio of the error to an estimate that is not reliable, up to which its line is decided; larger decides fewer."""
DISCRETISATION = "discretisation error of the shape, relative to the displacement"


def certify(
    equations: Equations,
    solutions: Sequence[Solution],
    computed: Mapping[str, QuantityValue],
    prior_estimate: Estimate | None = None,
    begins: Callable[[str], None] = lambda _: None,
    observer: Observer = SILENT,
    rest_correction: Correction | None = None,
    deviation: float = 0.0,
) -> tuple[Certificate, Estimate | None]:
    """Check the solutions of a run; collective.

    Args:
        solutions: one, or both of a round trip; the certificate is on the body that the first one found.
        computed: values of the job's quantities of interest.
        prior_estimate: the estimate of the first solution, if it has been made before.
        begins: called with the name of each check when it begins.
        observer: of the return solve, and of a solve in finer spaces; it is also asked whether to stop.
        rest_correction: for a further state, the correction of the rest shape by the estimate of the given one.
        deviation: standard deviation (m) of the shape by errors of the given surface, 0 if it is not known.

    Raises:
        Stopped: on all ranks, before a check or within a long one, if the observer asks to stop.
    """
    equations.put(solutions[0])
    checks = _Checks(equations, solutions, computed, prior_estimate, begins, observer, rest_correction, deviation)
    with equations.timings.as_one("certificate"):
        with freeing(checks.forward.destroy, equations.free_multigrid):
            checks.check_equations()
            checks.make("discretisation error", checks.discretisation_line)
            checks.check_shape()
            checks.make("round trip", checks.round_trip_lines)
            checks.check_stability()
        if checks.is_on:
            checks.make("limit points", checks.limit_point_lines)
            checks.make("ineffective loads", lambda: ineffective_loads(equations, solutions[0]))
    return Certificate(tuple(checks.lines)), checks.estimated


@dataclass
class _Checks:
    """Checks of one certificate. Later ones use the estimate and the stability that earlier ones found."""

    equations: Equations
    solutions: Sequence[Solution]
    computed: Mapping[str, QuantityValue]
    estimated: Estimate | None
    begins: Callable[[str], None]
    observer: Observer
    rest_correction: Correction | None
    deviation: float
    lines: list[Line] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.solution = self.solutions[0]
        self.forward = ForwardFactors(self.equations, self.solution)
        self.has_unknown_loads = bool(self.solution.cavities or self.solution.remote_loads)
        self.is_on = self.solution.job.certificate.level != "off"

    def make(self, name: str, function: Callable[[], Iterable[Line]]) -> list[Line]:
        """Make a check; add its lines with its seconds, and return them."""
        # Also since the check before may have been cut short, so that its lines say nothing.
        comm = self.equations.body.mesh.comm
        stop_if_asked(comm, self.observer)
        self.begins(name)
        started = time.perf_counter()
        made = list(function())
        seconds = comm.allreduce(time.perf_counter() - started, op=MPI.MAX)
        made[:1] = [replace(line, seconds=seconds) for line in made[:1]]
        made = [replace(line, state=self.solution.state) for line in made]
        self.lines.extend(made)
        return made

    def check_equations(self) -> None:
        """Check that the solution satisfies the discrete equations."""
        equations, solution = self.equations, self.solution
        if not self.is_on:
            return
        self.make("equilibrium", lambda: equilibrium_residual(equations, solution))
        self.make("forces at vertices", lambda: vertex_forces(equations, solution))
        if solution.contacts:
            self.make("contact", lambda: contacts(equations, solution))
        if self.has_unknown_loads:
            self.make("unknown loads", lambda: unknown_loads(solution))
        self.make("volume", lambda: volume(equations, solution))
        if solution.job.mesh.shell is not None:
            self.make("faces", lambda: faces(equations, solution))

    def discretisation_line(self) -> Iterator[Line]:
        """Yield the line on the discretisation error, which is estimated if it was not before."""
        solution = self.solution
        if self.has_unknown_loads:
            what = "the pressure of a cavity" if solution.cavities else "the motion under a remote load"
            yield skipped(DISCRETISATION, f"is not estimated where {what} is unknown")
            return
        if self.estimated is None and solution.job.certificate.estimate:
            self.estimated = estimate(self.equations, solution, self.computed, self.rest_correction, self.observer)
        yield _discretisation(self.equations, solution, self.estimated, self.deviation)

    def check_shape(self) -> None:
        """Check the cells of the computed shape, and that it does not pass through itself."""
        if self.is_on:
            self.make("cells", lambda: cells(self.equations, self.solution))
        self.make("overlap", lambda: self_overlap(self.equations, self.solution))

    def round_trip_lines(self) -> Iterator[Line]:
        """Yield the lines of the round trip, judged by the largest other error of the shape."""
        has_returned = len(self.solutions) > 1
        if has_returned:
            checked = iter([closure_error(self.equations, self.solution, self.solutions[1].u)])
        else:
            checked = round_trip(self.equations, self.solution, self.forward, self.observer)
        error = 0.0 if self.estimated is None or not isfinite(self.estimated.shape) else self.estimated.shape
        if self.has_unknown_loads and not has_returned:
            checked = judged_with_given_numbers(checked)
        for line in checked:
            scale = displacement_scale(self.equations, self.solution).length
            yield _return_line(line, scale, max(self.deviation, error))

    def check_stability(self) -> None:
        """Check stability, and what needs the factors of the forward tangent besides."""
        equations, solution, forward = self.equations, self.solution, self.forward
        (self.stable,) = self.make("stability", self._stability_line)
        if not (self.is_on and solution.job.certificate.stability):
            return
        if solution.remote_loads:
            self.make("remote loads", lambda: stable_motions(equations, forward))
        if any(contact.tolerance is not None for contact in solution.contacts):
            self.make("penalty", lambda: penalties(equations, solution, forward))

    def _stability_line(self) -> Iterable[Line]:
        checked = stability(self.equations, self.forward, self.observer)
        return judged_with_given_numbers(checked) if self.solution.remote_loads else checked

    def limit_point_lines(self) -> Iterable[Line]:
        """Return the lines on limit points of the path."""
        if self.has_unknown_loads:
            return no_limit_points(self.solution)
        return limit_points(self.equations, self.solution, self.stable)


def _return_line(line: Line, scale: float, largest: float) -> Line:
    """Return the line on the round trip, relative to ``scale``, judged by the largest other error of the shape (m)."""
    if line.verdict is not Verdict.WARN or (line.value or 0.0) * scale > largest:
        return line
    return replace(
        line, verdict=Verdict.PASS, note=f"{line.note}; the shape has a larger error of {readable(largest, 'm')}"
    )


def _discretisation(equations: Equations, solution: Solution, estimated: Estimate | None, deviation: float) -> Line:
    if estimated is None and not solution.job.certificate.estimate:
        return skipped(DISCRETISATION, "switched off: certificate.estimate")
    if estimated is None:
        forecast, is_shell = finer_forecast(equations), solution.job.mesh.shell is not None
        tried = f" {halved_cells.DESCRIPTION}" if is_shell else ""
        if forecast.operations > MANY and not is_shell:
            tried = ", and iterations do not find it"
        return skipped(DISCRETISATION, f"there is no memory for {forecast.least / 1e9:.2g} GB{tried}")
    if not isfinite(estimated.shape) and estimated.finer is not Estimate.finer:
        note = f"could not be estimated: no solution on this path was found {estimated.finer} in the time allowed"
        return Line(DISCRETISATION, None, "", "must be finite", Verdict.UNDECIDED, note)
    if not isfinite(estimated.shape):
        note = "could not be estimated: at the points of a finer quadrature the solution is not admissible"
        return Line(DISCRETISATION, None, "", "must be finite", Verdict.WARN, note)
    scale = displacement_scale(equations, solution)
    note = "; ".join(filter(None, [f"{readable(estimated.shape, 'm')}{estimated.left_out}", scale.note]))
    line = upper_bound_line(
        DISCRETISATION, estimated.shape / scale.length if scale.length else 0.0, 0.05, LINEAR, note=note
    )
    if line.verdict is Verdict.FAIL and not estimated.is_solved:
        note += "; too large to be estimated by one Newton step"
        if estimated.is_too_dear:
            note += ", and a solve in spaces of one degree more takes too long: raise discretisation.displacement"
        return replace(line, note=note, verdict=Verdict.UNDECIDED)
    if estimated.is_solved:
        note += f"; found by a solve {estimated.finer}"
        line = replace(line, note=note)
    if estimated.unreliable:
        note += f"; not reliable at singular fibres: {', '.join(estimated.unreliable)}"
        line = replace(line, note=note)
    if estimated.limit and estimated.limit.doubt:
        note += f"; {estimated.limit.doubt}"
        # Of errors that nearly cancel, the estimate may show a tenth.
        if line.verdict is Verdict.PASS and UNRELIABLE * (line.value or 0.0) > 0.05:
            line = replace(line, verdict=Verdict.UNDECIDED)
        line = replace(line, note=note)
    if not deviation or estimated.shape > deviation:
        return line
    # The mesh need not be better than the image deserves.
    note += f"; the given surface is uncertain by {readable(deviation, 'm', 2)}"
    return replace(line, note=note, verdict=Verdict.PASS if line.verdict is Verdict.WARN else line.verdict)
