"""Commands that show the results of a sweep: ``sweep status | table | statistics | plot``."""

import argparse
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hpcinv.batch.ledger.ledger import ledger_of
from hpcinv.batch.ledger.record import CaseRecord
from hpcinv.batch.status import Status, show
from hpcinv.files.atomic import output_errors, replace
from hpcinv.sweep.plan import SweepPlan, load_sweep
from hpcinv.sweep.results import provenance, results, status_of


def add_reports(action: Callable[[str, Any, str], argparse.ArgumentParser]) -> None:
    """Add the commands; ``action`` makes a parser from name, function and help."""
    status = action("status", _status, "numbers of finished, running, failed and open cases, and the time left")
    status.add_argument("--follow", action="store_true", help="repeat it until all cases are finished")

    table = action("table", _table, "a row for each case: parameters, quantities, certificate, costs")
    table.add_argument("--output", type=_table_file, metavar="FILE", help=".csv or .h5 (default: CSV to the screen)")

    action("statistics", _statistics, "means, standard deviations and quantiles of the quantities, as CSV")

    plot = action("plot", _plot, "a quantity over one or two parameters, as PNG and SVG")
    plot.add_argument("quantity", help="a column of the table, or 'failures' for where cases fail")
    plot.add_argument("--over", nargs="+", required=True, metavar="KEY", help="one or two columns of parameters")
    plot.add_argument("--output", type=Path, metavar="STEM", help="path without the ending (default: in results/SWEEP)")


def _status(options: argparse.Namespace) -> int:
    plan = load_sweep(options.sweep)
    ledger = ledger_of(plan.store)
    records: dict[str, CaseRecord] = {}

    def look() -> Status:
        nonlocal records
        records = results(plan, ledger, records)
        return status_of(plan, ledger, records)

    show(look, followed=options.follow)
    return 0


def _table(options: argparse.Namespace) -> int:
    plan = load_sweep(options.sweep)
    ledger = ledger_of(plan.store)
    records = results(plan, ledger)

    from hpcinv.batch.tables import as_csv
    from hpcinv.sweep.table import as_hdf5, columns, units

    if options.output is None:
        sys.stdout.write(as_csv(columns(plan, records), units(plan, records)))
    elif options.output.suffix == ".csv":
        _write(options.output, as_csv(columns(plan, records), units(plan, records)).encode())
    else:
        _write(options.output, as_hdf5(plan, records, provenance(plan, ledger)))
    return 0


def _statistics(options: argparse.Namespace) -> int:
    plan = load_sweep(options.sweep)
    records = results(plan, ledger_of(plan.store))

    from hpcinv.batch.tables import as_csv
    from hpcinv.sweep.table import statistics

    sys.stdout.write(as_csv(statistics(plan, records), {}))  # units are a column
    return 0


def _plot(options: argparse.Namespace) -> int:
    plan = load_sweep(options.sweep)
    stem = options.output or _stem(plan, options.quantity, options.over)

    from hpcinv.sweep.plot import plot

    diagram = plot(plan, results(plan, ledger_of(plan.store)), options.quantity, options.over)
    for form, content in diagram.files.items():
        path = stem.with_name(f"{stem.name}.{form}")
        _write(path, content)
        print(path)
    for text in diagram.left_out:
        print(f"left out: {text}")
    return 0


def _stem(plan: SweepPlan, quantity: str, over: list[str]) -> Path:
    name = re.sub(r"[^\w.]+", "-", f"{quantity} over {' '.join(over)}").strip("-")
    return Path("results") / plan.sweep.sweep / name


def _table_file(text: str) -> Path:
    if not text.endswith((".csv", ".h5")):
        raise argparse.ArgumentTypeError(f"'{text}' must end with .csv or .h5")
    return Path(text)


def _write(path: Path, content: bytes) -> None:
    """Write a file; it appears whole or not at all."""
    with output_errors(path, "Choose another --output."):
        path.parent.mkdir(parents=True, exist_ok=True)
        replace(path, content)
