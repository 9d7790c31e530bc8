"""First solves that begin with the solution on coarser cells: answers, effort, and what happens where they cannot."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers import silicone_beam
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.errors import Interrupted
from hpcinv.job.job import Job
from hpcinv.model.outcome import Outcome
from hpcinv.output.result import Result
from hpcinv.solver.linear import selection
from hpcinv.solver.methods import nested_iteration
from hpcinv.solver.methods.method import NESTED
from hpcinv.solver.newton import Solve
from hpcinv.trust.certificate.limit_points import LIMIT_POINTS

SIGN = nested_iteration._sign

CUBOID = """
from hpcinv.base.quantity import Length, Size

def build(gmsh, *, length: Length = 3.0, thickness: Length = 1.0, size: Size = 0.4):
    occ = gmsh.model.occ
    occ.addBox(0, 0, 0, length, thickness, thickness)
    occ.synchronize()
    for _, surface in gmsh.model.getEntities(2):
        x = occ.getCenterOfMass(2, surface)[0] / length
        name = "clamp" if x < 0.01 else "end" if x > 0.99 else f"side{surface}"
        gmsh.model.addPhysicalGroup(2, [surface], name=name)
    gmsh.model.addPhysicalGroup(3, [1], name="cuboid")
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    gmsh.model.mesh.generate(3)
"""


def beam(size: str, analysis: str = "inverse", file: Path | str = "../meshes/pdms_beam.py", **solver: Any) -> Job:
    """The silicone beam under its weight, which it turns by more than a radian."""
    shipped = silicone_beam.beam(size)
    own = {} if file == shipped["mesh"]["file"] else {"length": "182 mm", "thickness": "7.5 mm"}
    return job(
        analysis=analysis,
        **shipped
        | {"mesh": {"file": str(file), "parameters": {"size": size} | own, "geometry_degree": 1 if own else 2}},
        certificate="quick",
        solver=solver,
    )


@pytest.fixture
def bar(run_directory: Path, comm: MPI.Intracomm) -> Callable[..., Job]:
    """Maker of the job of a square beam, which needs few cells."""
    file = run_directory / "cuboid.py"
    on_root(comm, lambda: file.write_text(CUBOID))
    return partial(beam, "4 mm", file=file)


def strategies(result: Result) -> list[str]:
    return [solve.strategy for solve in result.solutions[0].solves]


def note_on_limit_points(result: Result) -> str:
    return next(line.note for line in result.certificate.lines if line.topic == LIMIT_POINTS)


def coarse_of(result: Result) -> nested_iteration.CoarseSolve:
    coarse = result.solutions[0].coarse
    assert coarse is not None
    return coarse


@pytest.mark.everyday("forward")
@pytest.mark.parallel([2, 1])
@pytest.mark.parametrize("analysis", ["inverse", "forward"])
def test_answer_is_the_same_with_fewer_factorizations(
    analysis: str, comm: MPI.Intracomm, bar: Callable[..., Job]
) -> None:
    alone, nested = (
        hpcinv.run(bar(analysis=analysis, nested_iteration=choice, continuation="steps"), comm)
        for choice in ("off", "on")
    )
    solution, coarse = nested.solutions[0], coarse_of(nested)
    print(
        f"{analysis}: {alone.solutions[0].factorizations} factorizations, after a solve on {coarse.unknowns} unknowns"
        f" {solution.factorizations}"
    )
    assert strategies(nested) == [NESTED]
    assert solution.factorizations <= 2
    assert alone.solutions[0].factorizations >= 3
    assert np.abs(nested.shape - alone.shape).max(initial=0.0) < 1e-10 * silicone_beam.LENGTH
    assert coarse.factorizations >= 3
    assert not coarse.unused
    assert note_on_limit_points(nested) == "the same sign at each load that was solved, on coarser cells along the path"
    assert note_on_limit_points(alone) == "the same sign at each load that was solved"
    assert nested.statistics["solutions"][0]["coarse"] == coarse.as_data()
    assert "coarse" not in alone.statistics["solutions"][0]


@pytest.mark.everyday("motion")
@pytest.mark.parametrize("unknown", ["motion", "pressure"])
def test_unknown_numbers_begin_as_on_coarser_cells(unknown: str, tmp_path: Path) -> None:
    (tmp_path / "cuboid.py").write_text(CUBOID)
    supports: list[dict[str, Any]] = [{"region": "clamp", "fix": ["x", "y", "z"]}]
    changed: dict[str, Any] = {"cavities": {"hole": {"surface": "end", "lid": {"apex": [4, 0.5, 0.5]}, "volume": 0.5}}}
    if unknown == "motion":
        load = {"about": [3, 0.5, 0.5], "force": [0, 0, -0.02]}
        changed = {"supports": [*supports, {"region": "end", "remote": load}]}
    alone, nested = (
        hpcinv.run(
            job(
                **{
                    "analysis": "forward",
                    "mesh": {"file": str(tmp_path / "cuboid.py")},
                    "material": {"law": "neo-hookean", "mu": 1.0, "lam": 2.0},
                    "supports": supports,
                    "solver": {"nested_iteration": choice},
                }
                | changed
            ),
            MPI.COMM_SELF,
        ).solutions[0]
        for choice in ("off", "on")
    )
    iterations = [sum(len(solve.iterations) for solve in solution.solves) for solution in (alone, nested)]
    print(iterations, [s.load for s in alone.solves], [[i.correction for i in s.iterations] for s in nested.solves])
    assert [solve.strategy for solve in nested.solves] == [NESTED]
    assert nested.solves[0].iterations[0].correction < 0.1 * nested.solves[0].iterations[0].state
    assert np.abs(nested.u - alone.u).max() < 1e-10 * np.abs(alone.u).max()


@pytest.mark.release
@pytest.mark.parametrize(
    ("displacement", "formulation"),
    [(1, "displacement"), (2, "mixed"), pytest.param(3, "displacement", marks=pytest.mark.release)],
)
def test_prescribed_displacements_agree_with_the_given_mesh(
    displacement: int, formulation: str, comm: MPI.Intracomm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A nonlinear field, which differs between the nodes of both meshes, of a body without pressures too."""
    (tmp_path / "cuboid.py").write_text(CUBOID)
    data: dict[str, Any] = {
        "analysis": "forward",
        "mesh": {"file": str(tmp_path / "cuboid.py"), "parameters": {"size": 0.8 if displacement == 3 else 0.5}},
        "material": {"law": "neo-hookean", "mu": "10 kPa", "lam": "100 kPa"},
        "supports": [
            {"region": "clamp", "fix": ["x", "y", "z"]},
            {"region": "end", "displacement": ["0.3 m", "z**3 / (1.4 m)**2", "-y**3 / (1.4 m)**2"]},
        ],
        "discretisation": {"formulation": formulation, "displacement": displacement},
        "certificate": "off",
    }
    guesses: list[Any] = []
    transferred = nested_iteration._transferred

    def keep(coarse: Any, model: Any, direction: Any, sign: int) -> Any:
        guess = transferred(coarse, model, direction, sign)
        guesses.append((model.supports.prescribed, model.scales.length, model.unknowns, guess))
        return guess

    monkeypatch.setattr(nested_iteration, "_transferred", keep)
    nested = hpcinv.run(job(**data, solver={"nested_iteration": "on"}), comm)
    alone = hpcinv.run(job(**data), comm)
    ((prescribed, length, unknowns, guess),) = guesses
    state = unknowns.state.x.array
    u, _ = unknowns.displacement(), None
    u.x.array[:] = guess.displacement / length
    unknowns.set_displacement(u.x.array)
    assert len(prescribed) == 6
    for entry in prescribed:
        assert np.abs(state[entry.dofs] - entry.full[entry.nodes]).max(initial=0.0) < 1e-15
    assert strategies(nested) == [NESTED]
    assert NESTED not in strategies(alone)
    assert np.abs(nested.shape - alone.shape).max(initial=0.0) < 1e-10


