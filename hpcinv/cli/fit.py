"""``hpcinv fit``: parameters of material laws from tests."""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpcinv.base.files.names import check_directory_of
from hpcinv.base.files.untrusted import add_option
from hpcinv.cli.help import add_command
from hpcinv.cli.options import positive
from hpcinv.errors import JobError, OutputError

if TYPE_CHECKING:
    from hpcinv.studies.fitting.candidate import Candidate
    from hpcinv.studies.fitting.fit_report import CheckedFit
    from hpcinv.studies.fitting.measurements import FileOptions, Test

_EXAMPLES = """hpcinv fit uniaxial.csv planar.csv --law mooney-rivlin --plot fit.png
hpcinv fit tests.csv --law mooney-rivlin --law yeoh --law ogden:2 --output fit.json --material material.yaml
hpcinv fit foam.csv --law neo-hookean --compressible --sd '2 %' --sd '0.5 kPa'
hpcinv fit machine.txt --mode uniaxial --area '25 mm^2' --length '20 mm' --cycle 3 --law yeoh
hpcinv fit skin.csv --mode uniaxial --law '{law: yeoh, kappa: incompressible}'

A file has columns named with their units, such as
  # mode: uniaxial
  stretch [-], nominal stress [MPa]
  1.10, 0.12
Modes are uniaxial, equibiaxial, planar (pure shear), simple-shear and volumetric."""


def add_fit(commands: Any) -> None:
    fit = add_command(
        commands, "fit", "Fit parameters of material laws to tests.", examples=_EXAMPLES, page="how-to/fit.md"
    )
    fit.add_argument("tests", type=Path, nargs="+", metavar="FILE", help="table of measured points (.csv, .txt, .xlsx)")
    fit.add_argument(
        "--law",
        action="append",
        required=True,
        help="law to fit, NAME, NAME:TERMS or a mapping as in a job, or 'all' isotropic ones; several are compared",
    )
    fit.add_argument("--mode", help="kind of test of files that do not state it")
    fit.add_argument("--area", help="undeformed cross-section, for columns of force, such as '25 mm^2'")
    fit.add_argument("--length", help="gauge length, for columns of elongation, such as '20 mm'")
    fit.add_argument(
        "--column",
        action="append",
        default=[],
        metavar="TITLE=NAME",
        help="name of a column by its title in the file, such as 'Spannung=nominal stress [MPa]', or 'TITLE=ignore'",
    )
    fit.add_argument("--cycle", type=positive, metavar="N", help="take the loading branch of cycle N of each test")
    fit.add_argument("--sheet", metavar="NAME", help="sheet of workbooks (.xlsx); by default the first")
    fit.add_argument(
        "--decimal-comma", action="store_true", help="commas within entries are decimal, where commas delimit entries"
    )
    fit.add_argument("--fix", action="append", default=[], metavar="NAME=VALUE", help="keep a parameter at this value")
    fit.add_argument(
        "--compressible", action="store_true", help="fit the bulk modulus, too; otherwise it is infinite, unless fixed"
    )
    fit.add_argument(
        "--sd",
        action="append",
        default=[],
        help="standard deviation of the measured stress, such as '2 kPa' or '3 %%'; both are added as squares",
    )
    fit.add_argument("--largest-stretch", type=float, metavar="STRETCH", help="leave out points of larger stretch")
    fit.add_argument("--plot", type=Path, metavar="FILE", help="plot of tests and laws (.png, .pdf, .svg)")
    fit.add_argument("--material", type=Path, metavar="FILE", help="sections of a job for the best law (.yaml)")
    fit.add_argument("--output", type=Path, metavar="FILE", help="write all figures (.json, .yaml)")
    add_option(fit)
    fit.set_defaults(command=_fit)


def _check_outputs(options: argparse.Namespace) -> None:
    for path, endings in ((options.material, (".yaml", ".yml")), (options.output, (".json", ".yaml", ".yml"))):
        if path is not None and path.suffix not in endings:
            raise OutputError(f"{path}: must end in {' or '.join(endings)}")
    for path in (options.plot, options.material, options.output):
        if path is not None:
            check_directory_of(path)


def _fit(options: argparse.Namespace) -> int:
    from hpcinv.studies.fitting.fit_plot import check_format, plot
    from hpcinv.studies.fitting.fit_report import CheckedFit, describe
    from hpcinv.studies.fitting.least_squares import FitError, fit

    if options.plot is not None:
        check_format(options.plot)
    _check_outputs(options)
    fixed = _fixed(options.fix)
    candidates = _candidates(options, fixed)
    _check_fixed(fixed, candidates)
    tests = _tests(options)
    outcomes: list[CheckedFit] = []
    failures: list[str] = []
    for law in candidates:
        try:
            outcomes.append(CheckedFit.check(fit(law, tests)))
        except FitError as error:
            failures.append(str(error))
    if not outcomes:
        raise JobError(*failures)
    for test in tests:
        if test.rest_count:
            print(f"{test.name}: points without strain left out, where every law gives 0: {test.rest_count}")
    for outcome in outcomes:
        print("\n".join(describe(outcome)))
    if len(outcomes) > 1:
        _show_ranking(outcomes)
    best = min(outcomes, key=lambda outcome: outcome.fit.aicc)
    print(f"\n{best.as_yaml()}", end="", flush=True)
    _write(options, outcomes, best)
    if options.plot is not None:
        plot(options.plot, outcomes)
    for text in chain(failures, *(outcome.warnings() for outcome in outcomes)):
        print(f"warning: {text}", file=sys.stderr)
    return 0


