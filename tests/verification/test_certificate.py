"""The certificate: each of its lines against what is known otherwise, and what it does to exit code and summary."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers import silicone_beam
from helpers.closed_forms import root
from helpers.command_line import NO_CERTIFICATE, ROOT, write_job
from helpers.command_line import hpcinv_here as command
from helpers.thick_sphere import PRESSURE, carried, outer_radius, sphere
from helpers.verification import box, job
from petsc4py import PETSc

import hpcinv
from hpcinv.certificate import Line, Verdict, inertia, limit_point_check, lower_bound_line, upper_bound_line
from hpcinv.certificate.certify import DISCRETISATION
from hpcinv.certificate.check import Certificate, skipped
from hpcinv.certificate.equilibrium_residual import equilibrium_residual
from hpcinv.certificate.inertia import factorize_symmetric
from hpcinv.certificate.limit_point_check import LIMIT_POINTS, limit_points
from hpcinv.certificate.shape import cells
from hpcinv.mesh import build_body
from hpcinv.model.outcome import Outcome
from hpcinv.output.result import Result
from hpcinv.parallel.runtime import MPI
from hpcinv.parallel.timings import Timings
from hpcinv.results.solution import solution_of
from hpcinv.solver.equations import Equations
from hpcinv.solver.linear.factorization import Direct
from hpcinv.solver.linear.refined import Refined
from hpcinv.solver.load_stepping import follow
from hpcinv.solver.newton import Solve

ESTIMATE = NO_CERTIFICATE | {"estimate": True}


def line(result: Result, name: str) -> Line:
    (named_line,) = [entry for entry in result.certificate.lines if entry.name.startswith(name)]
    return named_line


def column(divisions: int, **changes: Any) -> Any:
    mesh = box((1, 1, divisions), lx="0.2 m", ly="0.2 m")
    return job(
        material={"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
        effects=[{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 1000, "density_in": "current"}],
        supports=[{"region": "boundary", "fix": ["x", "y"]}, {"region": "z0", "fix": ["z"]}],
        quantities=[{"name": "length", "of": "Z", "on": "z1", "reduce": "mean"}],
        **{"mesh": mesh, "certificate": ESTIMATE, **changes},
    )


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


@pytest.mark.everyday("4-False")
@pytest.mark.parametrize(("divisions", "hexahedra"), [(2, True), (4, True), (2, False), (4, False)])
def test_the_error_of_the_sphere_is_estimated(divisions: int, hexahedra: bool, comm: MPI.Intracomm) -> None:
    A = root(lambda A: carried(A, 0.5, 0.0) - PRESSURE, 0.5, 1.0)
    ratios = effectivities(hpcinv.run(sphere(divisions, hexahedra), comm), {"inner": A, "outer": outer_radius(A)})
    print(f"{divisions} divisions, hexahedra {hexahedra}: effectivity {ratios}")
    assert all(0.5 < value < 2 for value in ratios.values())


@pytest.mark.parametrize("divisions", [2, 4, 8])
def test_the_error_of_the_column_is_estimated(divisions: int, comm: MPI.Intracomm) -> None:
    ratios = effectivities(hpcinv.run(column(divisions), comm), {"length": 1.0802799})
    print(f"{divisions} divisions: effectivity {ratios}")
    assert 0.5 < ratios["length"] < 2


@pytest.mark.parallel([2])  # tests of the sphere and the column run on one rank
def test_the_error_of_the_beam_is_estimated(comm: MPI.Intracomm) -> None:
    """The exact tip is taken from cubic displacements."""

    cubic = hpcinv.run(job(**silicone_beam.sagging("4 mm", 3, NO_CERTIFICATE)), comm)
    quadratic = hpcinv.run(job(**silicone_beam.sagging("4 mm", 2, ESTIMATE)), comm)
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
    assert line(coarse, DISCRETISATION).verdict is Verdict.FAIL
    exact = locked(comm, NO_CERTIFICATE, degree=2).quantities["tip"]
    assert coarse.estimate.corrected["tip"] == pytest.approx(exact, rel=1e-6)
    for name in ("SHARE", "LEAST"):
        monkeypatch.setattr(f"hpcinv.certificate.discretisation_error.{name}", 0.0)
    coarse = locked(comm)
    assert coarse.estimate is not None
    assert coarse.estimate.is_too_dear
    assert not coarse.estimate.is_solved
    assert line(coarse, DISCRETISATION).verdict is Verdict.UNDECIDED
    assert "raise discretisation.displacement" in line(coarse, DISCRETISATION).note
    assert coarse.estimate.corrected["tip"] != pytest.approx(exact, rel=1e-3)
    # Given up on the way, which leaves no trace.
    monkeypatch.setattr("hpcinv.certificate.discretisation_error._tangents_of_finer_solve", lambda *_: 1)
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


def filled(dense: np.ndarray, comm: MPI.Intracomm) -> PETSc.Mat:
    matrix = PETSc.Mat().createAIJ(dense.shape, comm=comm)
    matrix.setUp()
    begin, end = matrix.getOwnershipRange()
    matrix.setValues(range(begin, end), range(len(dense)), dense[begin:end])
    matrix.assemble()
    return matrix


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize(
    "options", [{}, {"rounded": True}, {"rounded": True, "low_rank": True}, {"minimum_fill": True}]
)
def test_inertia_counts_signs_of_eigenvalues(options: dict[str, bool], comm: MPI.Intracomm) -> None:
    random = np.random.default_rng(3)
    dense = random.normal(size=(30, 30))
    dense = dense + dense.T + 1e-3 * random.normal(size=(30, 30))
    values = np.linalg.eigvalsh((dense + dense.T) / 2)
    factors = factorize_symmetric(filled(dense, comm), **options)
    assert factors is not None
    signs = factors.inertia
    assert (signs.negative, signs.zero, signs.positive) == ((values < 0).sum(), 0, (values > 0).sum())
    # Estimated by one random vector.
    assert signs.asymmetry == pytest.approx(np.linalg.norm(dense - dense.T) / 2 / np.linalg.norm(dense), rel=0.5)


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("least", [1e-10, -1e-10])
@pytest.mark.parametrize("low_rank", [False, True])
def test_rounded_factors_do_not_change_the_sign_of_a_small_eigenvalue(
    low_rank: bool, least: float, comm: MPI.Intracomm
) -> None:
    directions, _ = np.linalg.qr(np.random.default_rng(4).normal(size=(30, 30)))
    values = np.concatenate([[least], np.linspace(1.0, 2.0, 29)])
    factors = factorize_symmetric(filled(directions * values @ directions.T, comm), rounded=True, low_rank=low_rank)
    assert factors is not None
    assert factors.inertia.negative == (least < 0)


@pytest.mark.parallel([1, 2, 3])
def test_factors_of_a_forward_solve_give_its_inertia(comm: MPI.Intracomm) -> None:
    """Of a block that is squeezed to half its height, and may then bulge to either side."""
    column_job = job(
        analysis="forward",
        mesh=box((2, 2, 6), lz=3.0),
        material={"law": "neo-hookean", "young": "10 kPa", "poisson": 0.3},
        supports=[{"region": "z0", "fix": ["x", "y", "z"]}, {"region": "z1", "displacement": [0, 0, -1.5]}],
        solver={"linear": "direct"},
        certificate=NO_CERTIFICATE,
    )
    model = Equations(
        column_job, build_body(column_job.mesh, column_job.regions, comm, resolve=column_job.resolve), Timings()
    )
    equilibrium = model.equilibrium(model.weak_form("forward"))
    assert list(follow(equilibrium, model.steps, 1e-8))[-1].outcome.accepted
    equilibrium.system.linearise(1.0)
    equilibrium.linear.factorize()
    kept = equilibrium.linear.symmetric_factors
    assert kept is not None
    again = factorize_symmetric(equilibrium.system.matrix)
    assert again is not None
    print(f"{comm.size} rank(s): {kept.getFactorMatrix().getInertia()}, {again.inertia}")
    assert kept.getFactorMatrix().getInertia() == (again.inertia.negative, again.inertia.zero, again.inertia.positive)
    assert again.inertia.negative > 0
    again.destroy()
    equilibrium.destroy()


@pytest.mark.everyday("inverse-pressure")
@pytest.mark.parallel([1, 3, 2])
@pytest.mark.parametrize(
    ("analysis", "load"), [("inverse", "gravity"), ("inverse", "pressure"), ("forward", "pressure")]
)
def test_factors_of_nearly_symmetric_tangents_serve_the_certificate(
    analysis: str, load: str, comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Inertia, round trip and solution agree with factors of the forward tangent."""
    loads: dict[str, dict[str, object]] = {
        "gravity": {"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 30},
        "pressure": {"effect": "pressure", "region": "x1", "pressure": 300},
    }
    made = []
    factorized = inertia._factorized

    def recorded(*arguments: Any) -> PETSc.PC | None:
        made.append(arguments)
        return factorized(*arguments)

    def run(petsc: dict[str, object]) -> Result:
        made.clear()
        return hpcinv.run(
            job(
                analysis=analysis,
                mesh=box((3, 3, 3)) | {"geometry_degree": 2},
                material={"law": "mooney-rivlin", "c1": "10 kPa", "c2": "5 kPa", "d1": "1 MPa"},
                effects=[loads[load]],
                supports=[{"region": "z0", "fix": ["x", "y", "z"]}],
                solver={"linear": "direct", "petsc": petsc},
                certificate=NO_CERTIFICATE | {"stability": True, "round_trip": "near"},
            ),
            comm,
        )

    monkeypatch.setattr(inertia, "_factorized", recorded)
    exact = run({})
    single = run({"pc_precision": "single"})
    assert not made
    for result in (exact, single):
        assert line(result, "stability").value == 0
        assert line(result, "round trip").value == pytest.approx(0, abs=1e-9)
    assert single.solutions[0].u == pytest.approx(exact.solutions[0].u, abs=1e-9)


@pytest.mark.everyday("1.05", "9.5", "8.7")
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
            mesh=box((1, 1, 20), lx=side, ly=side, lz=length, hexahedra=True),
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
            mesh=box((2, 2, 2), lx=2.0, ly=2.0, lz=2.0) | {"geometry_degree": 2},
            material={"law": "neo-hookean", "mu": "2 kPa", "lam": "80 kPa"},
            effects=[{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 1000}],
            supports=[{"region": "z0", "fix": ["x", "y", "z"]}],
            discretisation={"formulation": "mixed"},
            certificate=NO_CERTIFICATE | {"round_trip": "path"},
        ),
        comm,
    )
    closure = line(result, "round trip")
    assert closure.verdict is Verdict.UNDECIDED
    assert "stopped at load factor" in closure.note


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


