"""Sweeps from Python: solve the cases that are open, and get the table of all."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import hpcinv.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
from hpcinv.batch.conduct import conduct
from hpcinv.batch.ledger.ledger import ledger_of
from hpcinv.parallel.runtime import MPI, on_root
from hpcinv.sweep.execution import SweepBatch
from hpcinv.sweep.plan import load_sweep
from hpcinv.sweep.results import results
from hpcinv.sweep.table import columns, units


class Table(dict[str, list[Any]]):
    """Columns by name, with an entry for each case in the order of the sweep; ``pandas.DataFrame(table)`` takes it.

    Numbers are SI, and ``None`` is what is not known. The columns are those of ``sweep table``.

    Attributes:
        units: SI units of the columns that have one.
    """

    def __init__(self, columns: Mapping[str, list[Any]], units: Mapping[str, str]) -> None:
        super().__init__(columns)
        self.units = {name: unit for name, unit in units.items() if name in columns and unit}


def sweep(
    source: str | Path | Mapping[str, Any],
    comm: MPI.Intracomm = MPI.COMM_WORLD,
    *,
    directory: str | Path = ".",
    ranks_per_case: int = 1,
    note: Callable[[str], None] = lambda text: None,
) -> Table:
    """Solve the cases of a sweep that are open, and give the table of all of them; collective.

    What is in the store already is not solved again. Cases are solved in this process: unlike under ``sweep run``, one
    that crashes takes it along, and the same call then goes on with the others.

    Args:
        source: a sweep file, or a mapping with the content of one.
        directory: where relative paths in a mapping begin; those in a file begin where that lies.
        ranks_per_case: ranks that solve a case together; it must divide the number of ranks.
        note: called with a line on each case that has ended, on the first rank of the group that solved it.

    Returns:
        The table, the same on every rank. A case that failed has its diagnosis in the column ``status``.

    Raises:
        JobError: the sweep is not valid; on every rank, as all of these.
        OutputError: the number of ranks does not suit, or the store cannot be used.
    """
    plan = on_root(comm, lambda: load_sweep(source, directory))
    conduct(SweepBatch(plan), comm, ranks_per_case=ranks_per_case, note=note)

    def table() -> Table:
        records = results(plan, ledger_of(plan.store))
        return Table(columns(plan, records), units(plan, records))

    return on_root(comm, table)