def _candidates(options: argparse.Namespace, fixed: dict[str, str]) -> list[Candidate]:
    from hpcinv.physics.materials import laws
    from hpcinv.studies.fitting.candidate import candidate

    named = [text for text in dict.fromkeys(options.law) if text != "all"]
    candidates = [candidate(text, fixed, compressible=options.compressible) for text in named]
    for name in laws() if "all" in options.law else ():
        if name not in (*named, "formula"):
            with contextlib.suppress(JobError):  # with fibres, or compressible only
                candidates.append(candidate(name, fixed, compressible=options.compressible))
    return candidates


def _fixed(texts: list[str]) -> dict[str, str]:
    values = {}
    for text in texts:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals or not name or not value:
            raise JobError(f"--fix {text}: is written NAME=VALUE, such as --fix 'kappa=2 GPa'")
        values[name] = value
    return values


def _check_fixed(fixed: dict[str, str], candidates: list[Candidate]) -> None:
    from hpcinv.base.quantity.suggestions import did_you_mean

    known = [name for c in candidates for name in (*type(c.law).model_fields, *c.data.get("parameters", ()))]
    for name in fixed:
        if name.partition("[")[0] not in known:
            raise JobError(f"--fix {name}: none of the laws has this parameter.{did_you_mean(name, known)}")


def _tests(options: argparse.Namespace) -> list[Test]:
    from hpcinv.studies.fitting.measurements import mode_named, read_file, set_deviations

    if options.mode is not None:
        try:
            mode_named(options.mode)
        except ValueError as error:
            raise JobError(f"--mode: {error}") from None
    test_options = _test_options(options)
    problems: list[str] = []
    tests: list[Test] = []
    for path in options.tests:
        try:
            file = read_file(path, test_options)
            tests += file.tests
            print("\n".join(file.notes), flush=True)
        except JobError as error:
            problems += error.problems
    if problems:
        raise JobError(*problems)
    if options.largest_stretch is not None:
        tests = [test.up_to(options.largest_stretch) for test in tests]
    tests = [test.deformed() for test in tests]
    if empty := [test.name for test in tests if not len(test)]:
        raise JobError(f"{empty[0]}: no points with strain are left")
    return set_deviations(tests, options.sd)


def _test_options(options: argparse.Namespace) -> FileOptions:
    from hpcinv.base.quantity.quantity import Quantity
    from hpcinv.studies.fitting.measurements import FileOptions

    sizes = {}
    for name, unit in (("area", "m^2"), ("length", "m")):
        text = getattr(options, name)
        try:
            sizes[name] = None if text is None else Quantity(unit, above=0.0).parse(text)
        except ValueError as error:
            raise JobError(f"--{name}: {error}") from None
    columns = {}
    for text in options.column:
        title, equals, name = (part.strip() for part in text.rpartition("="))
        if not equals or not title or not name:
            raise JobError(f"--column {text}: is written TITLE=NAME, such as --column 'Spannung=nominal stress [MPa]'")
        columns[title] = name
    return FileOptions(
        mode=options.mode,
        columns=columns,
        cycle=options.cycle,
        sheet=options.sheet,
        decimal_comma=options.decimal_comma,
        **sizes,
    )


def _show_ranking(outcomes: list[CheckedFit]) -> None:
    from rich.table import Table

    from hpcinv.output.console import table_console
    from hpcinv.studies.fitting.fit_report import ranking

    scatter = "residual / its sd" if outcomes[0].fit.deviations_known else "residual"
    table = Table(
        *("law", "parameters", "R²", scatter, "AICc", "difference", "weight", "stable", "elliptic"),
        box=None,
        pad_edge=False,
    )
    for row in ranking(outcomes):
        table.add_row(*row)
    print()
    table_console().print(table)


def _write(options: argparse.Namespace, outcomes: list[CheckedFit], best: CheckedFit) -> None:
    import yaml

    from hpcinv.base.files.atomic import write_output
    from hpcinv.base.files.json_data import json_data

    if options.material is not None:
        write_output(options.material, best.as_yaml().encode())
    if options.output is not None:
        data = json_data({"best": best.label, "laws": [outcome.as_data() for outcome in outcomes]})
        text = json.dumps(data, indent=1) if options.output.suffix == ".json" else yaml.safe_dump(data, sort_keys=False)
        write_output(options.output, text.encode())
