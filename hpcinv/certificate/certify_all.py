"""Checks of all solutions of a run."""

from collections.abc import Callable, Mapping, Sequence

from hpcinv.certificate.certify import certify
from hpcinv.certificate.check import Certificate, Line
from hpcinv.certificate.estimate import Estimate
from hpcinv.results.quantities_of_interest import Value
from hpcinv.results.solution import Solution
from hpcinv.solver.observer import Observer
from hpcinv.solver.problem_cache import Models


def certify_all(
    models: Models,
    solutions: Sequence[Solution],
    quantities: Mapping[str, Value],
    estimate: Estimate | None,
    uncertain: Mapping[str, float],
    detail: Callable[[str], None],
    observer: Observer,
) -> tuple[Certificate, Estimate | None]:
    """Check the solutions: together if they are those of one analysis, else state by state; collective.

    Args:
        observer: as for `certify`.
        uncertain: standard deviations (m) of shapes by errors of the given surface, by state, as far as they are known.
    """
    if not solutions[0].state:
        return certify(models.of(0), solutions, quantities, estimate, detail, observer, None, uncertain.get("", 0.0))
    lines: list[Line] = []
    for number, solution in enumerate(solutions):
        model = models.of(number, solutions[0].displacement if number else None)
        of_state = {q.name: quantities[q.name] for q in model.job.quantities}
        detail(solution.state)
        given = estimate.correction if estimate and not model.is_of_given_mesh else None
        known = uncertain.get(solution.state, 0.0)
        found, of_solution = certify(model, [solution], of_state, None, observer=observer, given=given, uncertain=known)
        lines += found.lines
        estimate = estimate.joined(of_solution) if estimate and of_solution else estimate or of_solution
    return Certificate(tuple(lines)), estimate
