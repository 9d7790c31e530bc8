"""Studies: what is made of numbers, checked by hand, and a real one through the real command line, also interrupted."""

from __future__ import annotations

import csv
import itertools
import re
import signal
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from random import Random
from typing import Any

import h5py
import matplotlib.image
import numpy as np
import pytest
import yaml
from helpers.command_line import COLUMN, NO_CERTIFICATE, ROOT, Started, hpcinv, hpcinv_here
from helpers.mesh_data_files import write_msh
from helpers.studies import STUDY, plan

import hpcinv as api
from hpcinv.__main__ import main
from hpcinv.batch.ledger.case_record import CaseRecord
from hpcinv.batch.ledger.holder import Holder
from hpcinv.batch.ledger.ledger import Ledger
from hpcinv.batch.task import Pause
from hpcinv.errors import JobError, OutputError, SolveError
from hpcinv.job.fingerprint import content_key
from hpcinv.job.job import parse
from hpcinv.output.progress import SilentProgress
from hpcinv.parallel.jit import JIT_OPTIONS
from hpcinv.parallel.runtime import MPI
from hpcinv.study.convergence import fitted_order, orders, richardson
from hpcinv.study.directory import STORE, StudyDirectory
from hpcinv.study.findings import accuracy, front
from hpcinv.study.result_rows import rows_of
from hpcinv.study.study_batch import StudyRunner, StudySchedule, StudyTask
from hpcinv.study.study_plan import StudyPlan
from hpcinv.study.study_report import not_refined
from hpcinv.study.study_run import conclude
from hpcinv.study.work_precision import work_precision

# Numbers


def test_the_front_is_what_no_other_point_beats() -> None:
    points = [(1.0, 9.0), (2.0, 5.0), (2.0, 6.0), (3.0, 5.0), (4.0, 1.0), (None, 0.1), (0.5, None), (4.0, 1.0)]
    assert front(points) == [True, True, False, False, True, False, False, True]


@pytest.mark.parametrize("sizes", [(0.4, 0.2, 0.1), (0.5, 0.3, 0.22)])
@pytest.mark.parametrize("order", [0.8, 1.7, 4.0])
def test_richardson_finds_limit_and_order_on_meshes_of_any_sizes(sizes: tuple[float, ...], order: float) -> None:
    limit, observed_order = richardson(sizes, [2.0 - 3.0 * h**order for h in sizes])
    assert limit == pytest.approx(2.0, abs=1e-10)
    assert observed_order == pytest.approx(order, abs=1e-9)


