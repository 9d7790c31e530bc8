"""Choice of the next discretisation: the cheapest one that is predicted to meet the demands, and its mesh."""

import numpy as np

from hpcinv.accuracy.forecast import TARGET, RefinementChoice, RefinementForecast, cautious, choose
from hpcinv.accuracy.marking import MarkingPlan, plan
from hpcinv.accuracy.meshes import Meshes, Variant
from hpcinv.accuracy.trial import Trial
from hpcinv.mesh.source import Floats
from hpcinv.parallel.runtime import on_root

DEEPEST = 2  # largest number of halvings of a marked cell in one step
SECOND_MESH = 1.5  # smallest factor between the sizes of two meshes whose comparison gives the error


def decide(
    meshes: Meshes, last: Trial, forecast: RefinementForecast, *, limit: int, highest: int, known: bool, may_mark: bool
) -> tuple[Variant, int] | None:
    """Return mesh and degree to try after the ``last`` ones; ``None`` if no possible choice helps much; collective.

    Args:
        known: whether the present error is known; else any second mesh is taken.
        may_mark: whether cells may be refined locally.
    """
    factors = meshes.factors(last.variant)
    indicators = indicators_of(last) if may_mark and known else None
    planned: list[MarkingPlan] = []

    # Depends on measured times, which differ from rank to rank.
    def on_rank_0() -> tuple[RefinementChoice, float] | None:
        if not known:
            factor = min(f for f in factors if f >= SECOND_MESH)
            choice = forecast.everywhere(factor, forecast.last.degree)
            return (choice, factor) if choice.unknowns <= limit else None
        if indicators is not None:
            order = max(forecast.order(last.step.degree), last.step.degree + 1.0)
            planned.append(plan(indicators, forecast.excess / TARGET, order))
        places = planned[0].places if planned else None
        best = choose(forecast, factors, places, limit=limit, highest=highest)
        return None if best is None else (best, cautious(forecast, best, factors))

    found = on_root(meshes.comm, on_rank_0)
    if found is None:
        return None
    choice, factor = found
    variant = last.variant
    if choice.kind == "in places":
        levels = np.minimum(planned[0].levels, DEEPEST) if planned else np.zeros(0, dtype=np.int64)
        variant = meshes.in_places(variant, last.body, levels)
    elif factor > 1:
        variant = meshes.everywhere(variant, last.body, factor)
    return variant, choice.degree


def indicators_of(trial: Trial) -> Floats:
    """Return each cell's share of the estimate on rank 0, in the order of the source, else nothing; collective."""
    assert trial.estimate is not None
    mesh = trial.body.mesh
    numbers = np.asarray(mesh.topology.original_cell_index)[: mesh.topology.index_map(3).size_local]
    gathered = mesh.comm.gather((numbers, trial.estimate.cells))
    if gathered is None:
        return np.zeros(0)
    shares = np.zeros(len(trial.body.source.cells))
    for cells, mine in gathered:
        shares[cells] = mine
    return shares
