"""Choice of the next discretisation: the cheapest one that is predicted to meet the demands, and its mesh."""

import numpy as np

from hpcinv.base.parallel.runtime import on_root
from hpcinv.trust.accuracy.marking import CellErrors, MarkingPlan, plan, remaining
from hpcinv.trust.accuracy.meshes import Meshes, Variant
from hpcinv.trust.accuracy.refinement_forecast import TARGET, RefinementChoice, RefinementForecast, cautious, choose
from hpcinv.trust.accuracy.trial import Trial

DEEPEST = 2  # largest number of halvings of a marked cell in one step, on bodies without singular edges
# With them: of cells that touch one, whose pieces that touch it are halved again, and of other cells.
GRADED, FEW = 2, 1
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
    errors = errors_of(last) if may_mark and known else None
    planned: list[MarkingPlan] = []

    order = max(forecast.order(last.step.degree), last.step.degree + 1.0)

    # Depends on measured times, which differ from rank to rank.
    def choose_on_root() -> tuple[RefinementChoice, float] | None:
        if not known:
            factor = min(f for f in factors if f >= SECOND_MESH)
            choice = forecast.everywhere(factor, forecast.last.degree)
            return (choice, factor) if choice.unknowns <= limit else None
        if errors is not None:
            planned.append(plan(errors.shares, forecast.excess / TARGET, order, errors.orders))
        places = planned[0].places if planned else None
        best = choose(forecast, factors, places, limit=limit, highest=highest)
        return None if best is None else (best, cautious(forecast, best, factors))

    chosen = on_root(meshes.comm, choose_on_root)
    if chosen is None:
        return None
    choice, factor = chosen
    variant = last.variant
    if choice.kind == "in places":
        levels, ratio = np.zeros(0, dtype=np.int64), 0.0
        if planned and errors is not None:
            touching = errors.touching
            others = FEW if touching.any() else DEEPEST
            levels = np.minimum(planned[0].levels, np.where(touching, GRADED, others))
            edge_shares = np.where(touching, errors.shares, 0.0)
            ratio = remaining(edge_shares, errors.orders, levels) * edge_shares.sum() / errors.shares.sum()
        segments = last.estimate.segments if last.estimate else None
        variant = meshes.halved_cells(variant, last.body, levels, segments, meshes.comm.bcast(ratio))
    elif factor > 1:
        variant = meshes.everywhere(variant, last.body, factor)
    return variant, choice.degree


def errors_of(trial: Trial) -> CellErrors:
    """Return the cells' shares of the error on rank 0, in the order of the source, else nothing; collective."""
    assert trial.estimate is not None
    mesh, limit = trial.body.mesh, trial.estimate.limit
    numbers = np.asarray(mesh.topology.original_cell_index)[: mesh.topology.index_map(3).size_local]
    missed, orders = (1.0, np.inf) if limit is None else (limit.missed, limit.orders)
    shares = trial.estimate.cells * missed
    gathered = mesh.comm.gather((numbers, shares, np.broadcast_to(orders, shares.shape)))
    if gathered is None:
        return CellErrors(np.zeros(0), np.zeros(0))
    count = len(trial.body.source.cells)
    whole = CellErrors(np.zeros(count), np.full(count, np.inf))
    for cells, mine, its in gathered:
        whole.shares[cells], whole.orders[cells] = mine, its
    return whole
