"""Sweeps from the command line that a user types: results, groups of ranks, failures, signals, kills."""

from __future__ import annotations

import dataclasses
import json
import os
import random
import re
import signal
import subprocess
import time
from pathlib import Path

import pytest
import yaml
from helpers.command_line import PATIENCE, ROOT, Started, hpcinv, hpcinv_here
from helpers.ledger_files import committed, damage
from helpers.sweeps import BLOCK, records_of, write_sweep

from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.cli import sweep as sweep_command
from hpcinv.driver import run
from hpcinv.studies.batch.ledger import liveness
from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.ledger.holder import Holder
from hpcinv.studies.batch.ledger.ledger import Ledger
from hpcinv.studies.sweep.sweep_plan import load_sweep

GRID = [{"grid": {"material.mu": ["8 kPa", "14 kPa"], "effects[0].density": [100, 200]}}]


def top(record: CaseRecord | None) -> float:
    assert record is not None
    assert record.converged, record.status
    return float(record.statistics["quantities"]["top"])


def alone(sweep: Path, number: int) -> float:
    """The same quantity of a case that is run by itself, from the unloaded body."""
    plan = load_sweep(sweep)
    case = plan.cases[number]
    if case.key not in _ALONE:
        result = run(plan.job(case), MPI.COMM_SELF).quantities["top"]
        assert isinstance(result, float)
        _ALONE[case.key] = result
    return _ALONE[case.key]


_ALONE: dict[str, float] = {}  # by the key of the case, which stands for all that its answer depends on


