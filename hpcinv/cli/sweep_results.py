"""Commands that show the results of a sweep: ``sweep status | table | statistics | indices | plot``."""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Callable, Container
from dataclasses import replace as replace_fields
from pathlib import Path
from typing import TYPE_CHECKING

from hpcinv.base.files.atomic import output_errors, replace
from hpcinv.base.files.json_data import json_data
from hpcinv.cli.options import file_ending, positive
from hpcinv.errors import JobError
from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.ledger.ledger import Ledger
from hpcinv.studies.batch.outcomes import Outcome
from hpcinv.studies.batch.status import DAMAGED, Status, show
from hpcinv.studies.sweep.kept_plan import known_plan
from hpcinv.studies.sweep.results import finished, outcomes, provenance, results, status_of
from hpcinv.studies.sweep.sweep_plan import SweepPlan

if TYPE_CHECKING:
    from hpcinv.studies.sweep.table import SweepTable


def add_results(action: Callable[..., argparse.ArgumentParser]) -> None:
    """Add the commands; ``action`` makes a parser from name, function, sentence and options of an example."""
    status = action(
        "status",
        _status,
        "Show the numbers of finished, running, failed and open cases, and the time left.",
        "--follow",
    )
    status.add_argument("--follow", action="store_true", help="repeat it until all cases are finished")

    table = action(
        "table", _table, "Write a row for each case: parameters, quantities, certificate, costs.", "--output table.csv"
    )
    table.add_argument(
        "--output", type=file_ending(".csv", ".h5"), metavar="FILE", help=".csv or .h5 (default: CSV to the screen)"
    )

    action("statistics", _statistics, "Write means, standard deviations and quantiles of the quantities, as CSV.")

    indices = action(
        "indices", _indices, "Compute Sobol indices of the quantities of a sample, by polynomial surrogates.", "--plan"
    )
    indices.add_argument(
        "--plan", action="store_true", help="only show how many cases each degree needs, and their time"
    )
    indices.add_argument("--first", type=positive, metavar="N", help="only the first N cases: a smaller sample")
    indices.add_argument(
        "--confidence", type=_share, default=0.95, metavar="P", help="confidence level of the intervals (default 0.95)"
    )
    indices.add_argument("--output", type=file_ending(".json"), metavar="FILE", help="write all figures (.json)")
    indices.add_argument(
        "--shape",
        type=file_ending(".vtu"),
        metavar="FILE",
        help="standard deviation and dominating parameter at nodes (.vtu)",
    )

    plot = action(
        "plot", _plot, "Plot a quantity over one or two parameters, as PNG and SVG.", "height --over material.young"
    )
    plot.add_argument("quantity", help="a column of the table, or 'failures' for where cases fail")
    plot.add_argument("--over", nargs="+", required=True, metavar="KEY", help="one or two columns of parameters")
    plot.add_argument("--output", type=Path, metavar="STEM", help="path without the ending (default: in results/SWEEP)")


def _status(options: argparse.Namespace) -> int:
    plan = known_plan(options.sweep)
    ledger = plan.ledger
    known: dict[str, Outcome] = {}

    def look() -> Status:
        nonlocal known
        known = outcomes(plan, ledger, known)
        return status_of(plan, ledger, known)

    show(look, followed=options.follow)
    return 0


def _table(options: argparse.Namespace) -> int:
    plan = known_plan(options.sweep)
    ledger = plan.ledger

    from hpcinv.studies.batch.tables import as_csv

    sweep_table = _sweep_table(plan, ledger)
    if options.output is not None and options.output.suffix == ".h5":
        _write(options.output, sweep_table.as_hdf5(provenance(plan, ledger)))
        return 0
    text = as_csv(*sweep_table.in_units_of_the_job())
    if options.output is None:
        sys.stdout.write(text)
    else:
        _write(options.output, text.encode())
    return 0


def _statistics(options: argparse.Namespace) -> int:
    plan = known_plan(options.sweep)

    from hpcinv.studies.batch.tables import as_csv
    from hpcinv.studies.sweep.table import statistics

    sys.stdout.write(as_csv(statistics(_sweep_table(plan, plan.ledger)), {}))  # units are a column
    return 0


