"""Runs that are killed, stopped by signals and resumed, through the real command line."""

from __future__ import annotations

import json
import random
import shutil
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import BEAM as CURVED_BEAM
from helpers.command_line import BLOCK, Started, hpcinv, hpcinv_here, write_job
from helpers.mesh_cases import spec
from helpers.silicone_beam import DENSITY, LENGTH

from hpcinv.mesh import read_source

STEPS = 8
BEAM: dict[str, Any] = {
    **CURVED_BEAM,
    "mesh": {**CURVED_BEAM["mesh"], "parameters": {"size": "8 mm"}, "geometry_degree": 1},
}
"""Straight cells, since curved ones of this size would be inverted."""
ROUND_TRIP: dict[str, Any] = {"analysis": "round_trip", "first": "forward"}
FIXED: dict[str, Any] = {"strategy": "fixed", "steps": STEPS}

KILL_WHILE_WRITING = """
import os, signal, sys
from hpcinv.output import checkpoint
from hpcinv.__main__ import main

replace, count = checkpoint.replace, 0

def write_and_die(path, content):
    global count
    count += 1
    if count == 3:
        path.write_bytes(content[:100])
        os.kill(os.getpid(), signal.SIGKILL)
    replace(path, content)

checkpoint.replace = write_and_die
sys.exit(main())
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with the job, which starts with the straight beam."""
    place = tmp_path_factory.mktemp("restart")
    write_job(place / "beam.yaml", BEAM, **ROUND_TRIP, solver=FIXED)
    write_job(place / "forward.yaml", BEAM, analysis="forward", solver=FIXED)  # its first solution alone
    return place


@pytest.fixture(scope="module")
def whole(place: Path) -> Path:
    """The run that nothing interrupted."""
    done = hpcinv_here("run", "beam.yaml", "--output", "whole", cwd=place)
    assert done.returncode == 0, done.stderr
    return place / "whole"


@pytest.fixture(scope="module")
def killed(place: Path) -> Path:
    """A run on two ranks that was killed at some moment after two steps of the first solution."""
    step, moment = random.choice(["load 0.375:", "load 0.75:", "inverse:"]), random.uniform(0.0, 0.2)
    print(f"killed {moment:.2f} s after {step!r}")
    with Started(2, "run", "beam.yaml", "--output", "killed", cwd=place) as started:
        started.wait_for(step)  # so that at least two steps are saved
        time.sleep(moment)
        started.kill()
    assert not (place / "killed" / "summary.json").exists()
    return place / "killed"


@pytest.fixture
def copy(killed: Path, tmp_path: Path) -> Path:
    """The killed run, to be resumed."""
    return Path(shutil.copytree(killed, tmp_path / "copy"))


def newest(run: Path, age: int = 0) -> Path:
    return sorted((run / "checkpoints").glob("[0-9]*"))[-1 - age]


def state(checkpoint: Path) -> dict[str, Any]:
    position: dict[str, Any] = json.loads((checkpoint / "state.json").read_text())["position"]
    return position


def steps_behind(position: dict[str, Any]) -> int:
    """Accepted steps up to a checkpoint, over both solutions."""
    return position["direction"] * STEPS + round(position["load"] * STEPS)


