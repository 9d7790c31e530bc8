"""Options that PETSc refuses, or with which it fails: one message from one rank, and nothing computed lost."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from helpers.command_line import BLOCK, CUBE, hpcinv, hpcinv_here, write_job
from petsc4py import PETSc

from hpcinv import load, run
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import JobError, MeshError
from hpcinv.output.result import Result
from hpcinv.solver.linear.factorization import Direct

REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"petsc": {"ksp_type": "nonsense"}}, "PETSc refuses 'ksp_type: nonsense': Unable to find requested KSP type"),
    ({"petsc": {"pc_type": "nonsense"}}, "PETSc refuses 'pc_type: nonsense': Unable to find requested PC type"),
    ({"petsc": {"snes_type": "nonsense"}}, "PETSc refuses 'snes_type: nonsense': Unable to find requested SNES type"),
    (
        {"petsc": {"ksp_type": "cg", "ksp_rtol": "abc"}},
        "PETSc refuses 'ksp_rtol: abc': Input string abc has no numeric",
    ),
    ({"petsc": {"pc_factor_mat_solver_type": "superlu"}}, "PETSc refuses 'pc_factor_mat_solver_type: superlu': "),
    ({"petsc": {"snes_type": "fas"}}, "PETSc fails with 'snes_type: fas': "),
    (
        {"linear": "iterative", "petsc": {"mg_levels_ksp_type": "bogus"}},
        "PETSc refuses 'mg_levels_ksp_type: bogus': Unable to find requested KSP type",
    ),
]


def solved(result: Result) -> bool:
    return bool(result.statistics["status"] == "converged")


@pytest.mark.everyday("pc_factor_mat_solver_type", "snes_type1", "mg_levels_ksp_type")
@pytest.mark.parametrize(("solver", "message"), REFUSED, ids=[next(reversed(s["petsc"])) for s, _ in REFUSED])
def test_the_message_names_the_option_and_the_next_job_is_free_of_it(solver: dict[str, Any], message: str) -> None:
    block = {**BLOCK, "analysis": "inverse"}
    with pytest.raises(JobError) as caught:
        run(load({**block, "solver": solver}), MPI.COMM_SELF)
    (problem,) = caught.value.problems
    assert problem.startswith(f"(mapping): solver.petsc: {message}")
    assert "https" not in problem
    assert "remove" in problem
    assert solved(run(load({**block, "solver": {"petsc": {"snes_max_it": 100}}}), MPI.COMM_SELF))


@pytest.mark.everyday("LDL-petsc-1", "LDL-superlu-1")
@pytest.mark.parametrize("ranks", [1, 2])
@pytest.mark.parametrize("package", ["mumps", "petsc", "superlu", "superlu_dist"])
@pytest.mark.parametrize("analysis", ["forward", "inverse"], ids=["LDL", "LU"])
def test_the_jobs_package_factorizes_or_is_refused(package: str, ranks: int, analysis: str, tmp_path: Path) -> None:
    """Symmetric tangents were factorized by MUMPS whatever the job named; which packages there are depends on PETSc."""
    option = f"pc_factor_mat_solver_type: {package}"
    petsc = {"pc_factor_mat_solver_type": package, "ksp_view": None}
    job = write_job(tmp_path / "job.yaml", BLOCK, analysis=analysis, solver={"petsc": petsc})
    arguments = ("run", job, "--output", "out")
    done = hpcinv_here(*arguments, cwd=tmp_path) if ranks == 1 else hpcinv(ranks, *arguments, cwd=tmp_path)
    if done.returncode == 0:
        matches = re.findall(r"package used to perform factorization: (\w+)", done.stdout)
        assert set(matches) == {package}
        assert (package == "mumps") != ("with pc_factor_mat_solver_type of solver.petsc" in done.stdout)
    else:
        assert package != "mumps"
        assert done.returncode == 2, done.stderr
        assert done.stderr.startswith(f"{job}: solver.petsc: PETSc refuses '{option}': ")
        assert len(done.stderr.splitlines()) == 1
        assert {path.name for path in tmp_path.iterdir()} == {"job.yaml"}


@pytest.mark.everyday("at the beginning")
@pytest.mark.parametrize("number", [0, 6], ids=["at the beginning", "at the first tangent"])
@pytest.mark.parallel([1, 2])
def test_the_message_is_reported_once_and_no_directory_is_left(number: int, run_directory: Path) -> None:
    solver, message = REFUSED[number]
    write_job(run_directory / "job.yaml", CUBE, solver=solver)
    done = hpcinv_here("run", "job.yaml", "--output", "out", cwd=run_directory)
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith(f"job.yaml: solver.petsc: {message}")
    assert len(done.stderr.splitlines()) == 1
    assert {path.name for path in run_directory.iterdir()} == {"job.yaml"}


def test_a_mesh_that_turns_out_to_be_wrong_after_the_directory_was_made_leaves_none(tmp_path: Path) -> None:
    springs = {"effect": "elastic-foundation", "region": "z0", "normal": "100 kPa/m"}
    free = load({**BLOCK, "supports": [], "effects": [*BLOCK["effects"], springs]})
    with pytest.raises(MeshError, match="leave the body free to move"):
        run(free, MPI.COMM_SELF, directory=tmp_path / "out")
    assert not (tmp_path / "out").exists()
    (tmp_path / "out").mkdir()  # it is someone else's
    with pytest.raises(MeshError, match="leave the body free to move"):
        run(free, MPI.COMM_SELF, directory=tmp_path / "out")
    assert (tmp_path / "out" / "job.yaml").exists()


def _fail_at(number: int, monkeypatch: pytest.MonkeyPatch, act: Callable[[PETSc.KSP], object]) -> None:
    """Do something wrong before one of the factorizations."""
    prepare, calls = Direct.prepare, itertools.count(1)

    def failing(self: Direct, ksp: PETSc.KSP, matrix: PETSc.Mat) -> None:
        prepare(self, ksp, matrix)
        if next(calls) == number:
            act(ksp)

    monkeypatch.setattr(Direct, "prepare", failing)


def _set_no_type(ksp: PETSc.KSP) -> None:
    ksp.pc.setType("nonsense")


STEPWISE: dict[str, Any] = {"strategy": "fixed", "steps": 3, "reuse_tangent": False}
OWN = {"ksp_max_it": 7, "snes_max_it": 99}


def test_a_failure_on_the_way_keeps_what_was_computed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stepwise = load({**CUBE, "solver": {**STEPWISE, "petsc": OWN}})
    _fail_at(6, monkeypatch, _set_no_type)
    with pytest.raises(JobError, match=r"PETSc fails with 'ksp_max_it: 7', 'snes_max_it: 99': .*PC type nonsense"):
        run(stepwise, MPI.COMM_SELF, directory=tmp_path / "out")
    monkeypatch.undo()
    assert list((tmp_path / "out" / "checkpoints").iterdir())
    assert solved(run(stepwise, MPI.COMM_SELF, directory=tmp_path / "out", resume=True))


def test_an_error_of_petsc_without_options_of_the_job_stays_what_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    _fail_at(1, monkeypatch, _set_no_type)
    with pytest.raises(PETSc.Error) as caught:
        run(load({**CUBE, "solver": STEPWISE}), MPI.COMM_SELF)
    assert isinstance(caught.value.__cause__, PETSc.Error)  # raised in a function that PETSc calls


def test_other_errors_in_a_function_that_petsc_calls_are_not_put_down_to_options(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stepwise = load({**CUBE, "solver": {**STEPWISE, "petsc": OWN}})

    def fail(_ksp: PETSc.KSP) -> None:
        raise KeyError("a fault of this program")

    _fail_at(6, monkeypatch, fail)
    with pytest.raises(PETSc.Error) as caught:
        run(stepwise, MPI.COMM_SELF)
    assert isinstance(caught.value.__cause__, KeyError)
    monkeypatch.undo()

    def refuse(_ksp: PETSc.KSP) -> None:
        raise MeshError("a mesh that turns out to be wrong")

    _fail_at(6, monkeypatch, refuse)
    with pytest.raises(MeshError, match="turns out to be wrong"):
        run(stepwise, MPI.COMM_SELF)
