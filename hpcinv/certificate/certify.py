"""All checks of a certificate, in order, each in a module of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from math import isfinite
from typing import TYPE_CHECKING

from hpcinv.certificate.check import Certificate, Line, Verdict, at_most, skipped
from hpcinv.certificate.equilibrium_residual import balance
from hpcinv.certificate.estimate import Estimate, estimate
from hpcinv.certificate.ineffective_loads import idle_loads
from hpcinv.certificate.round_trip import gap, round_trip, stability
from hpcinv.certificate.shape import shape
from hpcinv.certificate.volume import volume
from hpcinv.solver.observer import SILENT, Observer

if TYPE_CHECKING:
    from hpcinv.results.leg import Leg
    from hpcinv.results.quantities_of_interest import Value
    from hpcinv.solver.linear.cost_model import Forecast
    from hpcinv.solver.problem import Model

DISCRETISATION = "discretisation error of the shape, relative to the displacement"


def certify(
    model: Model,
    legs: Sequence[Leg],
    computed: Mapping[str, Value],
    known: Estimate | None = None,
    told: Callable[[str], None] = lambda _: None,
    observer: Observer = SILENT,
) -> tuple[Certificate, Estimate | None]:
    """Check what the legs of a run have found; collective.

    Args:
        legs: one, or both of a round trip; the certificate is on the body that the first one found.
        computed: values of the job's quantities of interest.
        known: the estimate of the first leg, if it has been made before.
        told: called with the name of each check when it begins.
        observer: of the solve back.
    """
    leg, lines, found = legs[0], list[Line](), known
    with model.timings.as_one("certificate"):
        with model.at(leg.mesh_nodes, *leg.solution):
            told("equilibrium")
            lines += _of_the_solution(model, leg)
            if found is None and model.job.certificate.estimate and _can_estimate(model):
                told("discretisation error")
                found = estimate(model, leg, computed)
            lines += _discretisation(model, leg, found)
        told("cells and overlap")
        lines += shape(model, leg)
        told("round trip")
        lines += round_trip(model, leg, observer) if len(legs) == 1 else [gap(model, leg, legs[1].u)]
        told("stability")
        lines += stability(model, leg)
        told("ineffective loads")
        lines += idle_loads(model)
    return Certificate(tuple(lines)), found


def _of_the_solution(model: Model, leg: Leg) -> Iterator[Line]:
    equilibrium = model.equilibrium(model.scene(leg.direction))
    yield from balance(model, equilibrium)
    model.release(equilibrium)
    yield from volume(model, leg)


def _can_estimate(model: Model) -> bool:
    """Whether there is memory for the spaces of one degree more."""
    return _finer(model).least <= model.chooser.room


def _finer(model: Model) -> Forecast:
    forecast = model.chooser.forecast
    return forecast.of_degree(forecast.degree + 1)


def _discretisation(model: Model, leg: Leg, found: Estimate | None) -> Iterator[Line]:
    if found is None:
        needed = f"there is no memory for {_finer(model).least / 1e9:.2g} GB"
        yield skipped(
            DISCRETISATION, needed if model.job.certificate.estimate else "switched off: certificate.estimate"
        )
        return
    size = leg.largest_displacement
    if not isfinite(found.shape):
        note = "could not be estimated: at the points of a finer quadrature the solution is not admissible"
        yield Line(DISCRETISATION, None, "", "must be finite", Verdict.WARN, note)
        return
    note = f"{found.shape:.3g} m{found.left_out}"
    yield at_most(DISCRETISATION, found.shape / size if size else 0.0, 0.05, 0.5, note=note)
