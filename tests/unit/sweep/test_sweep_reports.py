"""Reports of a sweep: its outlook, status, table and diagrams, from invented records."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import pytest
import yaml
from helpers.ledger_files import damage
from helpers.sweep_report_cases import DENSITY, MU, NO_EQUILIBRIUM, bad, good, plan
from helpers.sweeps import BLOCK, finish
from rich.console import Console

from hpcinv.__main__ import main
from hpcinv.errors import OutputError
from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.ledger.holder import Holder
from hpcinv.studies.batch.ledger.ledger import Ledger, ledger_of
from hpcinv.studies.batch.status import Status, follow, lines
from hpcinv.studies.batch.tables import as_csv, in_written_units
from hpcinv.studies.sweep.outlook import outlook
from hpcinv.studies.sweep.results import finished, outcomes, provenance, results, status_of
from hpcinv.studies.sweep.shape_spread import kept_file
from hpcinv.studies.sweep.sweep_batch import open_damaged
from hpcinv.studies.sweep.sweep_plan import Case, SweepPlan
from hpcinv.studies.sweep.table import SweepTable


def look(sweep_plan: SweepPlan) -> Status:
    ledger = ledger_of(sweep_plan.store)
    return status_of(sweep_plan, ledger, outcomes(sweep_plan, ledger))


@pytest.fixture
def commit(tmp_path: Path) -> Iterator[Callable[[Case, CaseRecord], None]]:
    """Put a record in the store, as a process does that has solved a case."""
    with Holder(tmp_path / "store") as holder:
        ledger = Ledger(tmp_path / "store", holder)
        yield lambda case, record: finish(ledger, case.key, record)


# Statistics


def test_statistics_of_each_branch_leave_out_what_failed(
    tmp_path: Path, commit: Callable[[Case, CaseRecord], None], capsys: pytest.CaptureFixture[str]
) -> None:
    law = {"law": "neo-hookean", "lam": "40 kPa"}
    values = {"soft": [1.0, 2.0, 6.0], "hard": [5.0]}
    branches = {
        label: {"set": {"material": law}, "axes": [{"grid": {MU: [5e3 * (10 * i + n) for n in range(4)]}}]}
        for i, label in enumerate(values, start=1)
    }
    sweep_plan = plan(tmp_path, {"name": "kind", "branches": branches})
    for label, tops in values.items():
        cases = [case for case in sweep_plan.cases if case.parameters["kind"] == label]
        for case, top in zip(cases, tops, strict=False):
            commit(case, good(quantities={"top": top, "where": [top, 0.0, -top]}))
        commit(cases[-1], bad())
    assert main(["sweep", "statistics", str(sweep_plan.path)]) == 0
    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    assert [(row["kind"], row["quantity"]) for row in rows][:5] == [
        ("soft", "top"),
        ("soft", "where[0]"),
        ("soft", "where[1]"),
        ("soft", "where[2]"),
        ("hard", "top"),
    ]
    soft, hard = rows[0], rows[4]
    assert (soft["cases"], soft["unit"], soft["minimum"], soft["maximum"]) == ("3", "m", "1.0", "6.0")
    assert float(soft["mean"]) == 3.0
    assert float(soft["sd"]) == pytest.approx(math.sqrt(7.0))  # ((1-3)² + (2-3)² + (6-3)²) / 2
    assert float(soft["sd of mean"]) == pytest.approx(math.sqrt(7 / 3))
    assert float(soft["median"]) == 2.0
    assert float(soft["95 %"]) == pytest.approx(2 + 0.9 * 4)
    assert (hard["cases"], hard["sd"], float(hard["mean"])) == ("1", "", 5.0)


# Outlook


def test_the_outlook_prints_cases_sizes_and_time(tmp_path: Path, commit: Callable[[Case, CaseRecord], None]) -> None:
    """Quadratic displacements on n × n × n cubes of 6 tetrahedra have 3 (2n + 1)³ unknowns."""
    sizes = {f"mesh.parameters.n{axis}": [1, 2] for axis in "xyz"}
    sweep_plan = plan(tmp_path, {"zip": sizes}, {"grid": {MU: ["10 kPa", 1e4, 2e4]}})
    text = outlook(sweep_plan, ledger_of(sweep_plan.store), 1)
    assert text[0] == f"sweep: 6 cases; 0 finished in {tmp_path / 'store'}"
    assert "4 of them are different" in text[1]
    assert text[3].endswith(": 6 cells, 81 unknowns")
    assert text[4].endswith(": 48 cells, 375 unknowns")
    assert all("    2 cases such as case" in line for line in text[3:5])
    assert "time: not known, since no case is finished; run some first: 'sweep run --first" in text[5]

    commit(sweep_plan.cases[2], good(8.0))
    # One more like it takes 8 s, and two of the others as much more as they have more unknowns.
    expected = (8 + 2 * 8 * 375 / 81) / 2
    assert (
        f"time: about {expected:.0f} s for 3 cases on 2 groups of ranks side by side, with 2 ranks a case"
        in (outlook(sweep_plan, ledger_of(sweep_plan.store), 2)[-1])
    )


def test_a_mesh_that_cannot_be_made_is_reported_in_the_outlook(tmp_path: Path) -> None:
    (tmp_path / "broken.py").write_text("def build(gmsh):\n    raise RuntimeError('no such shape')\n")
    meshes = [BLOCK["mesh"], {"file": "broken.py"}]
    sweep_plan = plan(tmp_path, {"grid": {"mesh": meshes}})
    text = outlook(sweep_plan, ledger_of(sweep_plan.store), 1)
    assert text[2].endswith(": 48 cells, 375 unknowns")
    assert "no such shape" in text[3]


# Status


def test_the_status_counts_cases_by_where_they_stand(
    tmp_path: Path, commit: Callable[[Case, CaseRecord], None]
) -> None:
    sweep_plan = plan(tmp_path, {"grid": {MU: ["10 kPa", 1e4, 2e4, 3e4, 4e4, 5e4, 6e4, 7e4]}})
    empty = look(sweep_plan)
    assert (empty.done, empty.open, empty.total, empty.seconds, empty.unfinished) == (0, 7, 7, None, 7)
    assert "time left: not known before the first of the cases is finished" in lines(empty)[-1]

    for number, record in {0: good(2.0), 2: good(4.0), 3: bad(seconds=3.0), 4: bad("too slow"), 5: bad()}.items():
        commit(sweep_plan.cases[number], record)
    with Holder(tmp_path / "store") as holder:
        assert Ledger(tmp_path / "store", holder).claim(sweep_plan.cases[6].key)
        now = look(sweep_plan)
        who = str(holder.identity)
    assert (now.converged, now.open, now.done, now.total) == (2, 1, 5, 7)
    assert now.failed == {NO_EQUILIBRIUM: ("case 3, mu 30000", "case 5, mu 50000"), "too slow": ("case 4, mu 40000",)}
    assert now.running == {who: 1}
    assert now.seconds == 2 * 2.0  # two are left, one of them running; the median of 2, 4, 3, 1 and 1 s
    assert lines(now) == [
        "sweep: 5 of 7 cases finished (8 rows)",
        "  converged: 2",
        "    2 × certificate pass",
        "  failed: 3; 'sweep retry --failed' opens them again",
        "    2 × no equilibrium; the first: case 3, mu 30000",
        "    1 × too slow; the first: case 4, mu 40000",
        "  running: 1",
        f"    1 by {who}",
        "  open: 1",
        "  time left: about 4.0 s, with 1 case at a time",
    ]


@pytest.mark.parametrize("is_terminal", [True, False])
def test_a_sweep_is_followed_to_its_end(
    is_terminal: bool, tmp_path: Path, commit: Callable[[Case, CaseRecord], None]
) -> None:
    sweep_plan = plan(tmp_path, {"grid": {MU: [1e4, 2e4, 3e4]}})
    left = list(sweep_plan.cases)
    screen = Console(file=io.StringIO(), force_terminal=is_terminal, width=100)
    last = follow(lambda: look(sweep_plan), screen, sleep=lambda _: commit(left.pop(0), good()))
    assert last.unfinished == 0
    text = screen.file.getvalue()  # type: ignore[attr-defined]
    for n in range(4):
        assert f"sweep: {n} of 3 cases finished" in text
    assert ("━" in text) == is_terminal


# Table


def rich_plan(directory: Path) -> SweepPlan:
    laws = {
        "soft": {"set": {"sensitivities": {MU: 10}}, "axes": [{"grid": {MU: ["10 kPa", 2e4]}}]},
        "stiff": {"set": {"material": {"law": "yeoh", "c1": 1e5, "c2": 0, "c3": 0, "kappa": 1e6}}},
    }
    random = {DENSITY: {"normal": ["963 kg/m^3", "10 kg/m^3"]}}
    quantities = [*BLOCK["quantities"], {"name": "seconds", "of": "displacement", "at": [0, 0, 1]}]
    return plan(
        directory,
        {"branches": laws, "name": "law"},
        {"random": random, "count": 2},
        {"grid": {"method": ["direct"], "certificate": [{"overlap": False}]}},
        job=BLOCK | {"quantities": quantities},
    )


SENSITIVE: Mapping[str, Any] = {
    "parameters": {MU: {"value": 1e4, "sd": 10.0}},
    "quantities": {
        "top": {"slopes": {MU: 2e-5}, "sd": 2e-4},
        "seconds": {"slopes": {MU: [1.0, 2.0, 3.0]}, "sd": None},
    },
    "shape": {"largest": {MU: 1.0}, "sd": None, "sd_at": None},
}


def rich_results(sweep_plan: SweepPlan) -> dict[str, CaseRecord]:
    estimate = {"quantities": {"top": 1e-6, "seconds": [0.0, 1e-7, None]}, "shape": 1e-6}
    first = good(
        12.5,
        quantities={"top": -0.25, "seconds": [0.5, None, -0.25]},
        certificate={"verdict": "warning", "lines": [], "estimate": estimate},
        sensitivities=SENSITIVE,
    )
    return {
        sweep_plan.cases[0].key: CaseRecord(**(vars(first) | {"start": sweep_plan.cases[3].key})),
        sweep_plan.cases[3].key: bad(seconds=0.5),
        sweep_plan.cases[4].key: good(quantities={"top": -0.125}, sensitivities=None),
    }


def test_the_table_has_a_row_for_each_case_in_si(tmp_path: Path) -> None:
    sweep_plan = rich_plan(tmp_path)
    table = SweepTable(sweep_plan, rich_results(sweep_plan).items()).columns()
    assert {len(values) for values in table.values()} == {6}
    assert table["number"] == [0, 1, 2, 3, 4, 5]
    assert table["key"] == [case.key for case in sweep_plan.cases]
    assert table["law"] == ["soft"] * 4 + ["stiff"] * 2
    assert table[MU] == [1e4, 1e4, 2e4, 2e4, None, None]
    assert table[DENSITY] == [case.parameters[DENSITY] for case in sweep_plan.cases]
    assert table["method"] == ["direct"] * 6
    assert table["parameters.certificate"] == ["False"] * 6  # 'certificate' is the verdict
    assert table["status"] == ["converged", "open", "open", NO_EQUILIBRIUM, "converged", "open"]
    assert table["certificate"] == ["warning", "", "", "", "pass", ""]
    assert table["top"] == [-0.25, None, None, None, -0.125, None]
    assert table["top estimated error"] == [1e-6, None, None, None, None, None]
    assert table[f"top slope in {MU}"][0] == 2e-5
    assert table["top sd"][0] == 2e-4
    assert [table[f"seconds[{i}]"][0] for i in range(3)] == [0.5, None, -0.25]
    assert [table[f"seconds[{i}] estimated error"][0] for i in range(3)] == [0.0, 1e-7, None]
    assert [table[f"seconds[{i}] slope in {MU}"][0] for i in range(3)] == [1.0, 2.0, 3.0]
    assert "seconds[0] sd" not in table
    assert table["seconds"] == [12.5, None, None, 0.5, 1.0, None]  # what it took
    assert (table["factorizations"][0], table["newton_iterations"][0]) == (5, 12)
    assert (table["unknowns"][0], table["ranks"][0], table["peak_memory"][0]) == (375, 2, 300)
    assert (table["factorizations"][3], table["unknowns"][3], table["peak_memory"][3]) == (None, None, None)
    assert table["started_from"] == [sweep_plan.cases[3].key, "", "", "", "", ""]


def test_a_quantity_with_the_name_of_a_cost_is_a_column_of_its_own(tmp_path: Path) -> None:
    sweep_plan = plan(tmp_path, {"grid": {MU: [1e4]}})
    record = good(3.0, quantities={"seconds": 7.0, "status": 8.0})
    table = SweepTable(sweep_plan, [(sweep_plan.cases[0].key, record)]).columns()
    assert (table["seconds"], table["quantities.seconds"], table["quantities.status"]) == ([3.0], [7.0], [8.0])


def test_the_table_as_csv_and_hdf5_has_the_same_numbers(
    tmp_path: Path, commit: Callable[[Case, CaseRecord], None]
) -> None:
    sweep_plan = rich_plan(tmp_path)
    for case in sweep_plan.cases:
        if case.key in rich_results(sweep_plan):
            commit(case, rich_results(sweep_plan)[case.key])
    sweep_table = SweepTable(sweep_plan, finished(sweep_plan, ledger_of(sweep_plan.store)))
    table, known = sweep_table.columns(), sweep_table.units()
    given = SweepTable(sweep_plan, rich_results(sweep_plan).items()).columns()
    assert table == given | {"attempts": table["attempts"]}
    assert [*table] == [*given]
    headers = {f"{name} [{known[name]}]" if known.get(name) else name: name for name in table}
    assert {f"{MU} [Pa]", "top [m]", "seconds [s]", "status"} <= headers.keys()
    written = csv.DictReader(io.StringIO(as_csv(table, known)))
    rows = [{headers[header]: value for header, value in row.items()} for row in written]
    with h5py.File(io.BytesIO(sweep_table.as_hdf5(provenance(sweep_plan, ledger_of(sweep_plan.store))))) as file:
        frame = {name: data[()] for name, data in file["cases"].items()}
        message = {name: data.attrs["unit"] for name, data in file["cases"].items() if "unit" in data.attrs}
        origins = [json.loads(text) for text in file["provenance"].asstr()[()]]
    assert frame.keys() == table.keys() == rows[0].keys()
    for name, values in table.items():
        for value, row, kept in zip(values, rows, frame[name], strict=True):
            if value is None:
                assert row[name] == ""
                assert math.isnan(kept)
            elif isinstance(value, str):
                assert row[name] == kept.decode() == value
            else:
                assert float(row[name]) == kept == value
    assert message == {k: v for k, v in known.items() if k in table}
    assert message[MU] == "Pa"
    assert (message[DENSITY], message["top"], message["top sd"], message["seconds[1]"]) == ("kg/m^3", "m", "m", "m")
    assert (message[f"top slope in {MU}"], message["seconds"], message["peak_memory"]) == ("m/Pa", "s", "B")
    assert [part.get("machine") for part in origins] == [{"ranks": 2}, None, None, None, {"ranks": 2}, None]


def test_tables_have_the_units_of_the_screen() -> None:
    """One unit for all columns of a kind: of the job, or with the prefix of the largest number."""
    columns = {
        "V": [1e-6, None, 2e-6],
        "V estimated error": [3e-12, 0.0, math.nan],
        "p": [2e3, 1.0, 0.0],
        "n": [1, 2, 3],
    }
    units = {"V": "m^3", "V estimated error": "m^3", "p": "Pa"}
    table, written = in_written_units(columns, units, {"Pa": "MPa"})
    assert written == {"V": "ml", "V estimated error": "ml", "p": "MPa"}
    assert (table["V"], table["p"], table["n"]) == ([1.0, None, 2.0], [2e-3, 1e-6, 0.0], [1, 2, 3])
    assert table["V estimated error"][:2] == [3e-6, 0.0]


# Commands


def test_the_commands_write_what_they_are_asked_for(
    tmp_path: Path, commit: Callable[[Case, CaseRecord], None], capsys: pytest.CaptureFixture[str]
) -> None:
    sweep_plan = plan(tmp_path, {"grid": {MU: ["10.1 kPa", "20 kPa"]}})
    for case, value in zip(sweep_plan.cases, (0.5, 0.75), strict=True):
        commit(case, good(quantities={"top": value}))
    assert results(sweep_plan, ledger_of(sweep_plan.store)).keys() == {case.key for case in sweep_plan.cases}
    sweep = str(sweep_plan.path)
    assert main(["sweep", "status", sweep]) == 0
    assert "2 of 2 cases finished" in capsys.readouterr().out
    assert main(["sweep", "table", sweep]) == 0
    rows = [*csv.DictReader(io.StringIO(capsys.readouterr().out))]
    assert [row["top [mm]"] for row in rows] == ["500.0", "750.0"]  # as a run prints it
    assert [row[f"{MU} [kPa]"] for row in rows] == ["10.1", "20.0"]  # as the job writes it
    for name in ("deep/table.csv", "deep/table.h5"):
        assert main(["sweep", "table", sweep, "--output", str(tmp_path / name)]) == 0
        assert (tmp_path / name).stat().st_size > 0
    assert main(["sweep", "plot", sweep, "top", "--over", MU, "--output", str(tmp_path / "top.over.mu")]) == 0
    assert capsys.readouterr().out.splitlines() == [str(tmp_path / f"top.over.mu.{form}") for form in ("png", "svg")]
    assert (tmp_path / "top.over.mu.svg").is_file()
    assert main(["sweep", "table", sweep, "--output", "/proc/none/table.csv"]) == 2
    assert "/proc/none/table.csv: cannot be written" in capsys.readouterr().err


def test_a_look_makes_no_store(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sweep_plan = plan(tmp_path, {"grid": {MU: [1e4]}})
    assert main(["sweep", "status", str(sweep_plan.path)]) == 0
    assert main(["sweep", "table", str(sweep_plan.path)]) == 0
    assert "open" in capsys.readouterr().out
    assert not sweep_plan.store.exists()
    assert yaml.safe_load(sweep_plan.path.read_text())["store"] == "store"


@pytest.mark.parametrize(
    "command", [["status"], ["table"], ["statistics"], ["plan"], ["retry", "--failed"], ["indices"]]
)
def test_a_store_of_another_format_is_refused_by_all_commands(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sweep_plan = plan(tmp_path, {"grid": {MU: [1e4]}})
    sweep_plan.store.mkdir()
    (sweep_plan.store / "store.json").write_text('{"format": "hpcinv store 99"}')
    assert main(["sweep", command[0], str(sweep_plan.path), *command[1:]]) == 2
    assert capsys.readouterr().err.count("store.json: the format is hpcinv store 99, not hpcinv store 2") == 1
    assert [path.name for path in sweep_plan.store.iterdir()] == ["store.json"]


def test_damaged_records_are_reported_and_nothing_is_written(
    tmp_path: Path, commit: Callable[[Case, CaseRecord], None], capsys: pytest.CaptureFixture[str]
) -> None:
    sweep_plan = plan(tmp_path, {"grid": {MU: [1e4, 2e4, 3e4]}})
    for case in sweep_plan.cases:
        commit(case, good())
    for case in sweep_plan.cases[:2]:
        damage(sweep_plan.store, case.key)
    before = sorted(sweep_plan.store.rglob("*"))
    assert main(["sweep", "status", str(sweep_plan.path)]) == 0
    shown = capsys.readouterr().out
    assert (
        "open: 2\n    2 × record damaged, or a file of the mesh has changed: the next start solves the case again"
        in shown
    )
    assert main(["sweep", "retry", "--failed", str(sweep_plan.path)]) == 0
    capsys.readouterr()
    assert main(["sweep", "table", str(sweep_plan.path)]) == 0
    table = capsys.readouterr()
    assert len(table.out.splitlines()) == 4
    assert table.err.count("left out 2 × record damaged") == 1
    assert sorted(sweep_plan.store.rglob("*")) == before
    assert open_damaged(sweep_plan) == 2
    assert status_of(sweep_plan, ledger_of(sweep_plan.store), {}).damaged == 0


def test_texts_that_spreadsheets_take_as_formulas_are_escaped() -> None:
    texts = ["=HYPERLINK(1)", "@SUM(1)", "+cmd|' /C calc'!A0", "-x", "\t=1", "rigid", "-9.81 m/s^2", "+5e-3"]
    rows = list(csv.reader(io.StringIO(as_csv({"=branch": texts, "p": [-1.5] * 8}, {"=branch": "m"}))))
    assert rows[0] == ["'=branch [m]", "p"]
    assert [row[0] for row in rows[1:]] == [*(f"'{text}" for text in texts[:5]), *texts[5:]]
    assert {row[1] for row in rows[1:]} == {"-1.5"}


def test_a_name_with_a_line_of_its_own_gets_into_no_batch_script() -> None:
    from hpcinv.cli.sweep_submit import filled
    from hpcinv.studies.sweep.templates import TEMPLATES

    with pytest.raises(OutputError, match="cannot be in a batch script"):
        filled(TEMPLATES / "collect.sbatch", ["output=a\ntouch marker/collect-%j.out"], ["sweep.yaml"])


def test_a_file_of_a_case_is_the_one_of_its_latest_run(tmp_path: Path) -> None:
    for run in ("run-2-1", "run-10-1", "run-10-2"):
        (tmp_path / run).mkdir()
    for run in ("run-2-1", "run-10-1"):
        (tmp_path / run / "report.html").touch()
    assert kept_file(tmp_path, "report.html") == tmp_path / "run-10-1" / "report.html"
    assert kept_file(tmp_path, "other.html") is None
