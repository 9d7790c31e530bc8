"""The certificate: each of its lines against what is known otherwise, and what it does to exit code and summary."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers import silicone_beam
from helpers.certificate_cases import ESTIMATE, column, line
from helpers.closed_forms import root
from helpers.command_line import NO_CERTIFICATE, ROOT, write_job
from helpers.command_line import hpcinv_here as command
from helpers.thick_sphere import PRESSURE, carried, outer_radius, sphere
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.mesh import build_body
from hpcinv.output.result import Result
from hpcinv.results.solution import solution_of
from hpcinv.solver.equations import Equations
from hpcinv.trust.certificate import Line, Verdict, lower_bound_line, upper_bound_line
from hpcinv.trust.certificate.check import Certificate
from hpcinv.trust.certificate.discretisation import DISCRETISATION
from hpcinv.trust.certificate.equilibrium_residual import equilibrium_residual
from hpcinv.trust.certificate.shape import cells


def cantilever(geometry_degree: int, certificate: dict[str, Any]) -> Any:
    return job(
        mesh=box((3, 1, 1), lx=3.0) | {"geometry_degree": geometry_degree},
        material={"law": "neo-hookean", "young": "10 kPa", "poisson": 0.3},
        effects=[{"effect": "gravity", "acceleration": [0, 0, -0.3], "density": 1000}],
        supports=[{"region": "x0", "fix": ["x", "y", "z"]}],
        certificate=certificate,
    )


def effectivities(result: Result, exact: dict[str, float]) -> dict[str, float]:
    assert result.estimate is not None
    return {name: result.estimate.quantities[name] / (value - result.quantities[name]) for name, value in exact.items()}


@pytest.mark.everyday("2-False")
@pytest.mark.parametrize(("divisions", "hexahedra"), [(2, True), (4, True), (2, False), (4, False)])
def test_the_error_of_the_sphere_is_estimated(divisions: int, hexahedra: bool, comm: MPI.Intracomm) -> None:
    A = root(lambda A: carried(A, 0.5, 0.0) - PRESSURE, 0.5, 1.0)
    ratios = effectivities(hpcinv.run(sphere(divisions, hexahedra), comm), {"inner": A, "outer": outer_radius(A)})
    print(f"{divisions} divisions, hexahedra {hexahedra}: effectivity {ratios}")
    assert all(0.5 < value < 2 for value in ratios.values())


@pytest.mark.everyday("4")
@pytest.mark.parametrize("divisions", [2, 4, 8])
def test_the_error_of_the_column_is_estimated(divisions: int, comm: MPI.Intracomm) -> None:
    ratios = effectivities(hpcinv.run(column(divisions), comm), {"length": 1.0802799})
    print(f"{divisions} divisions: effectivity {ratios}")
    assert 0.5 < ratios["length"] < 2


@pytest.mark.release
@pytest.mark.parallel([2, 1])
def test_the_error_of_the_beam_is_estimated(comm: MPI.Intracomm) -> None:
    """The exact tip is taken from cubic displacements."""

    cubic = hpcinv.run(job(**silicone_beam.sagging(silicone_beam.SIZE, 3, NO_CERTIFICATE)), comm)
    quadratic = hpcinv.run(job(**silicone_beam.sagging(silicone_beam.SIZE, 2, ESTIMATE)), comm)
    exact = cubic.quantities["tip"]
    ratios = effectivities(quadratic, {"tip": exact})
    print(f"{comm.size} rank(s): exact {exact:.6f} m, effectivity {ratios}")
    assert 0.5 < ratios["tip"] < 2


def locked(comm: MPI.Intracomm, certificate: Any = ESTIMATE, degree: int = 1) -> Result:
    """A slender cantilever, whose linear hexahedra lock: at equal sides, shear takes nearly all of its bending."""
    return hpcinv.run(
        job(
            analysis="forward",
            mesh=box((6, 1, 1), lx=12.0),
            material={"law": "neo-hookean", "young": "10 kPa", "poisson": 0.3},
            effects=[{"effect": "gravity", "acceleration": [0, 0, -0.02], "density": 1000}],
            supports=[{"region": "x0", "fix": ["x", "y", "z"]}],
            quantities=[{"name": "tip", "of": "uz", "on": "x1", "reduce": "mean"}],
            discretisation={"displacement": degree, "formulation": "displacement"},
            certificate=certificate,
        ),
        comm,
    )


@pytest.mark.parallel([2, 1])
def test_a_failure_is_an_error_that_was_found(comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch) -> None:
    """Beyond the range of one Newton step the finer problem is solved; without its solution nothing fails."""
    coarse = locked(comm)
    assert coarse.estimate is not None
    assert coarse.estimate.is_solved
    assert line(coarse, DISCRETISATION.name).verdict is Verdict.FAIL
    exact = locked(comm, NO_CERTIFICATE, degree=2).quantities["tip"]
    assert coarse.estimate.corrected["tip"] == pytest.approx(exact, rel=1e-6)
    for name in ("SHARE", "LEAST"):
        monkeypatch.setattr(f"hpcinv.trust.discretisation.finer_problem.{name}", 0.0)
    coarse = locked(comm)
    assert coarse.estimate is not None
    assert coarse.estimate.is_too_dear
    assert not coarse.estimate.is_solved
    assert line(coarse, DISCRETISATION.name).verdict is Verdict.UNDECIDED
    assert "raise discretisation.displacement" in line(coarse, DISCRETISATION.name).note
    assert coarse.estimate.corrected["tip"] != pytest.approx(exact, rel=1e-3)
    # Given up on the way, which leaves no trace.
    monkeypatch.setattr("hpcinv.trust.discretisation.finer_problem.FinerProblem.tangents_allowed", lambda *_: 1)
    again = locked(comm)
    assert again.estimate is not None
    assert again.estimate.is_too_dear
    assert again.estimate.corrected == coarse.estimate.corrected


def test_the_estimate_says_where_the_error_is(comm: MPI.Intracomm) -> None:
    """A cantilever bends most at its clamp, and the clamp's edges are sharp."""
    result = hpcinv.run(cantilever(1, ESTIMATE), comm)
    assert result.estimate is not None
    mesh = result.body.mesh
    corners = mesh.geometry.x[mesh.geometry.dofmaps[0][: mesh.topology.index_map(3).size_local]]
    x = corners.mean(axis=1)[:, 0] * result.body.length_scale
    clamped, free = (result.estimate.cells[where].sum() for where in (x < 1, x > 2))
    assert clamped > 5 * free > 0