@pytest.mark.parametrize(
    ("values", "why"),
    [
        ((1.0, 1.2, 1.1), "are not monotone"),
        ((1.0, 1.1, 1.1), "are not monotone"),
        ((1.0, 1.1, 1.2), "do not come closer"),
        ((1.0, 1.1, 1.3), "do not come closer"),
        ((1.0, 1.1, 1.1 + 1e-16), "are not monotone"),
        ((0.0, 1.0, 1.0 + 2e-16), "have converged too far"),
    ],
)
def test_richardson_refuses_values_that_do_not_converge(values: tuple[float, ...], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        richardson((0.4, 0.2, 0.1), values)


def test_orders_are_slopes_between_runs_and_through_all() -> None:
    sizes, errors = [0.4, 0.2, 0.1, 0.05], [0.16, 0.02, None, 0.0]
    assert orders(sizes, errors) == [None, pytest.approx(3.0), None, None]
    assert fitted_order([0.4, 0.2, 0.1], [5 * h**2.5 for h in (0.4, 0.2, 0.1)]) == pytest.approx(2.5)
    # ln e = 0, 2, 1 at ln h = 0, 1, 2: covariance 1 over variance 2.
    assert fitted_order(np.exp([0, 1, 2]), np.exp([0, 2, 1])) == pytest.approx(0.5)
    assert fitted_order([0.1, 0.1], [1.0, 2.0]) is None


# What is next, and what is made of it, with made-up records


def statistics(
    value: float, total: float = 1.0, compile_: float = 0.0, unknowns: int = 10, **more: Any
) -> dict[str, Any]:
    phases = {"compile": compile_, "newton": 0.1, "tangent": 0.2, "certificate": 0.05}
    return {
        "quantities": {"length": value},
        "mesh": {"unknowns": unknowns, "cells": unknowns},
        "solutions": [{"factorizations": 2, "newton_iterations": 3}],
        "timings": {"total": total, "phases": {k: {"min": 0.0, "max": v} for k, v in phases.items()}},
        "peak_memory": {"ranks": [100, 200], "phases": {}},
        **more,
    }


def good(value: float, compiled: bool = False, **more: Any) -> CaseRecord:
    return CaseRecord("converged", "", statistics(value, **more), 1.0, 1, compiled=compiled)


BAD = CaseRecord("stopped at load factor 0.5 of 1", "Try again.", {}, 1.0, 1)

type Begin = Callable[..., StudySchedule]


@pytest.fixture
def begin() -> Iterator[Begin]:
    """Begins a study in a directory, as a process does on one rank or more; the holders live as long as the test."""
    with ExitStack() as held:

        def schedule(plan: StudyPlan, directory: Path, ranks: int = 1) -> StudySchedule:
            store = StudyDirectory(directory / "out", plan.study.study).path / STORE
            return StudySchedule(plan, Ledger(store, held.enter_context(Holder(store))), 0.0, ranks)

        yield schedule


def drain(schedule: StudySchedule, records: Iterator[CaseRecord]) -> list[StudyTask]:
    tasks = []
    while isinstance(task := schedule.next(), StudyTask):
        tasks.append(task)
        assert schedule.executions.ledger.commit(task.claim, next(records))
    return tasks


def records_in(directory: Path) -> list[Path]:
    """The files of finished executions."""
    return sorted(directory.glob("store/ledger/*/[!.]*.record-*.json"))


def reused(schedule: StudySchedule) -> int:
    return schedule.executions.count()[0]


def titles(tasks: list[StudyTask]) -> list[str]:
    return [task.title for task in tasks]


def test_repetitions_take_turns(begin: Begin, tmp_path: Path) -> None:
    tasks = drain(begin(plan(tmp_path, repeat=2), tmp_path), itertools.repeat(good(1.0)))
    assert titles(tasks) == ["P2, 1", "P2, 2", "P2, 4", "P3, 1", "P3, 2"] * 2
    assert [(task.number, task.total) for task in tasks] == [(n, 10) for n in range(1, 11)]


def test_a_run_that_compiled_is_done_once_more_and_one_that_failed_is_not(begin: Begin, tmp_path: Path) -> None:
    records = iter([good(1.0, compiled=True), BAD, *[good(1.0)] * 20])
    tasks = drain(begin(plan(tmp_path, repeat=2), tmp_path), records)
    assert titles(tasks) == ["P2, 1", "P2, 2", "P2, 4", "P3, 1", "P3, 2", "P2, 1", "P2, 4", "P3, 1", "P3, 2", "P2, 1"]
    # However often kernels seem to be compiled, it ends.
    again = drain(begin(plan(tmp_path, repeat=1), tmp_path / "b"), itertools.repeat(good(1.0, compiled=True)))
    assert len(again) == 10


def test_only_kernels_that_were_not_found_count_as_compiled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, comm: MPI.Intracomm
) -> None:
    """Other processes that a run starts do not, such as the one that tries to read a mesh file first."""
    monkeypatch.setitem(JIT_OPTIONS, "cache_dir", tmp_path / "kernels")
    mesh = {"file": str(write_msh(tmp_path / "block.msh", ROOT / "meshes", False, 1, 4.1))}
    given = {k: v for k, v in COLUMN.items() if k != "quantities"} | {"mesh": mesh, "certificate": NO_CERTIFICATE}
    given |= {"discretisation": {"displacement": 1}, "supports": [{"region": "z0", "fix": ["x", "y", "z"]}]}
    column_job = parse(given, tmp_path / "column.yaml")
    claim: Any = None
    task = StudyTask("one", column_job, claim, 1, 1)
    with StudyRunner(comm) as runner, SilentProgress(comm) as progress:
        compiled = [runner.run(task, progress, lambda: False)["compiled"] for _ in range(2)]
    assert compiled == [True, False]


def test_changed_study_solves_only_its_new_runs(begin: Begin, tmp_path: Path) -> None:
    first = begin(plan(tmp_path, repeat=2), tmp_path)
    for _ in range(7):
        task = first.next()
        assert isinstance(task, StudyTask)
        assert first.executions.ledger.commit(task.claim, good(1.0))
    second = begin(plan(tmp_path, repeat=2), tmp_path)
    assert reused(second) == 7
    assert titles(drain(second, itertools.repeat(good(1.0)))) == ["P2, 4", "P3, 1", "P3, 2"]
    assert begin(plan(tmp_path, repeat=2), tmp_path).next() is None
    # Equal runs are one, whatever their series are called.
    series = [STUDY["series"][0] | {"name": "other"}, {"name": "P2", "vary": {"mesh.parameters.nz": [2, 3, 4]}}]
    third = begin(plan(tmp_path, repeat=2, series=series), tmp_path)
    assert titles(drain(third, itertools.repeat(good(1.0)))) == ["P2, 3"] * 2
    # On another number of ranks times are others.
    assert reused(begin(plan(tmp_path, repeat=2), tmp_path, ranks=2)) == 0


def test_a_damaged_record_is_done_again(begin: Begin, tmp_path: Path) -> None:
    drain(begin(plan(tmp_path, repeat=2), tmp_path), itertools.repeat(good(1.0)))
    damaged, *others = records_in(tmp_path / "out")
    damaged.write_bytes(damaged.read_bytes()[:50])
    damaged.with_name(f".{damaged.name}.0a1b.partial").write_text("{")
    assert len(drain(begin(plan(tmp_path, repeat=2), tmp_path), itertools.repeat(good(1.0)))) == 1
    again = damaged.with_name(damaged.name.replace("record-1", "record-2"))
    assert records_in(tmp_path / "out") == sorted([damaged, again, *others])
    assert begin(plan(tmp_path, repeat=2), tmp_path).next() is None


