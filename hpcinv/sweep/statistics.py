"""Statistics of the quantities of interest over a sample: mean, standard deviation and quantiles, of each branch."""

from collections.abc import Mapping, Sequence

import numpy as np

from hpcinv.batch.ledger.record import CaseRecord
from hpcinv.batch.tables import Columns
from hpcinv.sweep.plan import SweepPlan
from hpcinv.sweep.table import columns, quantity_columns, units

QUANTILES = {"minimum": 0.0, "5 %": 0.05, "median": 0.5, "95 %": 0.95, "maximum": 1.0}


def statistics(plan: SweepPlan, records: Mapping[str, CaseRecord]) -> Columns:
    """Return a row for each quantity of interest and each combination of branches, over the converged cases; SI.

    ``sd`` is that of the population, estimated with ``n - 1``; ``sd of mean`` is ``sd/√n``, as for independent draws.
    """
    table, quantities = columns(plan, records), quantity_columns(plan, records)
    names, unit = plan.sweep.branches, units(plan, records)
    labels = list(zip(*(table[name] for name in names), strict=True)) or [()] * len(plan.cases)
    found: Columns = {
        name: [] for name in (*names, "quantity", "unit", "cases", "mean", "sd", "sd of mean", *QUANTILES)
    }
    for group in dict.fromkeys(labels):
        for quantity in quantities:
            values = [v for v, of in zip(table[quantity], labels, strict=True) if of == group and v is not None]
            if values:
                row = [*group, quantity, unit.get(quantity, ""), len(values), *_moments(values)]
                row += [float(np.quantile(values, share)) for share in QUANTILES.values()]
                for column, value in zip(found.values(), row, strict=True):
                    column.append(value)
    return found


def _moments(values: Sequence[float]) -> tuple[float, float | None, float | None]:
    mean = float(np.mean(values))
    if len(values) < 2:
        return mean, None, None
    sd = float(np.std(values, ddof=1))
    return mean, sd, sd / len(values) ** 0.5