@pytest.mark.everyday("displacement-8.7-2", "mixed-9.5-4")
@pytest.mark.parametrize(("share", "unstable"), [(0.97, 0), (1.05, 2), (8.7, 2), (9.5, 4)])
@pytest.mark.parametrize("formulation", ["displacement", "mixed"])
def test_a_column_beyond_its_euler_load_is_unstable(
    share: float, unstable: int, formulation: str, comm: MPI.Intracomm
) -> None:
    """Clamped below and free above, it buckles at ``(2n - 1)² π² E I/4 L²``, to both sides of its square section."""
    length, side, young = 1.0, 0.02, 1e6
    euler = np.pi**2 * young * side**4 / 12 / (4 * length**2)
    result = hpcinv.run(
        job(
            mesh=box((1, 1, 10), lx=side, ly=side, lz=length, hexahedra=True),
            material={"law": "neo-hookean", "young": young, "poisson": 0.0 if formulation == "displacement" else 0.3},
            effects=[
                {
                    "effect": "traction",
                    "region": "z1",
                    "area_in": "reference",
                    "traction": [0, 0, float(-share * euler / side**2)],
                }
            ],
            supports=[{"region": "z0", "fix": ["x", "y", "z"]}],
            discretisation={"formulation": formulation},
            certificate=NO_CERTIFICATE | {"stability": True},
        ),
        comm,
    )
    stability = line(result, "stability")
    print(f"{share} of Euler's load: {stability.value:.0f} negative eigenvalues, {stability.verdict.value}")
    assert stability.value == unstable
    assert result.certificate.verdict is (Verdict.FAIL if unstable else Verdict.PASS)


def test_forces_balance(comm: MPI.Intracomm) -> None:
    column_job = column(4)
    model = Equations(
        column_job, build_body(column_job.mesh, column_job.regions, comm, resolve=column_job.resolve), Timings()
    )
    equilibrium = model.equilibrium(model.weak_form("inverse"))
    (unloaded,) = equilibrium_residual(model, solution_of(model, "inverse", model.weak_form("inverse"), ()))
    # Undeformed, all of the weight is unbalanced but what the supports carry at once.
    weight, held = equilibrium.system.forces(1.0), model.supports.prescribed
    free = np.setdiff1d(np.arange(len(weight)), np.concatenate([part.dofs for part in held]))
    assert unloaded.value == pytest.approx(np.linalg.norm(weight[free]) / np.linalg.norm(weight))
    assert unloaded.verdict is Verdict.FAIL
    assert equilibrium.solve(1.0, 1e-12).outcome.accepted
    (loaded,) = equilibrium_residual(model, solution_of(model, "inverse", model.weak_form("inverse"), ()))
    assert loaded.value is not None
    assert loaded.value < 1e-10
    equilibrium.destroy()


