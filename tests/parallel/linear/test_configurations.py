"""The two linear solvers: same answers, what distinguishes them, and what happens if one fails."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import BLOCK, hpcinv_here, write_job
from helpers.linear_cases import BEAM, MATERIALS, SHELF
from helpers.silicone_beam import LENGTH
from helpers.verification import Solved, job
from petsc4py import PETSc

import hpcinv.solver.linear.selection
from hpcinv import run
from hpcinv.base.parallel.petsc_vectors import norm
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.errors import SolveError
from hpcinv.model.assembly.system import System
from hpcinv.output.progress import SilentProgress
from hpcinv.output.result import Result
from hpcinv.solver.linear.selection import Choice
from hpcinv.solver.linear_solver import LinearSolver


def both(comm: MPI.Intracomm, **data: Any) -> tuple[Result, Result]:
    """The same job with either solver, and no other strategy to help."""
    direct, iterative = (run(job(**data, solver={"linear": name, "rescue": []}), comm) for name in PRESETS)
    assert direct.statistics["solutions"][0]["linear"]["iterations"] == 0
    used = iterative.statistics["solutions"][0]["linear"]
    assert used["configuration"] == "iterative"
    assert used["fallback"] is None
    return direct, iterative


PRESETS = ("direct", "iterative")


@pytest.mark.release
@pytest.mark.parallel([2])
@pytest.mark.parametrize(("material", "analysis"), list(itertools.product(MATERIALS, ["inverse", "forward"])))
def test_both_linear_solver_presets_give_the_same_answer(material: str, analysis: str, comm: MPI.Intracomm) -> None:
    agree_on(material, analysis, comm)


@pytest.mark.release
@pytest.mark.parallel([1, 3, 2])
def test_configurations_solve_on_any_number_of_ranks(comm: MPI.Intracomm) -> None:
    agree_on("nearly incompressible", "inverse", comm)


def agree_on(material: str, analysis: str, comm: MPI.Intracomm) -> None:
    direct, iterative = both(comm, **SHELF, material=MATERIALS[material], analysis=analysis)
    size = direct.solutions[0].largest_displacement
    assert size > 0.05
    difference = np.abs(direct.shape - iterative.shape).max(initial=0.0)
    assert comm.allreduce(difference, op=MPI.MAX) < 1e-10 * size
    solution = iterative.solutions[0]
    corrections = sum(len(s.iterations) for s in solution.solves)
    assert sum(s.linear_iterations for s in solution.solves) < 45 * corrections  # whatever the ratio of the moduli is


@pytest.mark.everyday("inverse")
@pytest.mark.parametrize("analysis", ["inverse", "forward"])
def test_a_slender_body_that_turns_far_is_solved_iteratively(analysis: str, comm: MPI.Intracomm) -> None:
    direct, iterative = both(comm, **BEAM, analysis=analysis)
    assert np.abs(direct.shape - iterative.shape).max() < 1e-9 * LENGTH
    assert [s.load for s in iterative.solutions[0].solves] == [1.0]


@pytest.mark.release
@pytest.mark.parallel([1, 2])
def test_a_chosen_solver_that_fails_is_replaced_and_the_summary_says_so(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hpcinv.solver.linear.selection, "_WORTH", 0.0)  # multigrid is chosen
    result = run(job(**SHELF, material=MATERIALS["incompressible"], solver={"petsc": {"ksp_max_it": 3}}), comm)
    used = result.statistics["solutions"][0]["linear"]
    assert used["configuration"] == "direct"
    assert used["fallback"] == "the iterative solver did not converge: direct from there on"
    monkeypatch.undo()
    right = run(job(**SHELF, material=MATERIALS["incompressible"]), comm)
    assert np.abs(result.shape - right.shape).max(initial=0.0) < 1e-10


def test_a_solver_that_the_job_names_is_not_exchanged(tmp_path: Path) -> None:
    path = write_job(tmp_path / "job.yaml", BLOCK, solver={"linear": "iterative", "petsc": {"ksp_max_it": 1}})
    done = hpcinv_here("run", path, cwd=tmp_path)
    assert done.returncode == 3
    assert "inverse:\n  iterative linear solver: the job asks for it\n" in done.stdout
    assert "from there on" not in done.stdout
    assert "the iterative linear solver failed" in done.stderr
    assert "Leave out 'solver: {linear: iterative}'" in done.stderr


@pytest.mark.release
@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("material", ["compressible", "incompressible"])
def test_a_preconditioner_is_as_good_for_a_later_tangent_as_for_the_first(material: str, comm: MPI.Intracomm) -> None:
    """PETSc keeps what it once inverted of a matrix: nothing of an earlier tangent may be left in a later one's."""
    solved = Solved(job(**SHELF, material=MATERIALS[material], analysis="inverse"), comm)
    state = solved.model.unknowns.state.x.array.copy()

    def found(*, again: bool) -> tuple[int, float]:
        """Iterations, and a norm of what the finest smoother makes of ones."""
        system = System(solved.weak_form, solved.model.supports, Timings())
        linear = LinearSolver(system, {}, Choice("iterative", ""))
        if again:
            system.state.x.array[:] = 0.0
            system.linearise(0.0)
            linear.factorize()
        system.state.x.array[:] = 1.5 * state  # farther than it goes in truth: blocks that differ much from the first
        system.linearise(1.0)
        system.residual(system.rhs)
        linear.take_iterations()
        x = system.rhs.duplicate()
        assert linear.solve(system.rhs, x)
        x.destroy()
        pc = linear.ksp.pc if material == "compressible" else linear.ksp.pc.getPythonContext().displacements
        smoother = pc.getMGSmoother(pc.getMGLevels() - 1)
        ones, smooth = smoother.getOperators()[1].createVecs()
        ones.set(1.0)
        smoother.pc.apply(ones, smooth)
        size = norm(smooth)
        ones.destroy()
        smooth.destroy()
        iterations = linear.take_iterations()
        linear.destroy()
        system.destroy()
        return iterations, size

    (first, size), (later, again) = found(again=False), found(again=True)
    print(f"{first} and {later} iterations, smoothed {size:.6g} and {again:.6g}")
    assert abs(later - first) <= 1  # sums of ranks are rounded differently
    assert again == pytest.approx(size, rel=1e-9)