def _indices(options: argparse.Namespace) -> int:
    plan = known_plan(options.sweep)
    ledger = plan.ledger

    from hpcinv.studies.sweep import indices

    if options.plan:
        print("\n".join(indices.costs(plan, _read(plan, ledger))))
        return 0
    plan = replace_fields(plan, cases=plan.cases[: options.first])
    records = _read(plan, ledger)
    sample = indices.finished_sample(plan, records)
    keys = list(sample.distributions)
    for path in filter(None, (options.output, options.shape)):
        with output_errors(path, "Choose another file."):
            path.parent.mkdir(parents=True, exist_ok=True)
    print("\n".join(indices.describe_sample(sample, records)), flush=True)
    quantity_indices, left_out = indices.quantity_indices(sample, records, options.confidence)
    for quantity in quantity_indices:
        print("\n".join(indices.describe(quantity, keys, options.confidence)), flush=True)
    for text in left_out:
        print(f"left out: {text}")
    data = indices.as_data(quantity_indices, sample, options.confidence)
    if options.shape is not None:
        from hpcinv.studies.sweep.shape_spread import describe_shape, shape_spread

        spread = shape_spread(sample, ledger, options.confidence)
        spread.write(options.shape, keys)
        print("\n".join(describe_shape(spread, keys, options.confidence)))
        print(options.shape)
        data["shape"] = indices.data_of(spread.whole, sample)
    elif not quantity_indices:
        raise JobError(f"{plan.path}: no case has a quantity; add 'quantities' to the job, or ask for --shape")
    if options.output is not None:
        _write(options.output, json.dumps(json_data(data), indent=1, ensure_ascii=False).encode())
    return 0


def _plot(options: argparse.Namespace) -> int:
    plan = known_plan(options.sweep)
    stem = options.output or _stem(plan, options.quantity, options.over)

    from hpcinv.studies.sweep.sweep_plot import plot

    files, left_out = plot(plan, _read(plan, plan.ledger).items(), options.quantity, options.over)
    for form, content in files.items():
        path = stem.with_name(f"{stem.name}.{form}")
        _write(path, content)
        print(path)
    for text in left_out:
        print(f"left out: {text}")
    return 0


def _sweep_table(plan: SweepPlan, ledger: Ledger) -> SweepTable:
    """Return the table of the finished cases; report how many damaged ones are left out."""
    from hpcinv.studies.sweep.table import SweepTable

    sweep_table = SweepTable(plan, finished(plan, ledger))
    _report_damaged(plan, ledger, sweep_table.finished)
    return sweep_table


def _read(plan: SweepPlan, ledger: Ledger) -> dict[str, CaseRecord]:
    """Return the records of the finished cases; report how many damaged ones are left out."""
    records = results(plan, ledger)
    _report_damaged(plan, ledger, records)
    return records


def _report_damaged(plan: SweepPlan, ledger: Ledger, finished: Container[str]) -> None:
    """Report on standard error how many cases are not finished since their record is damaged."""
    left = dict.fromkeys(key for key in plan.cases.keys if key not in finished)
    if damaged := len(ledger.damaged(left)):
        print(f"{plan.store}: left out {damaged:,} × {DAMAGED}", file=sys.stderr)


def _stem(plan: SweepPlan, quantity: str, axes: list[str]) -> Path:
    name = re.sub(r"[^\w.]+", "-", f"{quantity} over {' '.join(axes)}").strip("-")
    return plan.results / name


def _share(text: str) -> float:
    if not 0 < (share := float(text)) < 1:
        raise argparse.ArgumentTypeError("must be between 0 and 1, such as 0.95")
    return share


def _write(path: Path, content: bytes) -> None:
    """Write a file; it appears whole or not at all."""
    with output_errors(path, "Choose another --output."):
        path.parent.mkdir(parents=True, exist_ok=True)
        replace(path, content)