@pytest.mark.everyday("near-1", "path-2")
@pytest.mark.parametrize("geometry_degree", [1, 2])
@pytest.mark.parametrize("start", ["near", "path"])
def test_the_return_solve_closes_on_straight_cells_too(start: str, geometry_degree: int, comm: MPI.Intracomm) -> None:
    """The computed body has the degree of the displacement, whatever degree the given cells have."""
    result = hpcinv.run(cantilever(geometry_degree, NO_CERTIFICATE | {"round_trip": start}), comm)
    closure = line(result, "round trip")
    assert closure.value is not None
    assert closure.value < 1e-10
    assert closure.verdict is Verdict.PASS


def test_a_return_solve_that_fails_is_not_decided(comm: MPI.Intracomm) -> None:
    """A soft block carries itself in the shape that is given; Newton's method does not find the path to it."""
    result = hpcinv.run(
        job(
            mesh=box((1, 1, 2), lx=2.0, ly=2.0, lz=2.0) | {"geometry_degree": 2},
            material={"law": "neo-hookean", "mu": "2 kPa", "lam": "80 kPa"},
            effects=[{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 800}],
            supports=[{"region": "z0", "fix": ["x", "y", "z"]}],
            discretisation={"formulation": "mixed"},
            certificate=NO_CERTIFICATE | {"round_trip": "path"},
        ),
        comm,
    )
    closure = line(result, "round trip")
    assert closure.verdict is Verdict.UNDECIDED
    assert "stopped at load factor" in closure.note


@pytest.mark.everyday("1")
@pytest.mark.parametrize("geometry_degree", [1, 2])
def test_fixed_points_are_equilibria_on_straight_cells_too(geometry_degree: int, comm: MPI.Intracomm) -> None:
    beam_job = job(
        mesh=box((4, 2, 2), lx=1.0, ly=0.3, lz=0.3) | {"geometry_degree": geometry_degree},
        material={"law": "neo-hookean", "young": 1e6, "poisson": 0.3},
        effects=[{"effect": "gravity", "acceleration": [0, 0, -1], "density": 1000}],
        supports=[{"region": "x0", "fix": ["x", "y", "z"]}],
        method="sellier",
        certificate="quick",
    )
    residual = hpcinv.run(beam_job, comm).certificate.lines[0]
    print(residual)
    assert residual.verdict is Verdict.PASS


def test_a_body_that_hangs_next_to_its_rest_does_not_fail(comm: MPI.Intracomm) -> None:
    """The support may be a plane of symmetry or a rest that ends there: nothing in the job says which."""
    block = job(
        mesh=box((2, 2, 2)),
        material={"law": "neo-hookean", "mu": 1.0, "lam": 4.0},
        supports=[{"region": "x1", "fix": ["x", "y", "z"]}, {"region": "z0", "fix": ["z"]}],
    )
    body = build_body(block.mesh, {}, comm, resolve=block.resolve)
    given = body.mesh.geometry.x * body.length_scale
    moved = given - [0.0, 0.0, 0.3]
    solution: Any = SimpleNamespace(job=block, is_on_given_mesh=True, mesh_nodes=given, other_nodes=moved)
    lines = cells(Equations(block, body, Timings()), solution)
    (depth,) = (entry for entry in lines if entry.name.startswith("depth beyond"))
    assert depth.verdict is Verdict.WARN
    assert "unless this is a wall" in depth.note
    assert "fail" not in depth.rule


def test_verdicts_follow_bounds_and_the_worst_line() -> None:
    nan = float("nan")
    assert [upper_bound_line(DISCRETISATION, v, 1, 2).verdict.value for v in (1, 1.5, 2.5, nan)] == [
        "pass",
        "warning",
        "fail",
        "fail",
    ]
    assert [lower_bound_line(DISCRETISATION, v, 2, 1).verdict.value for v in (2, 1.5, 1, nan)] == [
        "pass",
        "warning",
        "fail",
        "fail",
    ]
    lines = [Line(DISCRETISATION, None, "", "", verdict) for verdict in Verdict]
    assert [Certificate(tuple(lines[:n])).verdict.value for n in (0, 1, 2, 3, 4, 5)] == [
        "not checked",
        "pass",
        "pass",
        "not decided",
        "warning",
        "fail",
    ]
    with pytest.raises(ValueError, match="excellent"):
        Verdict("excellent")
    assert [v.exit_code() for v in Verdict] == [0, 0, 0, 0, 6]
    assert [v.exit_code(strict=True) for v in Verdict] == [0, 0, 7, 7, 6]


COLUMN: dict[str, Any] = {
    "analysis": "forward",
    "mesh": {"file": str(ROOT / "meshes" / "box.py"), "parameters": {"lx": 0.1, "ly": 0.1, "nx": 1, "ny": 1, "nz": 2}},
    "material": {"law": "neo-hookean", "young": 1e6, "poisson": 0.0},
    "supports": [{"region": "z0", "fix": ["x", "y", "z"]}],
}