def test_krylov_iterations_of_a_solve_are_bounded_and_the_direct_solver_takes_over(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hpcinv.solver.linear.selection, "_PATIENCE", 0.2)
    monkeypatch.setattr(hpcinv.solver.linear.selection, "_WORTH", 0.0)  # multigrid is chosen
    data = SHELF | {"material": MATERIALS["incompressible"]}
    result = run(job(**data), comm)
    used = result.statistics["solutions"][0]["linear"]
    assert used["fallback"] == "the iterative solver did not converge: direct from there on"
    assert 0 < used["iterations"] < 100
    right = run(job(**data, solver={"linear": "direct"}), comm)
    assert np.abs(result.shape - right.shape).max(initial=0.0) < 1e-10


def test_without_memory_for_another_solver_it_ends_with_a_diagnosis(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hpcinv.solver.linear.selection, "_PATIENCE", 0.02)
    monkeypatch.setattr(hpcinv.solver.linear.selection, "available", lambda comm: 1e5)
    progress = SilentProgress(comm)
    with pytest.raises(SolveError, match="the iterative linear solver failed; the direct one is excluded"):
        run(job(**SHELF, material=MATERIALS["incompressible"]), comm, progress=progress)
    (solution,) = progress.statistics["solutions"]
    assert {solve["outcome"] for solve in solution["solves"]} == {"KRYLOV_LIMIT"}
    assert solution["linear"]["iterations"] < 300
    assert {solve["strategy"] for solve in solution["solves"]} == {"load steps"}  # others would do no better


def factor_type(comm: MPI.Intracomm, **data: Any) -> str:
    solved = Solved(job(**data), comm)
    equilibrium = solved.model.equilibrium(solved.weak_form)
    equilibrium.system.linearise(1.0)
    equilibrium.linear.factorize()
    kind: str = equilibrium.linear.ksp.pc.getType()
    equilibrium.destroy()
    return kind


@pytest.mark.release
@pytest.mark.parallel([1, 2])
def test_only_symmetric_tangents_are_factorized_as_such(comm: MPI.Intracomm) -> None:
    material = MATERIALS["compressible"]
    assert factor_type(comm, **SHELF, material=material, analysis="forward") == PETSc.PC.Type.CHOLESKY
    assert factor_type(comm, **SHELF, material=material, analysis="inverse") == PETSc.PC.Type.LU
    follower = {"effect": "pressure", "region": "x1", "pressure": 200}  # its edges make it non-conservative
    pressed = SHELF | {"effects": [*SHELF["effects"], follower]}
    assert factor_type(comm, **pressed, material=material, analysis="forward") == PETSc.PC.Type.LU
