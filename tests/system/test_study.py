"""Studies: schedules, records that are damaged, shared or tried again, and the hash of an execution."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import pytest
from helpers.command_line import COLUMN, NO_CERTIFICATE, ROOT
from helpers.ledger_files import committed, damage
from helpers.mesh_data_files import write_msh
from helpers.studies import STUDY, plan
from helpers.study_runs import BAD, Begin, drain, good, reused

from hpcinv.__main__ import main
from hpcinv.base.parallel.code_cache import kept_in
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import OutputError
from hpcinv.job.fingerprint import content_key
from hpcinv.job.job import parse
from hpcinv.output.progress import SilentProgress
from hpcinv.studies.batch.task import Pause
from hpcinv.studies.study.directory import StudyDirectory
from hpcinv.studies.study.result_rows import rows_of
from hpcinv.studies.study.study_run import StudyRunner, StudyTask


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


@pytest.mark.release
def test_only_kernels_that_were_not_found_count_as_compiled(tmp_path: Path, comm: MPI.Intracomm) -> None:
    """Other processes that a run starts do not, such as the one that tries to read a mesh file first."""
    mesh = {"file": str(write_msh(tmp_path / "block.msh", ROOT / "meshes", False, 1, 4.1))}
    given = {k: v for k, v in COLUMN.items() if k != "quantities"} | {"mesh": mesh, "certificate": NO_CERTIFICATE}
    given |= {"discretisation": {"displacement": 1}, "supports": [{"region": "z0", "fix": ["x", "y", "z"]}]}
    column_job = parse(given, tmp_path / "column.yaml")
    claim: Any = None
    task = StudyTask("one", column_job, claim, 1, 1)
    with StudyRunner(comm) as runner, SilentProgress(comm) as progress, kept_in(tmp_path / "cache"):
        compiled = [runner.run(task, progress, lambda: False)["compiled"] for _ in range(2)]
    assert compiled == [True, False]


@pytest.mark.release
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
    before = committed(tmp_path / "out" / "store")
    (key, _, _), *_ = before
    damage(tmp_path / "out" / "store", key)
    assert len(drain(begin(plan(tmp_path, repeat=2), tmp_path), itertools.repeat(good(1.0)))) == 1
    assert committed(tmp_path / "out" / "store").keys() == {*before, (key, 2, 1)}
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


def test_the_key_of_a_run_follows_all_inputs_of_result_and_time(tmp_path: Path) -> None:
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
