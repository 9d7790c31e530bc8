"""All checks of a certificate, in order."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import isfinite
from typing import TYPE_CHECKING

from hpcinv.certificate.check import Certificate, Line, Verdict, at_most, skipped
from hpcinv.certificate.equilibrium_residual import equilibrium_residual
from hpcinv.certificate.estimate import Estimate, estimate
from hpcinv.certificate.ineffective_loads import ineffective_loads
from hpcinv.certificate.round_trip import closure_error, round_trip
from hpcinv.certificate.shape import shape
from hpcinv.certificate.stability import stability
from hpcinv.certificate.volume import volume
from hpcinv.solver.observer import SILENT, Observer

if TYPE_CHECKING:
    from hpcinv.results.quantities_of_interest import Value
    from hpcinv.results.solution import Solution
    from hpcinv.solver.linear.cost_model import Forecast
    from hpcinv.solver.problem import Model

DISCRETISATION = "discretisation error of the shape, relative to the displacement"


def certify(
    model: Model,
    solutions: Sequence[Solution],
    computed: Mapping[str, Value],
    known: Estimate | None = None,
    begins: Callable[[str], None] = lambda _: None,
    observer: Observer = SILENT,
) -> tuple[Certificate, Estimate | None]:
    """Check the solutions of a run; collective.

    Args:
        solutions: one, or both of a round trip; the certificate is on the body that the first one found.
        computed: values of the job's quantities of interest.
        known: the estimate of the first solution, if it has been made before.
        begins: called with the name of each check when it begins.
        observer: of the solve back.
    """
    solution, lines, found = solutions[0], list[Line](), known
    with model.timings.as_one("certificate"):
        begins("equilibrium")
        lines += [*equilibrium_residual(model, solution), *volume(model, solution)]
        if found is None and model.job.certificate.estimate and _can_estimate(model):
            begins("discretisation error")
            found = estimate(model, solution, computed)
        lines.append(_discretisation(model, solution, found))
        begins("cells and overlap")
        lines += shape(model, solution)
        begins("round trip")
        lines += (
            round_trip(model, solution, observer)
            if len(solutions) == 1
            else [closure_error(model, solution, solutions[1].u)]
        )
        begins("stability")
        lines += stability(model, solution)
        begins("ineffective loads")
        lines += ineffective_loads(model)
    return Certificate(tuple(lines)), found


def _can_estimate(model: Model) -> bool:
    """Return whether there is memory for spaces of one degree more."""
    return _finer(model).least <= model.chooser.room


def _finer(model: Model) -> Forecast:
    forecast = model.chooser.forecast
    return forecast.of_degree(forecast.degree + 1)


def _discretisation(model: Model, solution: Solution, found: Estimate | None) -> Line:
    if found is None:
        needed = f"there is no memory for {_finer(model).least / 1e9:.2g} GB"
        return skipped(
            DISCRETISATION, needed if model.job.certificate.estimate else "switched off: certificate.estimate"
        )
    size = solution.largest_displacement
    if not isfinite(found.shape):
        note = "could not be estimated: at the points of a finer quadrature the solution is not admissible"
        return Line(DISCRETISATION, None, "", "must be finite", Verdict.WARN, note)
    note = f"{found.shape:.3g} m{found.left_out}"
    return at_most(DISCRETISATION, found.shape / size if size else 0.0, 0.05, 0.5, note=note)
