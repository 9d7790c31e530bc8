"""Python interface of sweeps: solve the open cases, and return the table of all."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.studies.batch.conduct import conduct
from hpcinv.studies.sweep.results import finished
from hpcinv.studies.sweep.sweep_batch import open_damaged, sweep_batch
from hpcinv.studies.sweep.sweep_plan import load_sweep
from hpcinv.studies.sweep.table import SweepTable


class Table(dict[str, list[Any]]):
    """Columns by name, with an entry for each case in the order of the sweep; ``pandas.DataFrame`` takes it.

    Numbers are SI; unknown values are ``None``. The columns are as in ``sweep table``.

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
    """Solve the open cases of a sweep, and return the table of all cases; collective.

    Cases that are finished in the store are not solved again. Cases are solved in this process: unlike under
    ``sweep run``, a case that crashes ends it; the same call then continues with the others.

    Args:
        source: a sweep file, or a mapping with the content of one.
        directory: base of relative paths in a mapping; in a file they are relative to the file.
        note: called with a line on each finished case, on the first rank of the group that solved it.

    Returns:
        The table, the same on every rank. The column ``status`` has the diagnosis of a failed case.

    Raises:
        JobError: the sweep is not valid; all errors are raised on every rank.
        OutputError: the number of ranks is not a multiple of ``ranks_per_case``, or the store cannot be used.
    """
    plan = on_root(comm, lambda: load_sweep(source, directory))
    on_root(comm, lambda: open_damaged(plan))
    conduct(sweep_batch(plan), comm, ranks_per_case=ranks_per_case, note=note)

    def table() -> Table:
        sweep_table = SweepTable(plan, finished(plan, plan.ledger))
        return Table(sweep_table.columns(), sweep_table.units())

    return on_root(comm, table)
