"""Checks of all solutions of a run."""

from collections.abc import Callable, Mapping, Sequence

from hpcinv.certificate.certify import certify
from hpcinv.certificate.check import Certificate, Line
from hpcinv.certificate.discretisation_error import Estimate
from hpcinv.job.sections import QuantityOfInterest, QuantityValue
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.solver.observer import Observer


def certify_all(
    equations: Sequence[Equations],
    solutions: Sequence[Solution],
    quantities: Sequence[QuantityOfInterest],
    values: Mapping[str, QuantityValue],
    estimate: Estimate | None,
    deviations: Mapping[str, float],
    detail: Callable[[str], None],
    observer: Observer,
) -> tuple[Certificate, Estimate | None]:
    """Check the solutions: together if they belong to one analysis, else state by state; collective.

    Args:
        equations: of each solution.
        quantities: quantities of interest of the job.
        values: their values, by the names of the parts where a quantity is between two states.
        observer: as for `certify`.
        deviations: standard deviations (m) of shapes by errors of the given surface, by state, where they are known.
    """
    if not solutions[0].state:
        return certify(equations[0], solutions, values, estimate, detail, observer, None, deviations.get("", 0.0))
    lines: list[Line] = []
    for number, solution in enumerate(solutions):
        state_quantities = {q.name: values[q.name] for q in solution.job.quantities}
        detail(solution.state)
        rest_correction = estimate.correction if estimate and not solution.is_on_given_mesh else None
        deviation = deviations.get(solution.state, 0.0)
        certificate, solution_estimate = certify(
            equations[number],
            [solution],
            state_quantities,
            None,
            observer=observer,
            rest_correction=rest_correction,
            deviation=deviation,
        )
        lines += certificate.lines
        estimate = (
            estimate.joined(solution_estimate) if estimate and solution_estimate else estimate or solution_estimate
        )
    return Certificate(tuple(lines)), estimate.of_quantities(quantities) if estimate else None