def test_two_schedules_share_the_runs_and_each_waits_for_the_other(begin: Begin, tmp_path: Path) -> None:
    study = plan(tmp_path, repeat=2, series=[{"name": "P2", "vary": {"mesh.parameters.nz": [1, 2]}}])
    here, there = begin(study, tmp_path), begin(study, tmp_path)
    mine, other = here.next(), there.next()
    assert isinstance(mine, StudyTask)
    assert isinstance(other, StudyTask)
    assert titles([mine, other]) == ["P2, 1", "P2, 2"]
    assert here.executions.ledger.commit(mine.claim, good(1.0))
    # The second execution of the run whose first one the other has in hand is not begun before that is over.
    second = here.next()
    assert isinstance(second, StudyTask)
    assert titles([second]) == ["P2, 1"]
    assert here.executions.ledger.commit(second.claim, good(1.0))
    assert here.next() is Pause.WAIT
    assert there.executions.ledger.commit(other.claim, BAD)
    assert here.next() is None
    assert there.next() is None
    assert [row.status for row in rows_of(here.executions)] == ["converged", BAD.status]
    assert rows_of(here.executions) == rows_of(there.executions)


def test_runs_that_failed_are_tried_again_if_that_is_asked_for(begin: Begin, tmp_path: Path) -> None:
    study = plan(tmp_path, repeat=1)
    drain(begin(study, tmp_path), iter([BAD, good(1.0), BAD, good(1.0), good(1.0)]))
    assert begin(study, tmp_path).next() is None
    assert begin(study, tmp_path).executions.retry() == 2
    assert titles(drain(begin(study, tmp_path), itertools.repeat(good(1.0)))) == ["P2, 1", "P2, 4"]