@pytest.mark.release
def test_a_rank_without_a_case_does_not_hold_up_the_others(tmp_path: Path) -> None:
    """In the processes of the launcher: PETSc's log, which waits for all ranks, was begun by the first solve."""
    sweep = write_sweep(tmp_path, [{"grid": {"material.mu": ["8 kPa"]}}])
    ended = hpcinv(2, "sweep", "run", sweep, "--no-isolation", cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert "converged: 1" in ended.stdout


@pytest.mark.everyday("2-2")
@pytest.mark.parametrize(("ranks", "per_case"), [(1, 1), pytest.param(2, 1, marks=pytest.mark.release), (2, 2), (3, 1)])
def test_every_case_is_solved_once_whatever_the_ranks(ranks: int, per_case: int, tmp_path: Path) -> None:
    sweep = write_sweep(tmp_path, GRID)
    ended = hpcinv(ranks, "sweep", "run", sweep, "--ranks-per-case", per_case, cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert sorted(re.findall(r"(?<!first: )case (\d+), ", ended.stdout)) == [str(i) for i in range(4)]
    assert "converged: 4" in ended.stdout
    records = records_of(sweep)
    for number, record in records.items():
        assert top(record) == pytest.approx(alone(sweep, number), rel=1e-10)
        assert record is not None
        assert record.statistics["machine"]["ranks"] == per_case
    assert not list(tmp_path.glob("store/cases/*/*/run-*"))
    again = hpcinv_here("sweep", "run", sweep, cwd=tmp_path)
    assert again.returncode == 0
    assert not re.findall(r"(?<!first: )case \d", again.stdout)
    assert records_of(sweep) == records


@pytest.mark.release
def test_sweeps_that_share_a_store_share_their_cases(tmp_path: Path) -> None:
    first = write_sweep(tmp_path, GRID)
    assert hpcinv_here("sweep", "run", first, "--no-isolation", cwd=tmp_path).returncode == 0
    content = yaml.safe_load(first.read_text())
    content["axes"] = [{"zip": {"material.mu": ["14 kPa", 9000], "effects[0].density": ["0.2 g/cm^3", 100]}}]
    other = tmp_path / "other.yaml"
    other.write_text(yaml.safe_dump(content))
    ended = hpcinv_here("sweep", "run", other, "--no-isolation", cwd=tmp_path)
    assert ended.returncode == 0
    assert re.findall(r"(?<!first: )case (\d+), ", ended.stdout) == ["1"]


def test_a_case_that_fails_is_reported_and_the_others_go_on(tmp_path: Path) -> None:
    """The softest block cannot have stood up; a region that is not in the mesh is found only where there is one."""
    axes = [{"zip": {"material.mu": ["10 kPa", "20 Pa", "12 kPa"], "material.lam": ["40 kPa", "40 Pa", "40 kPa"]}}]
    sweep = write_sweep(tmp_path, axes)
    ended = hpcinv_here("sweep", "run", sweep, "--no-isolation", cwd=tmp_path)
    assert ended.returncode == 3
    assert "converged: 2" in ended.stdout
    assert "failed: 1;" in ended.stdout
    failed = records_of(sweep)[1]
    assert failed is not None
    assert "load factor" in failed.status
    assert failed.advice
    assert failed.statistics["status"] in ended.stdout
    again = hpcinv_here("sweep", "run", sweep, cwd=tmp_path)
    assert again.returncode == 3
    assert not re.findall(r"(?<!first: )case \d", again.stdout)
    retried = hpcinv_here("sweep", "retry", "--failed", sweep, cwd=tmp_path)
    assert "1 failed case is open again" in retried.stdout
    again = hpcinv_here("sweep", "run", sweep, "--no-isolation", cwd=tmp_path)
    assert re.findall(r"(?<!first: )case (\d+), ", again.stdout) == ["1"]

    wrong = write_sweep(tmp_path, [{"grid": {"supports": [[{"region": "floor", "fix": ["x", "y", "z"]}]]}}])
    ended = hpcinv_here("sweep", "run", wrong, "--no-isolation", cwd=tmp_path)
    assert ended.returncode == 3
    assert "floor" in ended.stdout


@pytest.mark.parallel([3])
def test_ranks_must_fit_into_groups(run_directory: Path, comm: MPI.Intracomm) -> None:
    sweep = on_root(comm, lambda: write_sweep(run_directory, GRID))
    ended = hpcinv_here("sweep", "run", sweep, "--ranks-per-case", 2, cwd=run_directory)
    assert ended.returncode == 2
    assert "3 ranks cannot be divided" in ended.stderr
    assert ended.stderr.count("--ranks-per-case") == 1


STEPS = 40


def slow(cases: int) -> list[dict[str, object]]:
    """Cases of many steps each, which take seconds."""
    steps = {"strategy": "fixed", "steps": STEPS}
    return [{"grid": {"material.mu": [10e3 + 100 * i for i in range(cases)]}}, {"grid": {"solver": [steps]}}]


@pytest.mark.release
def test_a_signal_saves_the_case_at_hand_and_the_next_run_goes_on_with_it(tmp_path: Path) -> None:
    sweep = write_sweep(tmp_path, slow(2), job={**BLOCK, "checkpoint": {"every": 1, "seconds": 0}})
    with Started(1, "sweep", "run", sweep, cwd=tmp_path) as started:
        _wait_for_checkpoint(tmp_path)
        started.send(signal.SIGTERM, started.ranks())
        assert started.exit_code() == 75
        assert "2 cases left" in started.text
    (saved,) = tmp_path.glob("store/cases/*/*/run-*")
    reached = yaml.safe_load(max(saved.glob("checkpoints/*/state.json")).read_text())["position"]["load"]
    assert 0 < reached < 1
    ended = hpcinv_here("sweep", "run", sweep, "--no-isolation", cwd=tmp_path)
    assert ended.returncode == 0
    for record in records_of(sweep).values():
        assert record is not None
        assert [s["load"] for s in record.statistics["solutions"][0]["solves"]] == pytest.approx(
            [(i + 1) / STEPS for i in range(STEPS)]
        )


def test_case_is_solved_from_any_remains_of_a_killed_run(tmp_path: Path) -> None:
    """Each case was claimed by a process that died, and left a directory in another state."""
    sweep = write_sweep(tmp_path, [{"grid": {"material.mu": [8000 + 500 * i for i in range(9)]}}])
    plan = load_sweep(sweep)
    dead = subprocess.Popen(["true"])
    with Holder(plan.store) as holder:
        holder.identity = dataclasses.replace(holder.identity, pid=dead.pid)
        dead.wait()
        ledger = Ledger(plan.store, holder)
        claims = [ledger.claim(case.key) for case in plan.cases]
    origin = json.dumps({"job": str(plan.base.resolve())})
    text = yaml.safe_dump(dict(plan.content(plan.cases[5])), sort_keys=False)
    states: list[dict[str, str]] = [
        {},
        {"origin.json": ""},
        {"origin.json": origin},
        {"origin.json": origin, "job.yaml": ""},
        {"origin.json": origin, "job.yaml": text[: len(text) // 2]},
        {"origin.json": origin[:10], "job.yaml": text},
        {".origin.json.partial": "", ".lock": ""},
        {"origin.json": origin, "job.yaml": text, "checkpoints": "no directory"},
        {"job.yaml": text, "summary.json": "{"},
    ]
    for claim, files in zip(claims, states, strict=True):
        assert claim is not None
        claim.run.mkdir(parents=True)
        for name, content in files.items():
            (claim.run / name).write_text(content)
    ended = hpcinv_here("sweep", "run", sweep, "--no-isolation", cwd=tmp_path)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    for number, record in records_of(sweep).items():
        assert record is not None
        assert record.attempts == 2
        assert top(record) == pytest.approx(alone(sweep, number), rel=1e-10)


@pytest.mark.release
def test_a_killed_case_goes_on_from_its_checkpoint(tmp_path: Path) -> None:
    sweep = write_sweep(tmp_path, slow(1), job={**BLOCK, "checkpoint": {"every": 1, "seconds": 0}})
    with Started(2, "sweep", "run", sweep, "--ranks-per-case", 2, cwd=tmp_path) as started:
        saved = _wait_for_checkpoint(tmp_path)
        started.kill()
    (tmp_path / "marked").write_text(saved.name)
    again = hpcinv_here("sweep", "run", sweep, "--no-isolation", cwd=tmp_path)
    assert again.returncode == 0, again.stdout + again.stderr
    (record,) = records_of(sweep).values()
    assert record is not None
    assert record.attempts == 2
    assert top(record) == pytest.approx(alone(sweep, 0), rel=1e-9)


def _wait_for_checkpoint(directory: Path) -> Path:
    deadline = time.monotonic() + PATIENCE
    while not (paths := list(directory.glob("store/cases/*/*/run-*/checkpoints/[0-9]*"))):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return paths[0]


@pytest.mark.release  # each day: two allocations of a study, which share a store in the same way
def test_two_allocations_at_once_share_the_work(tmp_path: Path) -> None:
    sweep = write_sweep(tmp_path, [{"sobol": {"material.mu": ["8 kPa", "20 kPa"]}, "count": 8}])
    with (
        Started(1, "sweep", "run", sweep, "--shard", "1/2", cwd=tmp_path) as first,
        Started(1, "sweep", "run", sweep, "--shard", "2/2", cwd=tmp_path) as two,
    ):
        assert first.exit_code() == 0, first.text
        assert two.exit_code() == 0, two.text
        done = [re.findall(r"(?<!first: )case (\d+), ", started.text) for started in (first, two)]
    assert all(done)
    assert sorted(done[0] + done[1]) == sorted(str(i) for i in range(8))


def test_the_case_of_a_vanished_node_is_taken_over_after_the_lease(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sweep = write_sweep(tmp_path, GRID)
    plan = load_sweep(sweep)
    with Holder(plan.store) as holder:
        holder.identity = dataclasses.replace(holder.identity, machine="another", token="another-1")
        assert Ledger(plan.store, holder).claim(plan.cases[3].key) is not None
    refused = hpcinv_here("sweep", "run", sweep, "--lease", 5, cwd=tmp_path)
    assert refused.returncode == 2
    assert "must be 15 or more" in refused.stderr
    monkeypatch.setattr(sweep_command, "BEAT", 0.5)  # nothing writes the heartbeat of that node
    begun = time.monotonic()
    ended = hpcinv_here("sweep", "run", sweep, "--lease", 2, "--no-isolation", cwd=tmp_path)
    assert time.monotonic() - begun > 2
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert sorted(re.findall(r"(?<!first: )case (\d+), ", ended.stdout)) == [str(i) for i in range(4)]
    record = records_of(sweep)[3]
    assert record is not None
    assert record.attempts == 2


def test_superseded_process_stops_writing(tmp_path: Path) -> None:
    """A process that slept for longer than the lease on another machine finds its directory gone, and goes on."""
    sweep = write_sweep(tmp_path, slow(2), job={**BLOCK, "checkpoint": {"every": 1, "seconds": 0}})
    plan = load_sweep(sweep)
    with Started(1, "sweep", "run", sweep, cwd=tmp_path) as started:
        run = _wait_for_checkpoint(tmp_path).parents[1]
        sleeping = started.ranks()
        started.send(signal.SIGSTOP, sleeping)
        try:
            watch = liveness.Watch.is_dead
            with pytest.MonkeyPatch.context() as patch, Holder(plan.store) as holder:
                patch.setattr(liveness.Watch, "is_dead", lambda *_: True)
                key = run.parent.name
                ledger = Ledger(plan.store, holder)
                taken = ledger.claim(key)
                assert taken is not None
                assert ledger.commit(taken, CaseRecord("by another", "", {}, 1.0, 2))
            assert liveness.Watch.is_dead is watch
        finally:
            started.send(signal.SIGCONT, sleeping)
        assert started.exit_code() == 3, started.text
        assert "claimed by another process" in started.text or "finished by another" in started.text
    assert sorted(r.status for r in records_of(sweep).values() if r is not None) == ["by another", "converged"]


def test_a_full_disk_is_reported_and_the_same_command_goes_on(tmp_path: Path) -> None:
    store = tmp_path / "store"
    store.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=80k", "tmpfs", str(store)], capture_output=True, text=True, check=False
    )
    if mounted.returncode:
        pytest.skip(f"no small file system can be mounted here: {mounted.stderr.strip()}")
    try:
        sweep = write_sweep(tmp_path, [{"sobol": {"material.mu": ["8 kPa", "20 kPa"]}, "count": 14}])
        full = hpcinv(1, "sweep", "run", sweep, "--no-isolation", cwd=tmp_path)
        assert full.returncode == 2, full.stdout + full.stderr
        assert "No space left" in full.stderr
        assert "Traceback" not in full.stderr, full.stderr
        done = re.findall(r"(?<!first: )case (\d+), ", full.stdout)
        assert 0 < len(done) < 14
        subprocess.run(["mount", "-o", "remount,size=20m", str(store)], check=True)
        ended = hpcinv_here("sweep", "run", sweep, "--no-isolation", cwd=tmp_path)
        assert ended.returncode == 0, ended.stderr
        again = re.findall(r"(?<!first: )case (\d+), ", ended.stdout)
        assert sorted(done + again, key=int) == [str(i) for i in range(14)]
    finally:
        subprocess.run(["umount", str(store)], check=True)


def test_a_case_with_a_damaged_record_is_solved_again_by_the_next_start(tmp_path: Path) -> None:
    sweep = write_sweep(tmp_path, GRID)
    assert hpcinv_here("sweep", "run", sweep, "--no-isolation", cwd=tmp_path).returncode == 0
    plan, before = load_sweep(sweep), records_of(sweep)
    key = plan.cases[2].key
    damage(plan.store, key)
    done = hpcinv_here("sweep", "run", sweep, "--no-isolation", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("1 × record damaged, or a file of the mesh has changed: the case is solved again") == 1
    assert done.stdout.count("s, certificate") == 1
    assert top(records_of(sweep)[2]) == pytest.approx(top(before[2]), rel=1e-9)


@pytest.mark.release
def test_finished_sweeps_start_no_solver_process(tmp_path: Path) -> None:
    """Importing PETSc takes longer than reading thousands of records."""
    sweep = write_sweep(tmp_path, GRID)
    assert hpcinv_here("sweep", "run", sweep, "--no-isolation", cwd=tmp_path).returncode == 0
    lacking = tmp_path / "lacking"
    lacking.mkdir()
    (lacking / "petsc4py.py").write_text("raise ImportError('PETSc was imported')")
    path = os.pathsep.join([str(lacking), str(ROOT)])
    for options in ((), ("--no-isolation",)):
        done = hpcinv(2, "sweep", "run", sweep, *options, cwd=tmp_path, PYTHONPATH=path)
        assert done.returncode == 0, done.stdout + done.stderr
        assert f"{len(load_sweep(sweep).cases)} of {len(load_sweep(sweep).cases)} cases finished" in done.stdout


@pytest.mark.parallel([2])
def test_a_store_with_other_files_is_refused_on_all_ranks(run_directory: Path, comm: MPI.Intracomm) -> None:
    def write() -> Path:
        (run_directory / "store").mkdir()
        (run_directory / "store" / "letter.txt").write_text("dear all")
        return write_sweep(run_directory, GRID)

    sweep = on_root(comm, write)
    ended = hpcinv_here("sweep", "run", sweep, "--no-isolation", cwd=run_directory)
    assert ended.returncode == 2
    assert "holds files that are not of a store" in ended.stderr
    assert ended.stderr.count("not of a store") == 1


def test_a_file_is_refused_as_a_store(tmp_path: Path) -> None:
    sweep = write_sweep(tmp_path, GRID)
    (tmp_path / "store").write_text("")
    assert hpcinv_here("sweep", "run", sweep, cwd=tmp_path).returncode == 2


def test_kills_at_random_moments_lose_nothing_and_repeat_nothing(tmp_path: Path) -> None:
    """Kills of whole runs at random moments: what was committed stays as it is, and what was not is done at the end."""
    chance, store = random.Random(5), tmp_path / "store"
    steps, count = {"strategy": "fixed", "steps": 20}, 6
    sweep = write_sweep(
        tmp_path, [{"grid": {"material.mu": [8000 + 200 * i for i in range(count)]}}], set={"solver": steps}
    )
    before: dict[tuple[str, int, int], bytes] = {}
    reported: list[str] = []
    kills = 0
    while kills < 2:
        with Started(1 + (kills % 2), "sweep", "run", sweep, cwd=tmp_path) as started:
            deadline = time.monotonic() + PATIENCE
            # The first is killed while it starts, the other one while it works on a case.
            while kills and committed(store).keys() <= before.keys() and started.mpirun.poll() is None:
                assert time.monotonic() < deadline, started.text
                time.sleep(0.002)
            time.sleep(chance.uniform(0.0, 0.2 if kills else 2.0))
            assert started.mpirun.poll() is None, f"ended after {kills} kills: {started.text}"
            started.kill()
            kills += 1
            reported += re.findall(r"(?<!first: )case (\d+), ", started.text)
        assert committed(store).items() >= before.items()
        before = committed(store)
    ended = hpcinv_here("sweep", "run", sweep, "--no-isolation", cwd=tmp_path)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    reported += re.findall(r"(?<!first: )case (\d+), ", ended.stdout)
    assert len(reported) == len(set(reported)) <= count
    assert committed(store).items() >= before.items()
    finished = [record for record in records_of(sweep).values() if record is not None]
    assert len(finished) == count == len(committed(store))
    for number in (0, count - 1):
        assert top(records_of(sweep)[number]) == pytest.approx(alone(sweep, number), rel=1e-10)
