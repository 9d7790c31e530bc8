"""Directories of runs: what a kill at the start leaves is got over, and one run at a time is at work in them."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.command_line import BLOCK, CUBE, Started, hpcinv_here, write_job

from hpcinv.base.files import atomic, directory_lock
from hpcinv.base.files.directory_lock import DirectoryLock
from hpcinv.errors import CheckpointError, OutputError
from hpcinv.job.fingerprint import fingerprint
from hpcinv.job.job import Job, load
from hpcinv.output.run_directory import RunDirectory


@pytest.fixture
def job(tmp_path: Path) -> Job:
    return load(write_job(tmp_path / "cube.yaml", CUBE))


def created(path: Path, job: Job, *, overwrite: bool = False) -> RunDirectory:
    directory = RunDirectory(path)
    lock = directory.create(job, overwrite=overwrite)
    assert lock is not None
    lock.release()
    return directory


KILLED_BEFORE = """
import json, os, sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from helpers.ledger_worker import die_before_operation
from hpcinv.job.job import load
from hpcinv.output.run_directory import RunDirectory
statuses = {}
for operation in range(1, 30):
    child = os.fork()
    if child == 0:
        os.chdir(str(operation))
        job = load(Path("cube.yaml"))
        die_before_operation(operation, Path.cwd() / "run")
        RunDirectory(Path.cwd() / "run").create(job, overwrite=operation % 2 == 0)
        os._exit(0)
    statuses[operation] = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
print(json.dumps(statuses))
"""


@pytest.mark.release
def test_a_kill_before_any_file_operation_leaves_a_directory_that_can_be_started_again(tmp_path: Path) -> None:
    """As it is created, and as it replaces an earlier run with results and files of somebody else."""
    places = {operation: tmp_path / str(operation) for operation in range(1, 30)}
    for operation, place in places.items():
        place.mkdir()
        job = load(write_job(place / "cube.yaml", CUBE))
        if operation % 2 == 0:
            created(place / "run", job)
            (place / "run" / "summary.json").write_text('{"status": "converged"}')
            (place / "run" / "checkpoints" / "0001").mkdir(parents=True)
            (place / "run" / "letter.txt").write_text("dear all")
    # One process that forks, since each start of Python would take a second.
    command = [sys.executable, "-c", KILLED_BEFORE, str(Path(__file__).parents[1])]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    statuses = {int(operation): status for operation, status in json.loads(ended.stdout).items()}
    assert statuses.keys() == places.keys()
    assert set(statuses.values()) == {0, -signal.SIGKILL}, ended.stderr
    for operation, place in places.items():
        assert_can_be_started_again(place, replaced=operation % 2 == 0)


def assert_can_be_started_again(place: Path, *, replaced: bool) -> None:
    """Whatever a kill has left of the directory ``run`` of ``place``."""
    job, run = load(place / "cube.yaml"), place / "run"
    for name in ("origin.json", "job.yaml"):
        if (run / name).exists():
            assert (run / name).stat().st_size, f"{run / name} is empty"
    directory = RunDirectory(run)
    if directory.is_finished:  # nothing of the old run was removed yet
        assert directory.holds(job)
        assert (run / "checkpoints" / "0001").is_dir()
    if not directory.is_begun and (run / "origin.json").exists():
        with pytest.raises(
            OutputError, match=r"interrupted at its beginning(.|\n)*run cube\.yaml --output .* --overwrite"
        ):
            _in(place, lambda: directory.job(None))
        assert directory.job(job.path) == job
    directory = created(run, job, overwrite=(run / "origin.json").exists())
    assert directory.holds(job)
    assert not directory.is_finished
    assert not (run / "checkpoints").exists()
    assert (run / "letter.txt").exists() == replaced


def _in(directory: Path, action: object) -> None:
    before = Path.cwd()
    os.chdir(directory)
    try:
        action()  # type: ignore[operator]
    finally:
        os.chdir(before)


def test_a_directory_with_files_of_others_is_never_taken(job: Job, tmp_path: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    (run / "shape.msh").write_text("mine")
    for overwrite in (False, True):
        with pytest.raises(OutputError, match="files that are not of a run"):
            RunDirectory(run).create(job, overwrite=overwrite)
    assert (run / "shape.msh").read_text() == "mine"


@pytest.mark.parametrize("origin", ["", "{", "[]", '{"job": 3}'])
def test_an_origin_that_cannot_be_read_is_reported_and_can_be_overwritten(
    origin: str, job: Job, tmp_path: Path
) -> None:
    directory = created(tmp_path / "run", job)
    (directory.path / "origin.json").write_text(origin)
    if origin != '{"job": 3}':
        with pytest.raises(OutputError, match="interrupted at its beginning"):
            directory.job(None)
    assert directory.job(job.path) == job
    assert created(directory.path, job, overwrite=True).holds(job)


@pytest.mark.parametrize("locks", [True, False])
def test_a_directory_belongs_to_one_process_at_a_time(
    locks: bool, job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not locks:

        def no_locks(*_: object) -> None:
            raise OSError(95, "Operation not supported")

        monkeypatch.setattr(directory_lock.fcntl, "flock", no_locks)
    directory = created(tmp_path / "run", job)
    lock = directory.lock()
    assert lock is not None
    assert lock.is_in_place
    for refused in (directory.lock, lambda: directory.create(job, overwrite=True)):
        with pytest.raises(OutputError, match=f"this directory is in use by another run: process {os.getpid()} on"):
            refused()
    with pytest.raises(OutputError, match="then the same command goes on"):
        DirectoryLock(directory.path, "the same command goes on")
    assert directory.holds(job)
    lock.release()
    DirectoryLock(directory.path).release()
    assert {path.name for path in directory.path.iterdir()} == {"job.yaml", "origin.json"}


@pytest.mark.parametrize("locks", [True, False])
def test_the_lock_of_a_dead_process_does_not_last(
    locks: bool, job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    directory = created(tmp_path / "run", job)
    script = f"""