def summary(run: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((run / "summary.json").read_text())
    return content


def assert_same_result(run: Path, whole: Path) -> None:
    shape, expected = (read_source(spec(r / "shape.msh"), r / "shape.msh") for r in (run, whole))
    np.testing.assert_array_equal(shape.cells, expected.cells)
    assert np.abs(shape.points - expected.points).max() <= 1e-9 * LENGTH
    content, reference = summary(run), summary(whole)
    assert content["status"] == "converged"
    assert all(error["max"] < 1e-9 * LENGTH for error in content["errors"].values())
    for solution, other in zip(content["solutions"], reference["solutions"], strict=False):
        assert solution["J"] == pytest.approx(other["J"], rel=1e-9)
        assert solution["strain_energy"] == pytest.approx(other["strain_energy"], rel=1e-9)
        assert [s["load"] for s in solution["solves"]] == [s["load"] for s in other["solves"]]
        assert {s["outcome"] for s in solution["solves"]} <= {"CONVERGED", "ROUND_OFF"}


def assert_history_goes_on(run: Path, position: dict[str, Any], output: str) -> None:
    """The steps up to the checkpoint are in the summary as they were, and no others were solved again."""
    for solution, before in zip(summary(run)["solutions"], position["solves"], strict=False):
        assert [s["load"] for s in solution["solves"][: len(before)]] == [s["load"] for s in before]
        for after, solve in zip(solution["solves"], before, strict=False):
            assert [i["correction"] for i in after["iterations"]] == [i["correction"] for i in solve["iterations"]]
    assert output.count("  load ") == len(summary(run)["solutions"]) * STEPS - steps_behind(position)


@pytest.mark.release
@pytest.mark.parametrize("ranks", [1, 3])
def test_a_run_killed_on_two_ranks_goes_on_with_any_number(ranks: int, copy: Path, whole: Path) -> None:
    position = state(newest(copy))
    assert steps_behind(position) >= 2
    shutil.copytree(newest(copy), copy / "checkpoints" / ".partial-0099")
    done = hpcinv(ranks, "resume", copy, cwd=copy.parent)
    assert done.returncode == 0, done.stderr
    assert_same_result(copy, whole)
    assert_history_goes_on(copy, position, done.stdout)
    assert not list((copy / "checkpoints").glob(".partial*"))


def test_a_run_killed_on_two_ranks_is_stopped_on_three_and_ends_on_one(copy: Path, whole: Path) -> None:
    """The steps of all three processes are in one history; the signal, which comes three times, saves one state."""
    position = state(newest(copy))
    assert steps_behind(position) >= 2
    shutil.copytree(newest(copy), copy / "checkpoints" / ".partial-0099")
    with Started(3, "resume", copy, cwd=copy.parent) as started:
        started.wait_for("  load ")
        for _ in range(3):
            started.send(signal.SIGUSR1, [started.mpirun.pid])
            time.sleep(0.02)
        code = started.exit_code()
    assert "Traceback" not in started.text
    assert not list((copy / "checkpoints").glob(".partial*"))
    if code == 0:  # the signal came in the last step
        assert_history_goes_on(copy, position, started.text)
    else:
        assert code == 75, started.text
        assert started.text.count("stopped by a signal") == 1
        assert summary(copy)["status"] == "stopped by a signal"
        stopped = state(newest(copy))
        assert steps_behind(stopped) == steps_behind(position) + started.text.count("  load ")
        assert f"load factor {stopped['load']:g}; its state is saved" in started.text
        done = hpcinv_here("resume", copy, cwd=copy.parent)
        assert done.returncode == 0, done.stderr
        assert_history_goes_on(copy, stopped, done.stdout)
    assert_same_result(copy, whole)


def test_a_run_killed_while_writing_a_checkpoint_goes_on_from_the_previous(place: Path, whole: Path) -> None:
    script = place / "kill_while_writing.py"
    script.write_text(KILL_WHILE_WRITING)
    assert hpcinv(1, "run", "forward.yaml", "--output", "writing", cwd=place, script=script).returncode != 0
    run = place / "writing"
    assert [p.name for p in sorted((run / "checkpoints").iterdir())] == [".partial-0003", "0001", "0002"]
    position = state(newest(run))
    done = hpcinv_here("resume", "writing", cwd=place)
    assert done.returncode == 0, done.stderr
    assert_same_result(run, whole)
    assert_history_goes_on(run, position, done.stdout)
    assert not list((run / "checkpoints").glob(".partial*"))


@pytest.mark.everyday("SIGTERM-ranks")
@pytest.mark.parametrize(
    ("name", "to"), [("SIGTERM", "ranks"), ("SIGTERM", "mpirun"), ("SIGUSR1", "one rank"), ("SIGUSR1", "mpirun")]
)
def test_a_signal_saves_and_ends_with_75_however_often_it_comes(name: str, to: str, place: Path) -> None:
    number, run = signal.Signals[name], place / f"{name}-{to}".replace(" ", "-")
    with Started(2, "run", "beam.yaml", "--output", run, cwd=place) as started:
        started.wait_for("load 0.125:")
        processes = {"ranks": started.ranks(), "one rank": started.ranks()[1:], "mpirun": [started.mpirun.pid]}[to]
        assert processes
        for _ in range(3):
            started.send(number, processes)
            time.sleep(0.02)
        assert started.exit_code() == 75, started.text
    assert started.text.count("stopped by a signal") == 1
    assert "Traceback" not in started.text
    position = state(newest(run))
    assert steps_behind(position) >= 1
    assert f"load factor {position['load']:g}; its state is saved" in started.text
    assert summary(run)["status"] == "stopped by a signal"


@pytest.fixture(scope="module")
def stopped_in_second_direction(place: Path) -> Path:
    """Stopped by a signal; only the signal made it save, since checkpoints are far apart."""
    write_job(place / "rare.yaml", BEAM, **ROUND_TRIP, solver=FIXED, checkpoint={"every": 100})
    with Started(1, "run", "rare.yaml", "--output", "second-solution", cwd=place) as started:
        started.wait_for("inverse:")
        started.send(signal.SIGUSR1, [started.mpirun.pid])
        assert started.exit_code() == 75, started.text
    return place / "second-solution"


@pytest.mark.release
def test_a_signal_in_the_second_direction_keeps_the_first(
    stopped_in_second_direction: Path, whole: Path, tmp_path: Path
) -> None:
    run = Path(shutil.copytree(stopped_in_second_direction, tmp_path / "copy"))
    position = state(newest(run))
    assert position["direction"] == 1
    done = hpcinv_here("resume", run, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "forward:\n  load" not in done.stdout
    assert_same_result(run, whole)
    assert_history_goes_on(run, position, done.stdout)


def test_ctrl_c_ends_all_ranks_at_once_and_what_was_saved_can_be_resumed(place: Path) -> None:
    """Two ranks: in `test_stopping.py`, a signal while a process reads a mesh."""
    with Started(1, "run", "beam.yaml", "--output", "ctrl-c", cwd=place) as started:
        started.wait_for("load 0.25:")
        started.send(signal.SIGINT, [started.mpirun.pid])
        assert started.exit_code() == 130, started.text
    assert "Traceback" not in started.text
    assert steps_behind(state(newest(place / "ctrl-c"))) >= 1


def test_a_finished_run_is_reported_as_finished(whole: Path, place: Path) -> None:
    before = (whole / "summary.json").read_bytes()
    done = hpcinv_here("resume", "whole", cwd=place)
    assert done.returncode == 0, done.stderr
    assert "this run is finished" in done.stdout
    assert (whole / "summary.json").read_bytes() == before


@pytest.mark.release
def test_a_run_killed_before_its_results_writes_them_on_resume(whole: Path, tmp_path: Path) -> None:
    run = Path(shutil.copytree(whole, tmp_path / "copy"))
    for result in ("summary.json", "summary.h5", "shape.msh"):
        (run / result).unlink()
    done = hpcinv_here("resume", run, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert_same_result(run, whole)
    assert done.stdout.count("  load ") == 0


def test_a_damaged_checkpoint_is_named_and_the_one_before_is_used(copy: Path, whole: Path) -> None:
    text = newest(copy) / "state.json"
    text.write_text(text.read_text()[:200])
    position = state(newest(copy, 1))
    done = hpcinv_here("resume", copy, cwd=copy.parent)
    assert done.returncode == 0, done.stderr
    assert f"not used: {text.parent}: state.json is missing or damaged" in done.stdout
    assert_same_result(copy, whole)
    assert_history_goes_on(copy, position, done.stdout)


def files_of(run: Path) -> Iterator[tuple[str, bytes]]:
    return ((str(p.relative_to(run)), p.read_bytes()) for p in sorted(run.rglob("*")) if p.is_file())


def assert_refused(run: Path, *arguments: object, because: str) -> None:
    """Exit 4, the reason once and without a traceback, and nothing in the directory is touched."""
    shutil.copytree(newest(run), run / "checkpoints" / ".partial-0099", dirs_exist_ok=True)  # killed while it wrote
    before = dict(files_of(run))
    before.pop(".lock", None)  # of the killed process: the resume takes its place, and leaves no lock of its own
    done = hpcinv_here("resume", run, *arguments, cwd=run.parent)
    assert done.returncode == 4, done.stderr
    assert done.stderr.count(because) == 1, done.stderr
    assert "Traceback" not in done.stderr
    assert dict(files_of(run)) == before


def test_only_damaged_checkpoints_are_refused(copy: Path) -> None:
    for age in range(2):
        shutil.rmtree(newest(copy, age) / "functions.bp")
    assert_refused(copy, because="no checkpoint can be used")


def test_another_material_is_refused_with_the_difference(copy: Path) -> None:
    changed = write_job(
        copy.parent / "changed.yaml", BEAM, **ROUND_TRIP, material=dict(BEAM["material"]) | {"c1": 99999.0}
    )
    assert_refused(copy, "--job", changed, because="material.c1: 101709.668 -> 99999.0")


@pytest.mark.release
def test_a_generator_that_makes_other_cells_is_refused(copy: Path) -> None:
    """The same text and parameters, so that the job is the same; what differs is in a file that it reads."""
    run, size = copy.parent / "run", copy.parent / "size"
    generator = copy.parent / "beam.py"
    text = Path(BEAM["mesh"]["file"]).read_text()
    read = "    size = float(open(__file__.replace('beam.py', 'size')).read())\n    occ = gmsh.model.occ\n"
    generator.write_text(text.replace("    occ = gmsh.model.occ\n", read))
    size.write_text("0.004")
    job = write_job(
        copy.parent / "job.yaml", BEAM, analysis="forward", mesh={"file": "beam.py", "geometry_degree": 2}, solver=FIXED
    )
    with Started(1, "run", job, "--output", run, cwd=copy.parent) as started:
        started.wait_for("load 0.25:")
        started.kill()
    size.write_text("0.0035")
    assert_refused(run, because="cells: ")


@pytest.mark.release
def test_other_settings_are_accepted_and_stay(stopped_in_second_direction: Path, whole: Path, tmp_path: Path) -> None:
    run = Path(shutil.copytree(stopped_in_second_direction, tmp_path / "copy"))
    position = state(newest(run))
    changed = write_job(
        tmp_path / "changed.yaml",
        BEAM,
        **ROUND_TRIP,
        solver=FIXED | {"tolerance": 1e-11, "petsc": {"snes_linesearch_type": "l2"}},
        output={"mesh": ["msh"], "fields": False},
        checkpoint={"every": 1, "keep": 1},
    )
    done = hpcinv_here("resume", run, "--job", changed, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert_same_result(run, whole)
    assert_history_goes_on(run, position, done.stdout)
    assert len(list((run / "checkpoints").iterdir())) == 1
    assert (run / "job.yaml").read_text() == changed.read_text()


TIP: dict[str, Any] = {"name": "tip", "of": "displacement", "at": [LENGTH, 0, 0]}


def test_demands_on_the_accuracy_are_refused_before_they_cost_the_checkpoints(copy: Path) -> None:
    """The search needs none of them, and its results would take their place."""
    changed = write_job(
        copy.parent / "changed.yaml", BEAM, **ROUND_TRIP, solver=FIXED, quantities=[TIP], accuracy={"tip": "5 mm"}
    )
    assert_refused(copy, "--job", changed, because=f"{changed}: accuracy: ")


def test_without_its_demands_on_the_accuracy_a_run_goes_on_with_checkpoints(place: Path) -> None:
    """A search has no checkpoints; the job without it writes some, which are used from then on."""
    block: dict[str, Any] = {**BLOCK, "solver": {"strategy": "fixed", "steps": 4}, "analysis": "round_trip"}
    searching = write_job(place / "searching.yaml", block, accuracy={"top": "2 cm"})
    run = place / "searching"
    with Started(1, "run", searching, "--output", run, cwd=place) as started:
        started.wait_for("forward:")
        started.kill()
    assert not (run / "checkpoints").exists()
    done = hpcinv_here("resume", run, "--job", write_job(place / "plain.yaml", block), cwd=place)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("  load ") == 8
    (run / "summary.json").unlink()
    assert_refused(run, "--job", searching, because=f"{searching}: accuracy: ")


@pytest.mark.everyday("certificate")
@pytest.mark.parametrize(
    "changes",
    [
        pytest.param({"certificate": {"level": "standard"}}, id="certificate"),
        pytest.param({"quantities": [TIP], "sensitivities": {"material.c1": "5 kPa"}}, id="quantities"),
        pytest.param({"output": {"summary": ["json"], "report": True, "snapshots": False}}, id="output"),
        pytest.param({"job": "another", "solver": FIXED | {"linear": "iterative"}}, id="solver"),
    ],
)
def test_checkpoints_serve_whatever_else_is_asked_of_the_run(changes: dict[str, Any], copy: Path, whole: Path) -> None:
    position = state(newest(copy))
    changed = write_job(copy.parent / "changed.yaml", {**BEAM, **ROUND_TRIP, "solver": FIXED}, **changes)
    done = hpcinv_here("resume", copy, "--job", changed, cwd=copy.parent)
    assert done.returncode == 0, done.stderr
    assert_same_result(copy, whole)
    assert_history_goes_on(copy, position, done.stdout)


@pytest.mark.everyday("changes0", "changes2")
@pytest.mark.parametrize(
    "changes", [{"solver": {"strategy": "arc-length"}}, {"solver": {"strategy": "adaptive"}}, {"method": "anderson"}]
)
def test_at_full_load_no_strategy_solves_anything_again(changes: dict[str, Any], tmp_path: Path) -> None:
    """The arc length went on along the path, away from the full load, until the checkpoint of that was removed."""
    job = write_job(tmp_path / "block.yaml", BLOCK, **changes)
    assert hpcinv_here("run", job, "--output", "run", cwd=tmp_path).returncode == 0
    run = tmp_path / "run"
    content, before = summary(run), sorted((run / "checkpoints").iterdir())
    (run / "summary.json").unlink()
    done = hpcinv_here("resume", run, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("  load ") == 0
    assert summary(run)["quantities"] == pytest.approx(content["quantities"], rel=1e-12)
    assert sorted((run / "checkpoints").iterdir()) == before


PATH = 3  # steps of each state


def weighed(x: float, y: float) -> list[dict[str, Any]]:
    return [{"effect": "gravity", "acceleration": [x, y, 0], "density": DENSITY}]


@pytest.fixture(scope="module")
def states(place: Path) -> Path:
    """A run of three states that nothing interrupted, the last one on a path from the second."""
    write_job(
        place / "states.yaml",
        {key: value for key, value in BEAM.items() if key != "effects"},
        states=[
            {"name": "sagging", "given": True, "effects": weighed(0, -2)},
            {"name": "rest"},
            {"name": "return", "effects": weighed(0, -2), "start": "turned"},
            {"name": "turned", "effects": weighed(-2, 0)},
        ],
        quantities=[{"name": "tip", "of": "displacement", "at": [LENGTH, 0, 0]}],
        solver={"strategy": "fixed", "steps": PATH},
        output={"mesh": ["msh"]},
    )
    done = hpcinv_here("run", "states.yaml", "--output", "states", cwd=place)
    assert done.returncode == 0, done.stderr
    titles = [line for line in done.stdout.splitlines() if line.startswith("state ")]
    assert titles == ["state sagging, from it to rest", "state turned, from rest", "state return, from turned"]
    return place / "states"


_ENDS = ("-return.vtu", "-sagging.vtu", "-turned.vtu")


def assert_same_states(run: Path, states: Path) -> None:
    content, reference = summary(run), summary(states)
    assert content["status"] == "converged"
    for name in ("rest", "turned", "return"):
        shapes = [read_source(spec(r / f"shape-{name}.msh"), r / f"shape-{name}.msh").points for r in (run, states)]
        assert np.abs(shapes[0] - shapes[1]).max() <= 1e-9 * LENGTH
    assert [s["state"] for s in content["solutions"]] == ["sagging", "turned", "return"]
    for name, tip in reference["quantities"].items():
        assert content["quantities"][name] == pytest.approx(tip, abs=1e-9 * LENGTH)
    files = {f"{body}{end}" for body in ("undeformed", "deformed") for end in (".pvd", *_ENDS)}
    assert {p.name for p in (run / "fields").iterdir()} == files


@pytest.mark.release
def test_the_last_state_is_the_given_one(states: Path) -> None:
    tips = summary(states)["quantities"]
    assert tips["tip-return"] == pytest.approx(tips["tip-sagging"], abs=1e-9 * LENGTH)
    assert tips["tip-turned"] != pytest.approx(tips["tip-sagging"], abs=0.01 * LENGTH)


@pytest.mark.everyday("state turned")
@pytest.mark.parametrize(
    ("after", "ranks"),
    [
        ("state turned", 1),
        ("state return", 3),
        pytest.param("from turned\nforward:", 1, marks=pytest.mark.release),
    ],
)
def test_a_run_killed_between_or_within_states_goes_on(after: str, ranks: int, states: Path, tmp_path: Path) -> None:
    with Started(1, "run", states.parent / "states.yaml", "--output", "killed", cwd=tmp_path) as started:
        started.wait_for(after)
        time.sleep(random.uniform(0.0, 0.3))
        started.kill()
    run = tmp_path / "killed"
    position = state(newest(run))
    behind = position["direction"] * PATH + round(position["load"] * PATH)
    print(f"killed after {behind} steps")
    assert behind >= (PATH if after == "state turned" else 2 * PATH)
    done = hpcinv_here("resume", run, cwd=tmp_path) if ranks == 1 else hpcinv(ranks, "resume", run, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert f"of state '{['sagging', 'turned', 'return'][position['direction']]}'" in done.stdout
    assert done.stdout.count("  load ") == 3 * PATH - behind
    assert_same_states(run, states)


@pytest.mark.release
def test_a_signal_in_a_state_names_the_state(states: Path, tmp_path: Path) -> None:
    with Started(1, "run", states.parent / "states.yaml", "--output", "stopped", cwd=tmp_path) as started:
        started.wait_for("state turned")
        started.send(signal.SIGTERM, started.ranks())
        assert started.exit_code() == 75, started.text
    assert "in the forward solve of state 'turned' at load factor" in started.text
    done = hpcinv_here("resume", "stopped", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert_same_states(tmp_path / "stopped", states)


def test_other_loads_of_a_state_are_refused(states: Path, tmp_path: Path) -> None:
    run = Path(shutil.copytree(states, tmp_path / "copy"))
    (run / "summary.json").unlink()
    text = (states.parent / "states.yaml").read_text()
    changed = tmp_path / "changed.yaml"
    changed.write_text(text.replace(f"density: {DENSITY}", "density: 900"))
    assert_refused(run, "--job", changed, because="states[0].effects[0].density: 963.0 -> 900.0")