@pytest.mark.parametrize(
    ("share", "certificate", "options", "code", "verdict"),
    [
        (0.5, NO_CERTIFICATE, ["--strict"], 0, "pass"),
        (0.5, NO_CERTIFICATE | {"estimate": True}, ["--strict"], 7, "warning"),
        (1.5, NO_CERTIFICATE | {"stability": True}, [], 6, "fail"),
    ],
)
def test_verdict_on_screen_in_the_summary_and_in_the_exit_code(
    share: float, certificate: dict[str, Any], options: list[str], code: int, verdict: str, tmp_path: Path
) -> None:
    """Two cells bend too little, as the estimate shows; beyond Euler's load the column buckles."""
    euler = np.pi**2 * 1e6 * 0.1**2 / 12 / 4
    path = write_job(
        tmp_path / "column.yaml",
        COLUMN,
        effects=[
            {
                "effect": "traction",
                "region": "z1",
                "area_in": "reference",
                "traction": [0, float(0.01 * euler), float(-share * euler)],
            }
        ],
        certificate=certificate,
        output={"mesh": []},  # files of straight cells have a warning of their own
    )
    ended = command("run", path, "--output", tmp_path / "out", *options, cwd=tmp_path)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())["certificate"]
    assert ended.returncode == code, ended.stdout + ended.stderr
    assert summary["verdict"] == verdict
    assert f"certificate: {verdict}" in ended.stdout
    assert summary["lines"][0].keys() == {
        "name",
        "meaning",
        "value",
        "unit",
        "rule",
        "verdict",
        "note",
        "remedy",
        "seconds",
    }


@pytest.mark.parametrize(
    ("certificate", "checked", "not_checked"),
    [
        ("off", set(), {"discretisation error", "boundary facets", "round trip", "stability"}),
        (
            "quick",
            {"equilibrium residual", "worst cell", "boundary facets", "limit points"},
            {"discretisation error", "round trip", "stability"},
        ),
        (
            {"level": "quick", "stability": True},
            {"equilibrium residual", "stability", "limit points"},
            {"discretisation error", "round trip"},
        ),
        ({}, {"equilibrium residual", "discretisation error", "round trip", "stability", "limit points"}, set()),
        ("full", {"equilibrium residual", "discretisation error", "round trip", "stability", "limit points"}, set()),
    ],
)
def test_levels_of_the_certificate_check_their_lines(
    certificate: Any, checked: set[str], not_checked: set[str], comm: MPI.Intracomm
) -> None:
    mesh = box((1, 1, 2), lx="0.2 m", ly="0.2 m") | {"geometry_degree": 2}
    result = hpcinv.run(column(2, mesh=mesh, certificate=certificate), comm)
    verdicts = {entry.name: entry.verdict for entry in result.certificate.lines}
    skipped = {name for name, verdict in verdicts.items() if verdict is Verdict.SKIPPED}
    assert {name for part in not_checked for name in skipped if name.startswith(part)} == skipped
    assert len(skipped) == len(not_checked)
    assert all(any(name.startswith(part) for name in verdicts.keys() - skipped) for part in checked)
    assert (len(verdicts) == len(skipped)) is (certificate == "off")
    assert result.certificate.verdict is (Verdict.SKIPPED if certificate == "off" else Verdict.PASS)


@pytest.mark.release
def test_without_a_load_unknown_surface_errors_are_not_mentioned(comm: MPI.Intracomm) -> None:
    unloaded = column(2).model_copy(update={"effects": ()})
    error_line = line(hpcinv.run(unloaded, comm), DISCRETISATION.name)
    assert (error_line.value, error_line.verdict) == (0.0, Verdict.PASS)
    assert "surface" not in error_line.note


@pytest.mark.parallel([2])
def test_seconds_of_the_lines_add_up_to_the_certificate(comm: MPI.Intracomm) -> None:
    result = hpcinv.run(column(2, certificate={}), comm)
    seconds = [entry.seconds for entry in result.certificate.lines]
    assert comm.allgather(seconds) == [seconds] * comm.size
    by_name = {entry.name: entry.seconds for entry in result.certificate.lines}
    assert by_name["largest volume ratio J"] is None  # with the smallest one
    total = sum(value for value in seconds if value is not None)
    assert 0 < total <= result.statistics["timings"]["phases"]["certificate"]["max"] + 0.1


def test_certificate_time_is_listed_separately() -> None:
    timings = Timings()
    with timings.as_one("certificate"), timings("tangent"):
        timings.move("tangent", "factorization", 1.0)
    with timings("residual"):
        pass
    assert timings.seconds.keys() == {"certificate", "residual"}
    assert timings.seconds["certificate"] >= 0
    assert timings.inner_seconds["factorization"] == 1.0
    assert timings.inner_seconds["tangent"] == pytest.approx(-1.0, abs=0.1)