import os, signal
from pathlib import Path
from hpcinv.base.files import directory_lock
if not {locks}:
    def no_locks(*_):
        raise OSError(95, "Operation not supported")
    directory_lock.fcntl.flock = no_locks
directory_lock.DirectoryLock(Path({str(directory.path)!r}))
os.kill(os.getpid(), signal.SIGKILL)
"""
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == -signal.SIGKILL
    written = directory.path / ".lock"
    assert written.exists()
    if not locks:
        monkeypatch.setattr(directory_lock.fcntl, "flock", lambda *_: (_ for _ in ()).throw(OSError(95, "no")))
        content = json.loads(written.read_text())
        content["holder"]["machine"] = "another"
        alive = written.read_text()
        written.write_text(json.dumps(content))
        with pytest.raises(OutputError, match=r"cannot be checked from here, remove .*\.lock"):
            directory.lock()
        written.write_text(alive)
    lock = directory.lock()
    assert lock is not None
    lock.release()


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "file"
    atomic.replace(file, b"one")
    atomic.replace(file, b"two")
    assert file.read_bytes() == b"two"

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        atomic.replace(file, b"three")
    assert file.read_bytes() == b"two"
    assert list(tmp_path.iterdir()) == [file]


SLOW = {**CUBE, "solver": {"strategy": "fixed", "steps": 400}, "checkpoint": {"every": 1}}


@pytest.mark.release
def test_a_second_resume_or_run_in_the_same_directory_is_refused(tmp_path: Path) -> None:
    job = write_job(tmp_path / "slow.yaml", SLOW)
    with Started(1, "run", job, "--output", "run", cwd=tmp_path) as first:
        first.wait_for("load 0.0025:")
        for arguments in (("resume", "run"), ("run", job, "--output", "run", "--overwrite")):
            second = hpcinv_here(*arguments, cwd=tmp_path)
            assert second.returncode == 2, second.stdout + second.stderr
            assert second.stderr.count("this directory is in use by another run: process ") == 1
            assert first.mpirun.poll() is None
        first.kill()  # whose lock ends with it
    with Started(1, "resume", "run", cwd=tmp_path) as resumed:
        resumed.wait_for("resumed from")
        third = hpcinv_here("resume", "run", cwd=tmp_path)
        assert third.returncode == 2, third.stdout + third.stderr
        assert "Traceback" not in third.stderr
        resumed.send(signal.SIGTERM, resumed.ranks())
        assert resumed.exit_code() == 75, resumed.text
    assert not (tmp_path / "run" / ".lock").exists()


@pytest.mark.parametrize("every", [1, 0])
def test_a_directory_that_is_removed_in_mid_run_is_an_error(every: int, tmp_path: Path) -> None:
    # Without checkpoints it is found out at the end.
    job = write_job(
        tmp_path / "slow.yaml", SLOW, checkpoint={"every": every}, solver={"strategy": "fixed", "steps": 80}
    )
    with Started(1, "run", job, "--output", "run", cwd=tmp_path) as started:
        started.wait_for("load 0.0125:")
        (tmp_path / "run").rename(tmp_path / "elsewhere")
        assert started.exit_code() == 2, started.text
    assert "was removed during the run" in started.text
    assert "Traceback" not in started.text
    if not every:  # else it may have been about to write a checkpoint, whose directories ADIOS2 makes
        assert not (tmp_path / "run").exists()


@pytest.mark.release
def test_a_run_that_was_stopped_before_it_saved_says_how_to_start_again(tmp_path: Path) -> None:
    job = write_job(tmp_path / "slow.yaml", SLOW, checkpoint={"every": 0})
    with Started(1, "run", job, "--output", "run", cwd=tmp_path) as started:
        started.wait_for("load 0.0025:")
        started.send(signal.SIGTERM, started.ranks())
        assert started.exit_code() == 75, started.text
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["status"] == "stopped by a signal"
    assert summary["certificate"]["verdict"] == "fail"
    assert summary["solutions"] == []
    assert summary["certificate"]["lines"][0]["value"] < 1
    assert "again with: mpirun -n 1 python -m hpcinv resume run" in started.text or "Go on with" in started.text


@pytest.mark.everyday("files0")
@pytest.mark.parametrize(
    "files", [{"origin.json": ""}, {"origin.json": "ORIGIN"}, {"origin.json": "ORIGIN", "job.yaml": "mesh: {"}]
)
def test_with_its_job_file_a_run_goes_on_whatever_a_kill_has_left(files: dict[str, str], tmp_path: Path) -> None:
    """So do the batch scripts, where there is an origin."""
    job, run = write_job(tmp_path / "cube.yaml", CUBE), tmp_path / "run"
    run.mkdir()
    for name, content in files.items():
        (run / name).write_text(content.replace("ORIGIN", json.dumps({"job": str(job)})))
    refused = hpcinv_here("resume", "run", cwd=tmp_path)
    assert refused.returncode == 2, refused.stdout
    assert "Traceback" not in refused.stderr
    done = hpcinv_here("resume", "run", "--job", job, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert RunDirectory(run).is_finished
    assert RunDirectory(run).holds(load(job))


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run, next to its job file."""
    place = tmp_path_factory.mktemp("finished")
    done = hpcinv_here("run", write_job(place / "cube.yaml", CUBE), "--output", "run", cwd=place)
    assert done.returncode == 0, done.stderr
    return place / "run"


