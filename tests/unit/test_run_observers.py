"""Checkpoint writer and run report, with stand-ins for model, store and solutions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import HpcinvError, Interrupted, OutputError, SolveError, SystemPartMissing
from hpcinv.model.outcome import Outcome
from hpcinv.output import checkpoint_writer, run_report
from hpcinv.output.checkpoint_writer import CheckpointWriter
from hpcinv.output.result import Result
from hpcinv.output.run_report import RunReport
from hpcinv.pages.reports import run_page
from hpcinv.solver.newton import Solve
from hpcinv.solver.observer import SolvedDirection, SolveEvent
from hpcinv.trust.certificate import Verdict

LINEAR: Any = SimpleNamespace()


def solve(load: float, outcome: Outcome = Outcome.CONVERGED, **more: Any) -> Solve:
    return Solve(load, outcome, (), 1, **more)


def event(load: float, *, can_restart: bool = True) -> SolveEvent:
    return SolveEvent(solve(load), (solve(load),), load, can_restart, 0.1, 0.9)


def ended(load: float, *solves: Solve, stopped: bool = False, can_restart: bool = True) -> SolvedDirection:
    return SolvedDirection("inverse", solves, load, LINEAR, stopped, can_restart, ("snes_view",))


# Checkpoints


class Written:
    """Stand-in for checkpoints: the positions and functions that were written."""

    def __init__(self, error: HpcinvError | None = None) -> None:
        self.positions: list[tuple[int, float, int]] = []
        self.functions: list[str] = []
        self.error = error

    def write(self, position: Any, functions: dict[str, Any]) -> None:
        if self.error is not None:
            raise self.error
        self.positions.append((position.direction_index, position.load, len(position.solves)))
        self.functions = [*functions]


def writer(
    written: Written | None,
    *,
    every: int,
    seconds: float = 0.0,
    here: bool = True,
    warn: Callable[[str], None] = lambda text: None,
) -> CheckpointWriter:
    def check_in_place() -> None:
        if not here:
            raise OutputError("it was removed")

    store: Any = SimpleNamespace(check_in_place=lambda: None, check_in_place_on_this_rank=check_in_place)
    model: Any = SimpleNamespace(
        job=SimpleNamespace(checkpoint=SimpleNamespace(every=every, seconds=seconds), directions=("inverse",)),
        body=SimpleNamespace(mesh=SimpleNamespace(comm=MPI.COMM_SELF)),
        timings=lambda phase: nullcontext(),
        state=lambda: SimpleNamespace(fields=("u", None)),
        slip_histories=lambda direction, load: (),
    )
    checkpoints: Any = written
    observer = CheckpointWriter(checkpoints, store, model, warn)
    observer.begun("inverse", LINEAR)
    return observer


def test_a_run_goes_on_without_checkpoints_where_they_cannot_be_written() -> None:
    warnings = list[str]()
    observer = writer(
        Written(SystemPartMissing("adios2 cannot be imported", "Install it.")), every=1, warn=warnings.append
    )
    for load in (0.5, 1.0):
        observer.solved(event(load))
    assert warnings == ["no checkpoints: adios2 cannot be imported\n  Install it."]
    assert not observer.can_save


def test_a_checkpoint_is_written_after_so_many_accepted_steps() -> None:
    written = Written()
    observer = writer(written, every=2)
    for load, can_restart in ((0.25, True), (0.5, False), (0.5, True), (0.75, True), (1.0, True)):
        observer.solved(event(load, can_restart=can_restart))
    assert written.positions == [(0, 0.5, 1), (0, 1.0, 1)]


def test_a_checkpoint_is_written_only_after_enough_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SimpleNamespace(monotonic=lambda: clock.now, now=0.0)
    monkeypatch.setattr(checkpoint_writer, "time", clock)
    written = Written()
    observer = writer(written, every=1, seconds=10.0)
    for now, load in ((9.0, 0.25), (11.0, 0.5), (20.0, 0.75), (21.5, 1.0)):
        clock.now = now
        observer.solved(event(load))
    assert written.positions == [(0, 0.5, 1), (0, 1.0, 1)]


@pytest.mark.parametrize(
    ("every", "load", "stopped", "expected"),
    [(0, 0.5, True, True), (0, 0.5, False, False), (9, 0.5, False, True), (9, 1.0, False, False), (9, 1.0, True, True)],
)
def test_the_last_state_is_written_when_a_run_ends_early(
    every: int, load: float, stopped: bool, expected: bool
) -> None:
    written = Written()
    observer = writer(written, every=every)
    observer.ended(ended(0.0, stopped=True))
    assert not written.positions, "without a step there is nothing to save"
    observer.solved(event(load))
    observer.ended(ended(load, stopped=stopped))
    assert bool(written.positions) == expected


def test_a_checkpoint_of_the_second_direction_has_the_solution_of_the_first() -> None:
    written = Written()
    observer = writer(written, every=1)
    first: Any = SimpleNamespace(solves=(solve(1.0),), fields=("u", "p"), contacts=())
    observer.finished(first)
    observer.solved(event(0.5))
    assert written.positions == [(1, 0.5, 2)]
    assert written.functions == ["displacement-0", "pressure-0", "displacement-1"]


def test_a_checkpoint_that_cannot_be_written_is_explained_by_a_removed_directory() -> None:
    error = OutputError("it cannot be written")
    with pytest.raises(OutputError, match="it cannot be written"):
        writer(Written(error), every=1).solved(event(0.5))
    with pytest.raises(OutputError, match="it was removed"):
        writer(Written(error), every=1, here=False).solved(event(0.5))
    writer(None, every=1).solved(event(0.5))  # nothing is to be written


# Report


@pytest.fixture
def report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[RunReport, dict[str, Any]]]:
    """Makes a report, and what it gives to summary and progress."""

    def make(
        *, directory: bool = True, directions: int = 1, report_fails: bool = False
    ) -> tuple[RunReport, dict[str, Any]]:
        given: dict[str, Any] = {"warnings": []}

        def statistics(result: Any, status: str, _size: int, unused: Any, *_: Any, advice: str) -> dict[str, Any]:
            given.update(result=result, status=status, unused=list(unused), advice=advice)
            return {"status": status}

        monkeypatch.setattr(run_report, "statistics", statistics)
        given["files"] = []

        def write_summary(_path: Path, content: dict[str, Any], *_: Any, formats: Sequence[str]) -> None:
            given.update(written=content)
            given["files"] += formats

        def write_run_report(_path: Path, _found: dict[str, Any]) -> None:
            given["files"].append("report")
            if report_fails:
                raise OutputError("the report cannot be written")

        monkeypatch.setattr(run_report, "write_summary", write_summary)
        monkeypatch.setattr(run_page, "write_run_report", write_run_report)
        job = SimpleNamespace(
            solver=SimpleNamespace(patience=500),
            directions=("inverse", "forward")[:directions],
            accuracy={},
            quantities=(),
            output=SimpleNamespace(
                unit_warnings=True, summary=("json", "h5"), fields=False, has_surface=False, report=True
            ),
        )
        unknowns = SimpleNamespace(size=12)
        model: Any = SimpleNamespace(job=job, body=None, unknowns=unknowns, timings=None)
        path = tmp_path if directory else None
        written: dict[str, Any] = {"unwritten": [], "shape_files": {}}
        store: Any = SimpleNamespace(path=path, comm=MPI.COMM_SELF, check_in_place=lambda: None, **written)
        progress: Any = SimpleNamespace(
            warn=given["warnings"].append, finish=lambda content: given.update(printed=content["status"])
        )
        totals: Any = SimpleNamespace(
            warnings=(), warned=lambda size, nominal: SimpleNamespace(warnings=(f"moves {size} m",))
        )
        return RunReport(job, model, store, progress, totals, None, ()), given

    return make


def solution(load: float, *solves: Solve) -> Any:
    return SimpleNamespace(direction="inverse", load=load, solves=solves, largest_displacement=1e-9, state="")


type MakeReport = Callable[..., tuple[RunReport, dict[str, Any]]]


def test_a_converged_run_is_written_printed_and_warned_about(report: MakeReport) -> None:
    run_report, given = report()
    run_report.check_reached([solution(1.0, solve(1.0))])
    run_report.check_not_stopped([], ended(1.0, solve(1.0), stopped=True), "")  # the request came after the last solve
    run_report.ended(ended(1.0, solve(1.0)))
    certificate: Any = SimpleNamespace(lines=())
    result = Result(run_report.job, run_report.equations.body, (solution(1.0, solve(1.0)),), certificate, {"tip": 0.5})
    concluded = run_report.conclude(result)
    assert (given["status"], given["printed"], given["written"]) == ("converged", "converged", concluded.statistics)
    assert given["warnings"] == ["moves 1e-09 m"]
    assert given["unused"] == ["snes_view"]
    assert concluded.quantities == {"tip": 0.5}


@pytest.mark.parametrize("report_fails", [False, True])
def test_the_summary_that_marks_completion_is_the_last_file(report_fails: bool, report: MakeReport) -> None:
    run_report, given = report(report_fails=report_fails)
    certificate: Any = SimpleNamespace(lines=())
    result = Result(run_report.job, run_report.equations.body, (solution(1.0, solve(1.0)),), certificate)
    with pytest.raises(OutputError, match="report") if report_fails else nullcontext():
        run_report.conclude(result)
    assert given["files"] == ["h5", "report", "json"]


def test_a_load_that_is_not_reached_is_a_solve_error_with_a_summary(report: MakeReport) -> None:
    run_report, given = report()
    with pytest.raises(SolveError, match=r"stopped at load factor 0\.25 of 1: "):
        run_report.check_reached([solution(0.25, solve(0.25), solve(0.5, Outcome.ITERATION_LIMIT))])
    [line] = given["result"].certificate.lines
    assert (line.name, line.value, line.verdict) == ("load factor", 0.25, Verdict.FAIL)
    assert given["written"] == {"status": given["status"], "unwritten": [], "shape_files": {}}
    assert "solver.maximum_iterations" in given["advice"]
    run_report, given = report()
    fixed_point = solve(1.0, Outcome.FIXED_POINT_LIMIT, position_residual=0.125)
    with pytest.raises(SolveError, match=r"stopped 0\.125 m from the given shape: the fixed-point method"):
        run_report.check_reached([solution(0.0, fixed_point)])
    [line] = given["result"].certificate.lines
    assert (line.name, line.value) == ("position residual", 0.125)


@pytest.mark.parametrize(("before", "can_restart", "saved"), [(0, True, True), (0, False, False), (1, False, True)])
def test_a_stopped_run_says_whether_it_can_be_resumed(
    before: int, can_restart: bool, saved: bool, report: MakeReport
) -> None:
    run_report, given = report(directions=2)
    with pytest.raises(Interrupted) as caught:
        run_report.check_not_stopped([solution(1.0)] * before, ended(0.5, stopped=True, can_restart=can_restart), "")
    assert "stopped by a signal in the inverse solve at load factor 0.5" in caught.value.message
    assert ("is saved" in caught.value.message) == saved
    assert caught.value.advice.startswith("Go on with" if saved else "Start it again with")
    assert given["status"] == "stopped by a signal"
    assert len(given["result"].solutions) == before


def test_a_stopped_run_without_a_directory_saves_nothing(report: MakeReport) -> None:
    run_report, given = report(directory=False)
    with pytest.raises(Interrupted, match="nothing was saved"):
        run_report.check_not_stopped([], ended(0.5, stopped=True), "")
    assert "written" not in given