def test_the_status_of_a_study_counts_its_executions(
    begin: Begin, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    taken = {"series": "P2", "key": "errors.gap", "at_least": 1e-11}
    series = [
        {"name": "P2", "vary": {"mesh.parameters.nz": [1, 2, 4]}},
        {"name": "P3", "take": {"solver.tolerance": taken}, "vary": {"mesh.parameters.nz": [1, 2, 4]}},
    ]
    study = plan(tmp_path, repeat=2, series=series)
    schedule = begin(study, tmp_path, ranks=2)
    StudyDirectory(tmp_path / "out", study.study.study).set_ranks(2)
    for record in (good(1.0, compiled=True), BAD):
        task = schedule.next()
        assert isinstance(task, StudyTask)
        assert schedule.executions.ledger.commit(task.claim, record)
    assert isinstance(schedule.next(), StudyTask)
    who = str(schedule.executions.ledger.holder.identity)
    command = ["study", "status", str(study.path), "--output", str(tmp_path / "out")]
    assert main(command) == 0
    # P2 needs 3 executions of its first run, which compiled kernels, 1 of the second, which failed, and 2 of the third.
    # The first two runs of P3 cannot begin without the numbers that they take; the third one needs 2 executions.
    assert capsys.readouterr().out.splitlines() == [
        f"{study.study.study}: 2 of 8 executions finished",
        "  converged: 1",
        "    1 × certificate not known",
        "  failed: 1; 'study --retry-failed' opens them again",
        f"    1 × {BAD.status}; the first: P2, 2",
        "  running: 1",
        f"    1 by {who}",
        "  open: 5",
        "  time left: about 6.0 s, with 1 execution at a time",
    ]
    assert main([*command, "--ranks", "1"]) == 0
    assert "0 of 12 executions finished" in capsys.readouterr().out
    with pytest.raises(SystemExit, match="2"):
        main([*command, "--retry-failed"])


def test_options_may_come_before_the_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["--output", str(tmp_path), str(tmp_path / "missing.yaml")]
    assert main(["study", "status", *command]) == 2
    for words in (command, ["run", *command], [command[-1], "--output", "run"]):
        with pytest.raises(SystemExit, match="2"):  # all ranks end with this code
            main(["study", *words])
    assert capsys.readouterr().err.count("no such file") == 4


def test_a_directory_of_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(OutputError, match="holds files that are not of a study"):
        StudyDirectory(tmp_path, "column")
    StudyDirectory(tmp_path / "out", "column")
    with pytest.raises(OutputError, match="holds the study 'column'"):
        StudyDirectory(tmp_path / "out", "beam")
    (begun := tmp_path / "begun").mkdir()
    (begun / ".study.json.0123456789abcdef.partial").touch()  # another allocation is about to make it
    StudyDirectory(begun, "column")


def test_the_hash_follows_what_result_and_time_depend_on(tmp_path: Path) -> None:
    mesh = tmp_path / "box.py"
    mesh.write_bytes(Path(COLUMN["mesh"]["file"]).read_bytes())

    def key(ranks: int = 1, **changes: Any) -> str:
        data = COLUMN | {"mesh": COLUMN["mesh"] | {"file": "box.py"}} | changes
        return content_key(parse(data, tmp_path / "job.yaml"), ranks=ranks)

    same = [key(), key(job="other"), key(output={"fields": False}), key(checkpoint={"every": 3}, method="direct")]
    assert len(set(same)) == 1
    other = [
        key(ranks=2),
        key(solver={"tolerance": 1e-3}),
        key(method="sellier"),
        key(discretisation={"quadrature": 3}),
        key(quantities=[]),
        key(material={"law": "neo-hookean", "mu": 2, "lam": 3}),
        key(expected_shape={"file": "box.py"}),
    ]
    mesh.write_text(mesh.read_text() + "\n# changed\n")
    assert len({same[0], *other, key()}) == len(other) + 2


def test_values_are_taken_from_the_same_case_of_an_earlier_series(begin: Begin, tmp_path: Path) -> None:
    taken = {"series": "direct", "key": "errors.gap", "at_least": 1e-11}
    series = [{"name": "direct"}, {"name": "to its accuracy", "take": {"solver.tolerance": taken}}]
    cases = [{"grid": {"material.mu": [1e4, 2e4, 3e4, 4e4]}}]
    schedule = begin(plan(tmp_path, series=series, cases=cases, repeat=1), tmp_path)
    outcomes = {1e4: good(1.0, errors={"gap": 1e-5}), 2e4: good(1.0, errors={"gap": 0.0}), 3e4: BAD, 4e4: good(1.0)}
    tolerances = []
    while isinstance(task := schedule.next(), StudyTask):
        waits = not task.title.startswith("direct")
        tolerances += [task.job.solver.tolerance] if waits else []
        (law,) = task.job.laws.values()
        record = good(1.0) if waits else outcomes[law.mu]  # type: ignore[attr-defined]
        assert schedule.executions.ledger.commit(task.claim, record)
    assert tolerances == [1e-5, 1e-11]
    assert reused(begin(schedule.executions.plan, tmp_path)) == 6
    why = [row.status for row in rows_of(schedule.executions) if row.place.series != "direct"]
    assert why[:2] == ["converged", "converged"]
    assert why[2] == "not run: solver.tolerance is taken from series 'direct', which has failed"
    assert why[3].endswith("has no number at errors.gap")


def rows_and_accuracy(begin: Begin, plan: StudyPlan, directory: Path, records: list[CaseRecord]) -> Any:
    schedule = begin(plan, directory)
    drain(schedule, iter(records))
    rows = rows_of(schedule.executions)
    return rows, accuracy(plan, rows, plan.study.measure[0], "m")


def test_costs_are_medians_without_compilation_and_certificate(begin: Begin, tmp_path: Path) -> None:
    study = plan(tmp_path, series=[{"name": "P2"}], costs={"gap": "errors.gap"}, time="solver")
    more = {"compile_": 0.5, "errors": {"gap": 4.0}}
    records = [good(1.0, compiled=True, total=90.0, **more), *(good(1.0, total=t, **more) for t in (3.0, 9.0, 2.0))]
    [row], _ = rows_and_accuracy(begin, study, tmp_path, records)
    assert row.costs["run"] == pytest.approx(3.0 - 0.5 - 0.05)
    assert row.costs["solver"] == row.time == pytest.approx(0.3)
    assert (row.costs["gap"], row.costs["memory"], row.costs["factorizations"]) == (4.0, 200.0, 2.0)
    assert len(row.times) == 3


def test_statistics_over_cases_and_the_ratio_of_times(begin: Begin, tmp_path: Path) -> None:
    series = [{"name": "base"}, {"name": "other", "base": "base", "set": {"discretisation.displacement": 3}}]
    cases = [{"grid": {"material.mu": [1, 2, 3, 4]}}]
    study = plan(tmp_path, series=series, cases=cases, repeat=1, reference=10)
    records = [
        record
        for e, t in ((1.0, 2.0), (2.0, 3.0), (3.0, 5.0), (6.0, 7.0))
        for record in (good(10 - e, total=1.05), BAD if e == 3.0 else good(10 + 2 * e, total=t + 0.05))
    ]
    _, accuracies = rows_and_accuracy(begin, study, tmp_path, records)
    base, other = accuracies.points
    assert base.errors == pytest.approx((1, 2, 3, 6))
    names = ("average", "minimum", "maximum", "failed")
    assert [base.statistics[name] for name in names] == pytest.approx([3.0, 1.0, 6.0, 0])
    assert base.statistics["sd"] == pytest.approx((14 / 3) ** 0.5)  # 4 + 1 + 0 + 9, over n - 1
    assert (other.average, other.statistics["failed"]) == pytest.approx((6.0, 1))
    assert base.statistics["ratio"] is None
    assert other.statistics["ratio"] == pytest.approx((2 + 3 + 7) / 3)
    assert [point.is_on_front for point in accuracies.points] == [True, False]


def test_errors_against_the_finest_run_and_richardsons_limit(begin: Begin, tmp_path: Path) -> None:
    def values(order: float) -> list[CaseRecord]:
        cells = {"P2": (1, 2, 4), "P3": (1, 2)}
        sizes = [(1 / n, n) for ns in cells.values() for n in ns]
        return [good(5 + h**order, unknowns=n, total=n) for h, n in sizes]

    study = plan(tmp_path, repeat=1, reference="finest")
    rows, accuracies = rows_and_accuracy(begin, study, tmp_path, values(2.0))
    assert [row.size for row in rows] == [1, 0.5, 0.25, 1, 0.5]
    assert accuracies.errors == pytest.approx((1 - 0.0625, 0.25 - 0.0625, None, 1 - 0.0625, 0.25 - 0.0625))
    assert accuracies.references[0].origin == "finest run: P2, 4"

    study = plan(tmp_path, repeat=1, reference="richardson")
    _, accuracies = rows_and_accuracy(begin, study, tmp_path, [])
    assert accuracies.references[0].value == pytest.approx(5.0, abs=1e-12)
    assert accuracies.errors == pytest.approx((1, 0.25, 0.0625, 1, 0.25))
    assert accuracies.orders == pytest.approx((None, 2, 2, None, 2))
    assert accuracies.fitted == pytest.approx({"P2": 2, "P3": 2})

    with pytest.raises(JobError, match=r"reference\.all: richardson needs a series with 3 meshes; take finest or a"):
        plan(tmp_path, repeat=1, reference={"richardson": "P3"})


def test_no_order_is_given_where_more_than_the_mesh_varies(begin: Begin, tmp_path: Path) -> None:
    vary = {"mesh.parameters.nz": [1, 2, 4], "discretisation.displacement": [1, 2, 3]}
    series = [{"name": "all", "vary": vary}]
    with pytest.raises(JobError, match=r"reference\.all: richardson needs a series along which nothing but the mesh"):
        plan(tmp_path, repeat=1, series=series, reference="richardson")
    rows, _ = rows_and_accuracy(
        begin, plan(tmp_path, repeat=1, series=series), tmp_path, [good(v) for v in (1.0, 1.5, 1.75)]
    )
    assert [row.size for row in rows] == [None] * 3
    # Parameters that do not keep their proportion: the number of cells decides.
    vary = {"mesh.parameters.nz": [1, 2, 4], "mesh.parameters.nx": [1, 1, 2]}
    study = plan(tmp_path, repeat=1, series=[{"name": "all", "vary": vary}])
    rows, _ = rows_and_accuracy(begin, study, tmp_path / "b", [good(1.0, unknowns=n) for n in (1, 8, 64)])
    assert [row.size for row in rows] == pytest.approx([1, 0.5, 0.25])


def test_a_series_of_meshes_that_does_not_refine_is_reported(begin: Begin, tmp_path: Path) -> None:
    def message(*cells: int) -> list[str]:
        directory = tmp_path / "-".join(map(str, cells))
        directory.mkdir()
        records = [good(1.0 + 1 / n, unknowns=n, total=float(i)) for i, n in enumerate(cells)]
        rows, _ = rows_and_accuracy(begin, plan(directory, repeat=1, series=series), directory, records)
        assert [row.costs["cells"] for row in rows] == list(cells)
        return list(not_refined(rows))

    series = [{"name": "sizes", "vary": {"mesh.parameters.nz": [1, 2, 4, 8]}}]
    assert message(1000, 2000, 3000, 4000) == []
    (line,) = message(2001, 2365, 1439, 3788)
    assert "'sizes' do not become finer (2,001, 2,365, 1,439, 3,788 cells)" in line


def test_effectivity_is_the_estimated_over_the_true_error(begin: Begin, tmp_path: Path) -> None:
    study = plan(tmp_path, repeat=1, series=[{"name": "P2"}], reference=2.0, time="certified")
    estimate = {"estimate": {"quantities": {"length": 0.4}, "geometry": "left out"}}
    [row], accuracies = rows_and_accuracy(
        begin, study, tmp_path, [good(1.5, total=3.0, compile_=0.5, certificate=estimate)]
    )
    assert accuracies.effectivities == pytest.approx((0.8,))
    assert "1 of 1 runs, whose meshes differ in geometry" in accuracies.geometry_note([row])
    assert (accuracies.points[0].average, accuracies.points[0].promised) == (0.5, 0.4)
    assert row.time == row.costs["certified"] == pytest.approx(3.0 - 0.5)
    assert row.costs["run"] == pytest.approx(3.0 - 0.5 - 0.05)
    drawn = work_precision(study.study, accuracies, "seconds", {"P2": ""})["svg"]
    assert b'id="estimates-0"' in drawn
    assert b"dotted: as estimated by the certificate" in drawn


def test_a_study_ends_in_an_error_where_nothing_converged_or_nothing_can_be_compared(
    begin: Begin, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def ended(directory: Path, records: list[CaseRecord], **changes: Any) -> None:
        schedule = begin(plan(tmp_path, repeat=1, **changes), tmp_path / directory)
        drain(schedule, iter(records))
        conclude(schedule.executions, StudyDirectory(tmp_path / directory / "out", "study"))

    with pytest.raises(SolveError, match="not one of the 5 runs converged; the first: stopped at load"):
        ended(Path("a"), [BAD] * 5)
    assert "failed: P3, 2: stopped at load factor 0.5 of 1" in capsys.readouterr().out
    with pytest.raises(
        JobError, match=r"reference.length: richardson: the values of series 'P2', 1, 3, 2, are not mono"
    ):
        ended(
            Path("b"),
            [good(v, unknowns=n) for n, v in enumerate((1.0, 3.0, 2.0, 1.0, 1.0))][:5],
            reference={"richardson": "P2"},
        )
    headers = (tmp_path / "b" / "out" / "table.csv").read_text().splitlines()[0].split(",")
    assert {"time [s]", "memory [B]"} <= set(headers), "the values are worth having all the same"
    with pytest.raises(JobError, match=r"measure: the summary has no number at solutions\[0\].strain"):
        ended(Path("c"), [good(1.0)] * 5, measure=["length", "solutions[0].strain"], reference={"all": 0})


def test_published_numbers_are_printed_next_to_ours(
    begin: Begin, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    beside = {
        "source": "someone (1999)",
        "values": {"length": {"measured": "2.5 m"}},
        "statistics": {"length": {"all": {"average": 4.49e-12, "failed": 7}}},
    }
    study = plan(tmp_path, repeat=1, series=[{"name": "all"}], beside=beside, reference=2)
    schedule = begin(study, tmp_path)
    drain(schedule, iter([good(1.0)]))
    conclude(schedule.executions, StudyDirectory(tmp_path / "out", "study"))
    shown = capsys.readouterr().out
    assert "published: measured 2.5 m, +25.00% from the reference here" in shown
    assert "published numbers: someone (1999)" in shown
    cases = [{"grid": {"material.mu": [1, 2]}}]
    study = plan(tmp_path, repeat=1, series=[{"name": "all"}], beside=beside, reference=2, cases=cases)
    schedule = begin(study, tmp_path / "b")
    drain(schedule, iter([good(1.0), good(1.5)]))
    conclude(schedule.executions, StudyDirectory(tmp_path / "b" / "out", "study"))
    shown = capsys.readouterr().out
    ours, theirs = (line.split() for line in shown.splitlines() if line.startswith("all") or " published " in line)
    assert ours[1:5] == ["7.50e-01", "3.54e-01", "5.00e-01", "1.00e+00"]
    assert theirs[:3] == ["published", "4.49e-12", "-"]
    assert theirs[-1] == "7"
    table = list(csv.DictReader((tmp_path / "b" / "out" / "length-statistics.csv").open()))
    assert table[0]["published average [m]"] == "4.49e-12"
    assert (tmp_path / "b" / "out" / "length.svg").exists()


# From the command line

CLOSED_FORM = 1.0802798795986
NZ = (1, 2, 4)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with a study, one of whose runs cannot be solved."""
    place = tmp_path_factory.mktemp("study")
    (place / "column.yaml").write_text(yaml.safe_dump(COLUMN | {"certificate": NO_CERTIFICATE}))
    series = [
        {"name": "P2", "vary": {"mesh.parameters.nz": [*NZ]}},
        {
            "name": "one iteration",
            "set": {"solver": {"strategy": "fixed", "steps": 1, "maximum_iterations": 1}},
            "vary": {"mesh.parameters.nz": [2]},
        },
        {"name": "tolerance", "set": {"mesh.parameters.nz": 4}, "vary": {"solver.tolerance": [1e-1, 1e-3]}},
    ]
    study = STUDY | {"series": series, "reference": f"{CLOSED_FORM} m", "repeat": 2}
    (place / "column-study.yaml").write_text(yaml.safe_dump(study, sort_keys=False))
    # Many quick repetitions, for those who interrupt.
    study |= {"series": [series[0] | {"vary": {"mesh.parameters.nz": [1, 2]}}], "repeat": 6}
    (place / "long.yaml").write_text(yaml.safe_dump(study, sort_keys=False))
    return place


@pytest.fixture(scope="module")
def results(place: Path) -> Path:
    """The results of the study, on two ranks."""
    done = hpcinv(2, "study", "column-study.yaml", cwd=place)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.startswith("column-study: 6 runs, 2 ranks; results in results/column-study\n")
    assert "failed: one iteration, 2: stopped at load factor 0 of 1: Newton's method took too many" in done.stdout
    assert "Traceback" not in done.stderr
    return place / "results" / "column-study"


@pytest.fixture(scope="module")
def table(results: Path) -> list[dict[str, str]]:
    rows = csv.DictReader((results / "table.csv").open())
    return [{header.partition(" [")[0]: value for header, value in row.items()} for row in rows]


def test_the_table_has_every_run_with_its_value_error_and_cost(table: list[dict[str, str]]) -> None:
    assert [(r["series"], r["label"]) for r in table] == [
        *(("P2", str(n)) for n in NZ),
        ("one iteration", "2"),
        ("tolerance", "0.1"),
        ("tolerance", "0.001"),
    ]
    failed, solved = table[3], table[:3] + table[4:]
    assert failed["status"].startswith("stopped at load factor 0 of 1")
    assert failed["length"] == failed["length error"] == failed["time"] == ""
    for row, n in zip(solved, (*NZ, 4, 4), strict=True):
        # The same job, run by itself on one rank.
        job = COLUMN | {"certificate": NO_CERTIFICATE, "solver": {"tolerance": float(row["solver.tolerance"] or 1e-12)}}
        job["mesh"] = COLUMN["mesh"] | {"parameters": COLUMN["mesh"]["parameters"] | {"nz": n}}
        alone = api.run(parse(job, Path("job.yaml")), MPI.COMM_SELF)
        assert float(row["length"]) == pytest.approx(alone.quantities["length"], rel=1e-12)
        assert float(row["length error"]) == pytest.approx(abs(alone.quantities["length"] - CLOSED_FORM), rel=1e-5)
        assert float(row["unknowns"]) == 3 * 3 * 3 * (2 * n + 1)
        assert float(row["cells"]) == 6 * n
        assert float(row["factorizations"]) == alone.solutions[0].factorizations
        assert (row["repetitions"], row["certificate"]) == ("2", alone.certificate.verdict.value)
        assert 0 < float(row["time_min"]) <= float(row["time"]) <= float(row["time_max"])
        assert float(row["solver"]) < float(row["run"]) == float(row["time"])
        assert 5e7 < float(row["memory"]) < 2e9
    errors = [float(r["length error"]) for r in solved[:3]]
    assert errors[0] > errors[1] > errors[2]
    for i, row in enumerate(solved[1:3], start=1):
        assert float(row["length order"]) == pytest.approx(np.log2(errors[i - 1] / errors[i]), rel=1e-9)
    points = [(float(r["time"]), float(r["length error"])) for r in solved]
    best = [not any(t <= time and e <= error and (t, e) != (time, error) for t, e in points) for time, error in points]
    assert [r["length on Pareto front"] == "True" for r in solved] == best


def test_hdf5_holds_the_same_and_every_time(results: Path, table: list[dict[str, str]]) -> None:
    with h5py.File(results / "table.h5") as file:
        assert (file.attrs["study"], file.attrs["ranks"]) == ("column-study", 2)
        runs = file["runs"]
        assert list(runs["series"].asstr()[:]) == [r["series"] for r in table]
        for name in ("length", "length error", "time", "unknowns"):
            expected = [float(r[name] or "nan") for r in table]
            np.testing.assert_array_equal(runs[name][:], expected)
        assert (runs["length"].attrs["unit"], runs["time"].attrs["unit"]) == ("m", "s")
        times = file["times"][:]
        assert times.shape == (6, 2)
        kept = [i for i in range(6) if i != 3]
        assert np.isnan(times[3]).all()
        np.testing.assert_array_equal(np.median(times[kept], axis=1), runs["time"][kept])
        assert file["quantities/length/reference"][0] == CLOSED_FORM
        assert file["quantities/length/reference"].attrs["origin"] == "closed form"
        assert file["quantities/length/orders"].attrs["P2"] > 1.0


def test_diagrams_show_every_series_and_the_front(results: Path, table: list[dict[str, str]]) -> None:
    image = matplotlib.image.imread(results / "length.png")
    assert image.shape[0] > 700
    assert image.shape[1] > 1000
    assert np.ptp(image[..., :3]) > 0.9, "it is not blank"
    svg = ET.parse(results / "length.svg").getroot()
    groups = {g.get("id"): g for g in svg.iter("{http://www.w3.org/2000/svg}g")}
    assert {"front", "series-0", "series-2"} <= groups.keys()
    path = groups["series-0"].find("{http://www.w3.org/2000/svg}path")
    assert path is not None
    assert path.get("d", "").count("L") == len(NZ) - 1
    texts = {"".join(t.itertext()).strip() for t in svg.iter("{http://www.w3.org/2000/svg}text")}
    assert {"P2 (nz)", "tolerance (tolerance)", "Pareto front", "0.001", "error of length / m"} <= texts
    assert any(
        text.startswith("time / s (whole run without compilation and certificate, 2 ranks, median of 2)")
        for text in texts
    )


def test_the_same_command_again_does_nothing_twice(results: Path, place: Path) -> None:
    before = {p: (p.stat().st_mtime_ns, p.read_bytes()) for p in records_in(results)}
    done = hpcinv(2, "study", "column-study.yaml", cwd=place)
    assert done.returncode == 0, done.stderr
    assert f"{len(before)} executions were done before" in done.stdout
    assert "[" not in done.stdout.partition("length (m)")[0]
    assert {p: (p.stat().st_mtime_ns, p.read_bytes()) for p in records_in(results)} == before


def test_quantities_of_all_states_are_measured(tmp_path: Path) -> None:
    """A column that stands as given, and hangs: each length converges, as its estimate says."""
    weight = COLUMN["effects"][0]
    states = [
        {"name": "standing", "given": True, "effects": [weight]},
        {"name": "hanging", "effects": [weight | {"acceleration": [0, 0, 9.81]}]},
    ]
    column = {key: value for key, value in COLUMN.items() if key not in ("analysis", "effects", "quantities")}
    column |= {"states": states, "certificate": NO_CERTIFICATE | {"estimate": True}}
    column["mesh"] = COLUMN["mesh"] | {"geometry_degree": 2}  # carries all nodes of the displacement
    column["quantities"] = [
        {"name": "rest", "of": "Z", "at": [0.1, 0.1, 1.0]},
        {"name": "top", "of": "z", "at": [0.1, 0.1, 1.0], "state": "hanging"},
    ]
    (tmp_path / "column.yaml").write_text(yaml.safe_dump(column))
    study = STUDY | {
        "series": [{"name": "P2", "vary": {"mesh.parameters.nz": [1, 2, 4]}}],
        "measure": ["rest-standing", "rest-hanging", "top"],
        "reference": {"rest-standing": f"{CLOSED_FORM} m", "rest-hanging": f"{CLOSED_FORM} m", "top": "richardson"},
        "repeat": 1,
    }
    (tmp_path / "states.yaml").write_text(yaml.safe_dump(study, sort_keys=False))
    done = hpcinv_here("study", "states.yaml", cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    rows = list(csv.DictReader((tmp_path / "results" / "states" / "table.csv").open()))
    table = [{header.partition(" [")[0]: value for header, value in row.items()} for row in rows]
    assert len(table) == 3
    assert {row["certificate"] for row in table} <= {"pass", "warn"}
    for name in study["measure"]:
        errors = [float(row[f"{name} error"]) for row in table]
        assert errors[2] < errors[1] / 3 < errors[0] / 9, name
        assert 0.3 < float(table[1][f"{name} effectivity"]) < 3, name
    wrong = study | {"measure": ["rest"]}
    (tmp_path / "wrong.yaml").write_text(yaml.safe_dump(wrong | {"reference": "finest"}))
    refused = hpcinv_here("study", "wrong.yaml", cwd=tmp_path)
    assert refused.returncode == 2
    assert "no quantity of interest 'rest'" in refused.stderr
    assert "rest-hanging, rest-standing, " in refused.stderr


def kept(directory: Path) -> dict[Path, tuple[int, bytes]]:
    return {p: (p.stat().st_mtime_ns, p.read_bytes()) for p in records_in(directory)}


def test_stopped_by_a_signal_and_killed_it_goes_on_and_does_nothing_twice(place: Path) -> None:
    with Started(1, "study", "long.yaml", "--output", "long", cwd=place) as started:
        started.wait_for("\n[3/")
        started.send(signal.SIGTERM, started.ranks())
        assert started.exit_code() == 75, started.text
    assert "The same command continues." in started.text
    assert "Traceback" not in started.text
    stopped = kept(place / "long")
    assert 3 <= len(stopped) < 12
    assert f"{len(stopped)} of 1" in started.text
    assert not (place / "long" / "table.csv").exists()

    with Started(1, "study", "long.yaml", "--output", "long", cwd=place) as started:
        started.wait_for(f"[{len(stopped) + 2}/")
        started.kill()
    killed = kept(place / "long")
    assert len(stopped) + 2 <= len(killed) < 12
    assert f"{len(stopped)} executions were done before" in started.text

    done = hpcinv_here("study", "long.yaml", "--output", "long", cwd=place)
    assert done.returncode == 0, done.stderr
    assert f"{len(killed)} executions were done before" in done.stdout
    assert done.stdout.count("\n[") == len(kept(place / "long")) - len(killed)
    assert {p: entry for p, entry in kept(place / "long").items() if p in killed} == killed
    assert killed.items() >= stopped.items()
    assert all(CaseRecord.decoded(content).converged for _, content in kept(place / "long").values())
    with h5py.File(place / "long" / "table.h5") as file:
        assert file["times"].shape == (2, 6)


@pytest.mark.release
def test_killed_at_random_moments_it_repeats_nothing_that_was_committed(place: Path) -> None:
    """Kills fall into the start, a run, or a commit; each time all that was committed stays as it is."""
    random, before = Random(7), dict[Path, tuple[int, bytes]]()
    for _ in range(3):
        with Started(1, "study", "long.yaml", "--output", "killed", cwd=place) as started:
            started.wait_for("results in killed" if before else "\n[1/")  # all kernels are compiled then
            time.sleep(random.uniform(0.0, 3.0))
            started.kill()
        after = kept(place / "killed")
        assert after.items() >= before.items()
        before = after
    done = hpcinv(1, "study", "long.yaml", "--output", "killed", cwd=place)
    assert done.returncode == 0, done.stderr
    after = kept(place / "killed")
    assert after.items() >= before.items()
    assert done.stdout.count("\n[") == len(after) - len(before)
    assert all(CaseRecord.decoded(content).converged for _, content in after.values())
    assert (place / "killed" / "table.csv").exists()


def test_two_allocations_share_a_study_and_both_show_the_same_table(place: Path) -> None:
    command = ("study", "long.yaml", "--output", "shared")
    with Started(1, *command, cwd=place) as first, Started(1, *command, cwd=place) as other:
        while not list(place.glob("shared/store/ledger/*/[!.]*.claim-*")):
            assert first.mpirun.poll() is None, first.text
            time.sleep(0.01)
        first.send(signal.SIGSTOP, first.ranks())  # so that it is not done before the other begins
        other.wait_for("results in shared")
        time.sleep(1.0)
        first.send(signal.SIGCONT, first.ranks())
        assert first.exit_code() == 0, first.text
        assert other.exit_code() == 0, other.text
    texts = first.text, other.text
    executed = [re.findall(r"^\[\d+/\d+\] (.*): .* s", text, re.MULTILINE) for text in texts]
    assert all(executed), "each of them has had a share"
    assert sum(map(len, executed)) == len(kept(place / "shared"))
    assert "meanwhile" not in texts[0] + texts[1]
    tables = [text[text.index("\nlength (m)") :] for text in texts]
    assert tables[0] == tables[1]
    assert "P2" in tables[0]
    with h5py.File(place / "shared" / "table.h5") as file:
        assert np.isfinite(file["times"][:]).all()
        assert file["times"].shape == (2, 6)


def test_a_wrong_study_is_reported_once_and_leaves_nothing(place: Path) -> None:
    wrong = STUDY | {"series": [{"name": "P2", "vary": {"mesh.parameters.nz": [1, "x"]}}]}
    (place / "wrong.yaml").write_text(yaml.safe_dump(wrong))
    done = hpcinv_here("study", "wrong.yaml", cwd=place)
    assert done.returncode == 2
    assert done.stderr.count("wrong.yaml: P2, x: mesh.parameters.nz: 'x' is not a number") == 1
    assert not (place / "results" / "wrong").exists()