@pytest.mark.parametrize("choice", ["on", "auto"])
def test_a_mesh_that_is_not_coarser_is_not_used(
    choice: str, comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Numbers of divisions do not depend on sizes: by default no coarser mesh is made of them."""
    monkeypatch.setattr(selection, "_WORTH_NESTED", 0.0)
    result = hpcinv.run(
        job(
            mesh=box((20, 1, 1), lx=20.0),
            material={"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
            effects=[{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 0.1}],
            supports=[{"region": "x0", "fix": ["x", "y", "z"]}],
            certificate="off",
            solver={"nested_iteration": choice},
        ),
        comm,
    )
    assert strategies(result) == ["load steps"]
    if choice == "auto":
        assert result.solutions[0].coarse is None
    else:
        assert coarse_of(result).unused == "its generator makes 120 coarser cells instead of 120"
        assert coarse_of(result).unknowns == 0


@pytest.mark.release
def test_a_mesh_with_inverted_cells_is_not_used(comm: MPI.Intracomm) -> None:
    """Cells of 6 mm cannot follow the curved side of the beam."""
    result = hpcinv.run(beam("3 mm", nested_iteration="on"), comm)
    assert "cells are inverted" in coarse_of(result).unused
    assert coarse_of(result).unknowns == 0
    assert NESTED not in strategies(result)


@pytest.mark.everyday(
    "not reached-the load was not reached there: Newton's method took too many iterations",
    "sign-the solution found there does not belong to the path from the unloaded body",
)
@pytest.mark.parametrize(
    ("fault", "text"),
    [
        ("not reached", "the load was not reached there: Newton's method took too many iterations"),
        ("effort", "the load was not reached there: Newton's method took too many iterations"),
        ("limit point", "the path has a limit point there"),
        ("sign", "the solution found there does not belong to the path from the unloaded body"),
    ],
)
@pytest.mark.parallel([2, 1])
def test_without_a_solution_on_coarser_cells_the_unloaded_body_is_the_start(
    fault: str, text: str, comm: MPI.Intracomm, bar: Callable[..., Job], monkeypatch: pytest.MonkeyPatch
) -> None:
    on_coarser_cells = nested_iteration._coarse_job

    def hasty(given: Job) -> Job:
        changed = on_coarser_cells(given)
        least = {"maximum_iterations": 2, "minimum_step": 1.0 if fault == "not reached" else 1e-6}
        return changed.model_copy(update={"solver": changed.solver.model_copy(update=least)})

    def turned(solves: Any, model: Any, coarse: Any) -> tuple[int, str]:
        sign, why = SIGN(solves, model, coarse)
        return -sign, why

    def with_limit_point(solves: Any, model: Any, coarse: Any) -> tuple[int, str]:
        first: Solve = solves[0]
        other = Solve(0.5, first.outcome, first.iterations, 1, tuple(-sign for sign in first.signs))
        return SIGN([other, *solves], model, coarse)

    if fault in ("not reached", "effort"):
        monkeypatch.setattr(nested_iteration, "_coarse_job", hasty)
        monkeypatch.setattr(nested_iteration, "_EFFORT", 2)
    else:
        monkeypatch.setattr(nested_iteration, "_sign", turned if fault == "sign" else with_limit_point)
    result = hpcinv.run(bar(nested_iteration="on"), comm)
    assert coarse_of(result).unused == text
    assert strategies(result)[-1] == "load steps"
    assert (strategies(result)[0] == NESTED) == (fault == "sign")
    assert result.solutions[0].load == 1.0
    assert note_on_limit_points(result) == "the same sign at each load that was solved"


def test_an_unloaded_body_stays_where_it_is(comm: MPI.Intracomm, bar: Callable[..., Job]) -> None:
    result = hpcinv.run(bar(nested_iteration="on").model_copy(update={"effects": ()}), comm)
    assert strategies(result) == [NESTED]
    assert result.solutions[0].largest_displacement == 0.0


@pytest.mark.parametrize(
    ("configuration", "signs", "expected"),
    [
        ("direct", [(1,), (1, 1)], (-1, "")),  # 7 pressures here and 4 there
        ("direct", [(1,), (1, -1)], (0, "the path has a limit point there")),
        ("direct", [(), ()], (0, "no sign of the tangent's determinant is known there")),
        ("iterative", [(), ()], (0, "")),
    ],
)
def test_the_sign_to_expect_follows_from_the_path(
    configuration: str, signs: list[tuple[int, ...]], expected: tuple[int, str]
) -> None:
    def model(pressures: int) -> Any:
        choice = SimpleNamespace(configuration=configuration)
        return SimpleNamespace(
            unknowns=SimpleNamespace(unloaded_sign=(-1) ** pressures),
            chooser=SimpleNamespace(choose=lambda _: choice),
            job=SimpleNamespace(solver=None),
        )

    solves = [Solve(1.0, Outcome.CONVERGED, (), 1, of_solve) for of_solve in signs]
    assert SIGN(solves, model(7), model(4)) == expected


@pytest.mark.release
def test_an_iterative_solver_knows_no_sign_on_either_mesh(comm: MPI.Intracomm, bar: Callable[..., Job]) -> None:
    result = hpcinv.run(bar(nested_iteration="on", linear="iterative"), comm)
    assert strategies(result) == [NESTED]
    assert note_on_limit_points(result).startswith("an iterative solver does not provide")


@pytest.mark.release
def test_nested_iteration_is_the_default_where_it_is_forecast_to_pay(
    comm: MPI.Intracomm, bar: Callable[..., Job], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert hpcinv.run(bar(), comm).solutions[0].coarse is None  # the body is small
    monkeypatch.setattr(selection, "_WORTH_NESTED", 0.0)
    assert hpcinv.run(bar(), comm).solutions[0].coarse is None  # cells twice as large are too coarse
    monkeypatch.setattr(selection, "SINGLE", 0.0)
    assert strategies(hpcinv.run(bar(), comm)) == [NESTED]
    assert strategies(hpcinv.run(bar(strategy="fixed", steps=4), comm)) == ["load steps"] * 4


@pytest.mark.everyday("5")
@pytest.mark.parallel([2])
@pytest.mark.parametrize("after", [5, 8])  # three requests come before: after the mesh, after the model, before this
def test_a_request_to_stop_ends_the_run_within_the_coarse_solve(
    after: int, comm: MPI.Intracomm, bar: Callable[..., Job]
) -> None:
    calls = 0

    def stop_asked() -> bool:
        nonlocal calls
        calls += 1
        return calls >= after and comm.rank == 1

    with pytest.raises(Interrupted, match="stopped by a signal in the inverse solve at load factor 0"):
        hpcinv.run(bar(nested_iteration="on"), comm, stop_asked=stop_asked)
    assert calls <= after + 2