def test_verdicts() -> None:
    nan = float("nan")
    assert [upper_bound_line("", v, 1, 2).verdict.value for v in (1, 1.5, 2.5, nan)] == [
        "pass",
        "warning",
        "fail",
        "fail",
    ]
    assert [lower_bound_line("", v, 2, 1).verdict.value for v in (2, 1.5, 1, nan)] == [
        "pass",
        "warning",
        "fail",
        "fail",
    ]
    lines = [Line("", None, "", "", verdict) for verdict in Verdict]
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
        (0.5, NO_CERTIFICATE | {"estimate": True}, [], 0, "warning"),
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
    assert summary["lines"][0].keys() == {"name", "value", "unit", "rule", "verdict", "note", "seconds"}


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
def test_levels(certificate: Any, checked: set[str], not_checked: set[str], comm: MPI.Intracomm) -> None:
    mesh = box((1, 1, 2), lx="0.2 m", ly="0.2 m") | {"geometry_degree": 2}
    result = hpcinv.run(column(2, mesh=mesh, certificate=certificate), comm)
    verdicts = {entry.name: entry.verdict for entry in result.certificate.lines}
    skipped = {name for name, verdict in verdicts.items() if verdict is Verdict.SKIPPED}
    assert {name for part in not_checked for name in skipped if name.startswith(part)} == skipped
    assert len(skipped) == len(not_checked)
    assert all(any(name.startswith(part) for name in verdicts.keys() - skipped) for part in checked)
    assert (len(verdicts) == len(skipped)) is (certificate == "off")
    assert result.certificate.verdict is (Verdict.SKIPPED if certificate == "off" else Verdict.PASS)