def content(run: Path) -> dict[str, bytes]:
    return {str(path.relative_to(run)): path.read_bytes() for path in run.rglob("*") if path.is_file()}


@pytest.mark.release
def test_a_finished_run_of_another_problem_is_refused(finished: Path) -> None:
    before = content(finished)
    other = write_job(finished.parent / "other.yaml", CUBE, material=dict(CUBE["material"]) | {"young": "2 MPa"})
    refused = hpcinv_here("resume", finished, "--job", other, cwd=finished.parent)
    assert refused.returncode == 4, refused.stdout + refused.stderr
    assert refused.stderr.count("summary.json: belongs to another problem") == 1
    assert "material.mu: 384615.3846153846 -> 769230.7692307692" in refused.stderr
    assert "Traceback" not in refused.stderr
    assert content(finished) == before


@pytest.mark.parametrize(("changes", "message"), [({}, False), ({"certificate": "full"}, True)])
def test_a_finished_run_of_the_same_problem_is_finished(
    changes: dict[str, object], message: bool, finished: Path, tmp_path: Path
) -> None:
    before = content(finished)
    job = write_job(tmp_path / "new.yaml", CUBE, **changes) if changes else finished.parent / "cube.yaml"
    done = hpcinv_here("resume", finished, "--job", job, cwd=finished.parent)
    assert done.returncode == 0, done.stderr
    assert "this run is finished" in done.stdout
    assert ("were not used" in done.stdout) == message
    assert content(finished) == before


@pytest.mark.parametrize(
    ("verdict", "code", "strict"), [("pass", 0, 0), ("warning", 0, 7), ("not decided", 0, 7), ("fail", 6, 6)]
)
def test_a_finished_run_has_the_exit_code_of_its_certificate(
    verdict: str, code: int, strict: int, finished: Path, tmp_path: Path
) -> None:
    run = Path(shutil.copytree(finished, tmp_path / "run"))
    summary = json.loads((run / "summary.json").read_text())
    summary["certificate"]["verdict"] = verdict
    (run / "summary.json").write_text(json.dumps(summary))
    for options, expected in (([], code), (["--strict"], strict)):
        done = hpcinv_here("resume", run, *options, cwd=tmp_path)
        assert done.returncode == expected, done.stdout + done.stderr
        assert f"certificate: {verdict}" in done.stdout


@pytest.mark.parametrize("certificate", [{"verdict": "excellent"}, {}, None, "fine"])
def test_a_verdict_that_is_not_known_is_not_decided(certificate: object, finished: Path, tmp_path: Path) -> None:
    """As in the summary of another version."""
    run = Path(shutil.copytree(finished, tmp_path / "run"))
    summary = json.loads((run / "summary.json").read_text())
    (run / "summary.json").write_text(json.dumps(summary | {"certificate": certificate}))
    done = hpcinv_here("resume", run, "--strict", cwd=tmp_path)
    assert done.returncode == 7, done.stdout + done.stderr
    assert "certificate: not decided" in done.stdout


def test_a_run_with_demands_on_accuracy_is_compared_with_its_job(tmp_path: Path) -> None:
    """Not with the mesh and degree that the search has chosen, which the summary has."""
    demands = {"accuracy": {"top": "0.02 mm"}}
    job = load(write_job(tmp_path / "block.yaml", BLOCK, **demands))
    directory = created(tmp_path / "run", job)
    chosen = fingerprint(job.with_({"mesh.parameters.nx": 8, "discretisation.displacement": 3}))
    summary = {"status": "converged", "job": job.model_dump(mode="json"), "fingerprint": chosen}
    (directory.path / "summary.json").write_text(json.dumps(summary))
    directory.check_same_problem(job)
    directory.check_same_problem(job.with_({"certificate": "full"}))
    with pytest.raises(CheckpointError, match=r"problem:\n  material\.mu: 10000\.0 -> 9000\.0\n  A resume"):
        directory.check_same_problem(job.with_({"material.mu": "9 kPa"}))