def test_without_a_load_unknown_surface_errors_are_not_mentioned(comm: MPI.Intracomm) -> None:
    unloaded = column(2).model_copy(update={"effects": ()})
    error_line = line(hpcinv.run(unloaded, comm), DISCRETISATION)
    assert (error_line.value, error_line.verdict) == (0.0, Verdict.PASS)
    assert "surface" not in error_line.note


@pytest.mark.parametrize("pressures", [{}, {"pressure": 1}])
@pytest.mark.parametrize("stretch", [1.4, 2, 3])
def test_free_growth_has_no_limit_point(stretch: float, pressures: dict[str, int], comm: MPI.Intracomm) -> None:
    """The tangent of the undeformed body under the whole growth, where the path begins, has another determinant."""
    grown = job(
        analysis="forward",
        mesh=box(hexahedra=True),
        discretisation={"displacement": 2, **pressures},
        material={"law": "neo-hookean", "young": "300 kPa", "poisson": 0.3},
        effects=[{"effect": "growth", "stretch": stretch}],
        supports=[{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"],
        certificate={},
    )
    limit_line = line(hpcinv.run(grown, comm), LIMIT_POINTS)
    assert (limit_line.value, limit_line.verdict) == (0.0, Verdict.PASS)


@pytest.mark.parametrize(
    ("signs", "start", "unloaded", "verdict"),
    [
        ([(-1, 1, 1)], "", 1, Verdict.PASS),  # the first one is at no equilibrium
        ([(1, -1, 1), (1,)], "", 1, Verdict.PASS),
        ([(-1, -1)], "", 1, Verdict.WARN),  # the solution may even lie beyond a limit point
        ([(1, -1)], "", 1, Verdict.WARN),
        ([(1,), (-1,), (1,)], "", 1, Verdict.WARN),
        ([(-1,), (-1,)], "", -1, Verdict.PASS),  # an odd number of pressures
        ([(-1, -1)], "held", 1, Verdict.PASS),  # the path begins at the solution of a state
        ([(-1, 1)], "held", 1, Verdict.UNDECIDED),
    ],
)
def test_signs_of_the_tangent_are_compared_between_equilibria(
    signs: list[tuple[int, ...]], start: str, unloaded: int, verdict: Verdict, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limit_point_check, "_precise_sign", lambda *_: 0)
    solves = tuple(Solve(1.0, Outcome.CONVERGED, (), 1, of_solve) for of_solve in signs)
    model: Any = SimpleNamespace(unknowns=SimpleNamespace(unloaded_sign=unloaded, p=None))
    own = SimpleNamespace(solver=SimpleNamespace(start_shape=None))
    solution: Any = SimpleNamespace(solves=solves, start=start, job=own)
    (path_line,) = limit_points(model, solution, skipped("stability", ""))
    assert path_line.verdict is verdict


@pytest.mark.parametrize(
    ("signs", "jumped", "verdict"),
    [
        ([1, 1], False, Verdict.SKIPPED),
        ([-1, 1], False, Verdict.UNDECIDED),
        ([-1, -1], False, Verdict.UNDECIDED),  # the load path of the given body does not end here
        ([1, 1], True, Verdict.UNDECIDED),
        ([], False, Verdict.SKIPPED),
    ],
)
def test_path_from_a_rough_shape_is_not_decided_where_there_may_be_others(
    signs: list[int], jumped: bool, verdict: Verdict
) -> None:
    solves = tuple(Solve(1.0, Outcome.CONVERGED, (), 1, (1, sign)) for sign in signs)
    solves += (Solve(1.0, Outcome.CONVERGED, (), 0, may_have_jumped=jumped),)
    model: Any = SimpleNamespace(unknowns=SimpleNamespace(unloaded_sign=1, p=None))
    own = SimpleNamespace(solver=SimpleNamespace(start_shape="rough.msh"))
    solution: Any = SimpleNamespace(solves=solves, start="rough.msh", job=own)
    (path_line,) = limit_points(model, solution, skipped("stability", ""))
    assert path_line.verdict is verdict
    assert "rough.msh" in path_line.note


@pytest.mark.parametrize(("wrong", "verdict"), [(Refined, Verdict.UNDECIDED), (Direct, Verdict.WARN)])
def test_sign_of_single_precision_is_compared_with_double(
    wrong: type, verdict: Verdict, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Single precision alone has another sign than the unloaded body, or (by `Direct`, its base) both have."""
    monkeypatch.setattr(wrong, "sign_of_determinant", lambda *_: -1)
    single = {"linear": "direct", "continuation": "steps", "petsc": {"pc_precision": "single"}}
    lines = hpcinv.run(column(1, certificate={"estimate": False}, solver=single)).certificate.lines
    assert next(line for line in lines if line.name == LIMIT_POINTS).verdict is verdict


@pytest.mark.parametrize(
    ("outcomes", "signs", "verdict"),
    [
        ("fail accept", [(1, 1), (1, -1, 1)], Verdict.UNDECIDED),  # a shortened step may have passed a limit point
        ("fail accept", [(1, -1), (-1, 1, 1)], Verdict.PASS),
        ("accept fail", [(1, -1, 1), (1, 1)], Verdict.PASS),  # slender bodies overshoot
    ],
)
def test_shortened_steps_that_passed_another_sign_are_not_decided(
    outcomes: str, signs: list[tuple[int, ...]], verdict: Verdict
) -> None:
    ends = {"fail": Outcome.DIVERGED, "accept": Outcome.CONVERGED}
    solves = [Solve(0.5, ends[end], (), 1, of_solve) for end, of_solve in zip(outcomes.split(), signs, strict=True)]
    model: Any = SimpleNamespace(unknowns=SimpleNamespace(unloaded_sign=1, p=None))
    solution: Any = SimpleNamespace(solves=solves, start="")
    (path_line,) = limit_points(model, solution, skipped("stability", ""))
    assert path_line.verdict is verdict


@pytest.mark.parametrize(
    ("strategies", "signs", "verdict"),
    [
        (("power series", "power series"), (), Verdict.PASS),  # no determinant is needed
        (("power series", "load steps"), (), Verdict.SKIPPED),
        (("power series",), (-1,), Verdict.WARN),
    ],
)
def test_load_rises_along_power_series(
    strategies: list[str], signs: tuple[int, ...], verdict: Verdict, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limit_point_check, "_precise_sign", lambda *_: 0)
    solves = tuple(Solve(1.0, Outcome.CONVERGED, (), 1, signs, strategy=strategy) for strategy in strategies)
    model: Any = SimpleNamespace(unknowns=SimpleNamespace(unloaded_sign=1, p=None))
    solution: Any = SimpleNamespace(solves=solves, start="")
    (path_line,) = limit_points(model, solution, skipped("stability", ""))
    assert path_line.verdict is verdict


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
