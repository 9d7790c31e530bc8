"""Fixed-point methods: their update rules as algebra, and that they end where the direct method does.

The rules are checked against the formulas in the sources, evaluated independently, and on affine residuals
r(X) = A (X - X*), whose number of steps is known. Whole methods are compared with the direct one.
"""

from __future__ import annotations

import typing
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import NO_CERTIFICATE, ROOT, write_job
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.base.parallel.timings import Timings
from hpcinv.base.updates import UPDATES
from hpcinv.errors import Interrupted, SolveError
from hpcinv.job.job import Job
from hpcinv.mesh import build_body
from hpcinv.model.outcome import Outcome
from hpcinv.output.result import Result
from hpcinv.solver.equations import Equations
from hpcinv.solver.methods.fixed_point import FixedPointMethod

type Map = Callable[[np.ndarray], np.ndarray]

LAWS: dict[str, dict[str, Any]] = {
    "neo-hookean": {"law": "neo-hookean", "young": "10 kPa", "poisson": 0.3},
    "mooney-rivlin": {"law": "mooney-rivlin", "c1": "2 kPa", "c2": "1 kPa", "d1": "20 kPa"},
}
DISTINCT = ("sellier", "aitken", "anderson")  # rausch is aitken


# Update rules


def iterates(method: str, r: Map, X: np.ndarray, steps: int, relaxation: float = 1.0, memory: int = 5) -> list[Any]:
    """The points that a rule visits."""
    rule = UPDATES[method](relaxation, memory, lambda a, b: float(np.vdot(a, b)))
    points = [X]
    for _ in range(steps):
        points.append(points[-1] + rule.step(points[-1], r(points[-1])))
    return points


def twisted(X: np.ndarray) -> np.ndarray:
    """A residual that is neither linear nor of one direction."""
    return np.array(
        [X[0] + 0.3 * np.sin(X[1]) - 0.5, 1.2 * X[1] - 0.2 * X[0] * X[2], 0.7 * X[2] + 0.1 * X[0] ** 2 - 0.3]
    )


def test_a_job_knows_every_rule_and_no_other() -> None:
    assert set(typing.get_args(Job.model_fields["method"].annotation)) == {"direct", *UPDATES}


def test_plain_and_relaxed_steps_contract_as_they_must() -> None:
    """On r = a (X - X*) each step leaves 1 - ωa of the error."""
    for relaxation in (1.0, 0.4):
        points = iterates("sellier", lambda X: 1.3 * (X - 2.0), np.array([5.0]), 6, relaxation)
        expected = 2.0 + 3.0 * (1 - 1.3 * relaxation) ** np.arange(7)
        np.testing.assert_allclose(np.concatenate(points), expected, rtol=1e-14)


@pytest.mark.parametrize("method", ["aitken", "rausch", "anderson"])
@pytest.mark.parametrize("slope", [0.1, 1.9, 3.0])
def test_a_scalar_affine_residual_takes_one_accelerated_step(method: str, slope: float) -> None:
    """The last slope is one at which the plain method diverges."""
    points = iterates(method, lambda X: slope * (X - 2.0), np.array([5.0]), 2)
    assert abs(points[1][0] - 2.0) > 0.1
    assert abs(points[2][0] - 2.0) < 1e-14
    # Once the residual is zero, it stays so.
    assert iterates(method, lambda X: slope * (X - 2.0), np.array([2.0]), 3)[-1] == 2.0


def test_dynamic_relaxation_is_aitkens_delta_squared_process() -> None:
    """From x, g(x), g(g(x)) of the fixed point of the cosine: x - (Δx)² / Δ²x."""
    points = iterates("aitken", lambda X: X - np.cos(X), np.array([1.0]), 2)
    x0, x1 = 1.0, np.cos(1.0)
    x2 = np.cos(x1)
    assert points[2][0] == pytest.approx(x0 - (x1 - x0) ** 2 / (x2 - 2 * x1 + x0), rel=1e-13)


def test_dynamic_relaxation_follows_irons_and_tuck_and_rausch() -> None:
    """Both as printed: μ = 1 - ω of the one, β = ω of the other."""
    relaxation = 0.6
    X, mu, before = np.array([1.0, -1.0, 2.0]), 1 - relaxation, None
    by_mu = [X]
    for _ in range(6):
        # Irons and Tuck's Δ is g(X) before relaxation less X, the negative residual.
        delta = -twisted(X)
        if before is not None:
            difference = before - delta
            mu = mu + (mu - 1) * (difference @ delta) / (difference @ difference)
        X, before = X + (1 - mu) * delta, delta
        by_mu.append(X)
    X, beta, last = by_mu[0], relaxation, None
    by_beta = [X]
    for _ in range(6):
        R = twisted(X)
        if last is not None:
            beta = -beta * (last @ (R - last)) / ((R - last) @ (R - last))
        X, last = X - beta * R, R
        by_beta.append(X)
    for method in ("aitken", "rausch"):
        positions = iterates(method, twisted, by_mu[0], 6, relaxation)
        np.testing.assert_allclose(positions, by_mu, rtol=1e-9)
        np.testing.assert_allclose(positions, by_beta, rtol=1e-9)
    assert np.linalg.norm(twisted(positions[6])) < 0.1 * np.linalg.norm(twisted(positions[0]))


@pytest.mark.parametrize("memory", [1, 2, 5])
def test_anderson_is_the_least_squares_problem_of_walker_and_ni(memory: int) -> None:
    omega, X = 0.6, np.array([1.0, -1.0, 2.0])
    points, residuals = [X], [twisted(X)]
    for k in range(5):
        m = min(memory, k)
        dX = np.diff(np.array(points[k - m :]), axis=0).T
        dR = np.diff(np.array(residuals[k - m :]), axis=0).T
        gamma = np.linalg.lstsq(dR, residuals[-1], rcond=None)[0] if m else np.zeros(0)
        X = X - omega * residuals[-1] - ((dX - omega * dR) @ gamma if m else 0)
        points.append(X)
        residuals.append(twisted(X))
    # Beyond three steps the three components are explained more than once, and lstsq takes the least γ.
    count = 6 if memory <= 2 else 5
    positions = iterates("anderson", twisted, points[0], 5, omega, memory)
    np.testing.assert_allclose(positions[:count], points[:count], rtol=1e-8)


@pytest.mark.parametrize("n", [2, 4, 6])
def test_anderson_solves_an_affine_problem_in_as_many_steps_as_it_has_dimensions_and_one(n: int) -> None:
    random = np.random.default_rng(n)
    A = np.eye(n) + 0.8 * random.standard_normal((n, n))
    solution = random.standard_normal(n)
    points = iterates("anderson", lambda X: A @ (X - solution), np.zeros(n), n + 1, 1.0, n)
    errors = [np.linalg.norm(X - solution) for X in points]
    print(f"n = {n}: errors {', '.join(f'{e:.1e}' for e in errors)}")
    assert errors[n - 1] > 1e-3
    assert errors[n + 1] < 1e-9


def test_steps_that_say_nothing_new_do_no_harm_to_anderson() -> None:
    """Two of three components depend on the third, so that all changes of r are parallel."""
    direction = np.array([1.0, 2.0, -1.0])
    points = iterates("anderson", lambda X: direction * np.tanh(X[0] - 0.3), np.zeros(3), 9)
    assert np.isfinite(points).all()
    assert abs(points[-1][0] - 0.3) < 1e-12


# Whole methods


def tetrahedron(acceleration: float = -9.81, **changes: Any) -> dict[str, Any]:
    weight = {"effect": "gravity", "acceleration": [0, acceleration, 0], "density": 1000}
    return {
        "mesh": {"file": "../meshes/single_tetrahedron.msh"},
        "regions": {"base": "y < 1e-9"},
        "material": LAWS["neo-hookean"],
        "effects": [weight],
        "supports": [{"region": "base", "fix": ["x", "y", "z"]}],
        "discretisation": {"formulation": "displacement", "displacement": 1},
    } | changes


def block(divisions: tuple[int, int, int] = (3, 1, 1), geometry: int = 2, **changes: Any) -> dict[str, Any]:
    """Incompressible, bent by its weight, and solved in the mixed form."""
    return {
        "mesh": box(divisions, lx=1.5) | {"geometry_degree": geometry},
        "material": {"law": "neo-hookean", "mu": "30 kPa", "lam": "incompressible"},
        "effects": [{"effect": "gravity", "acceleration": [0, -1, 0], "density": 1000}],
        "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
    } | changes


def residuals(result: Result) -> list[float]:
    return [solve.position_residual for solve in result.solutions[0].solves if solve.position_residual is not None]


def largest(values: np.ndarray, comm: MPI.Intracomm) -> float:
    return float(comm.allreduce(float(np.abs(values).max(initial=0.0)), op=MPI.MAX))


@pytest.mark.everyday("neo-hookean")
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("density_in", [pytest.param("reference", marks=pytest.mark.release), "current"])
def test_a_tetrahedron_ends_where_the_direct_method_does(law: str, density_in: str, comm: MPI.Intracomm) -> None:
    diagonal, tolerance = np.sqrt(3.0), 1e-10
    weight = {"effect": "gravity", "acceleration": [0, -9.81, 0], "density": 1000, "density_in": density_in}
    case = tetrahedron(material=LAWS[law], effects=[weight])
    direct = hpcinv.run(job(**case), comm)
    assert largest(direct.solutions[0].u, comm) > 0.05  # not a test of nothing
    taken = {}
    for method in UPDATES:
        result = hpcinv.run(job(method=method, **case), comm)
        (solution,) = result.solutions
        error, residual, taken[method] = (
            largest(solution.u - direct.solutions[0].u, comm),
            residuals(result)[-1],
            len(residuals(result)),
        )
        print(
            f"{law}, {density_in}, {method}: {taken[method]} iterations, residual {residual:.1e} m,"
            f" {error:.1e} m from direct"
        )
        assert residual <= tolerance * diagonal
        # r(X) ≈ (∂r/∂X) (X - X*): the position residual gives the error to a factor of |(∂r/∂X)⁻¹|, here below 2.
        assert error <= 2 * tolerance * diagonal
        assert residuals(result)[0] > 1e6 * residual
    assert taken["aitken"] == taken["rausch"] <= taken["sellier"] / 2
    assert taken["anderson"] <= taken["sellier"] / 2


@pytest.mark.release
@pytest.mark.parallel([2, 1])
def test_an_incompressible_block_ends_where_the_direct_method_does(comm: MPI.Intracomm) -> None:
    direct = hpcinv.run(job(**block()), comm)
    (solution,) = direct.solutions
    assert largest(solution.u, comm) > 0.09
    taken = {}
    for method in DISTINCT:
        result = hpcinv.run(job(method=method, **block()), comm)
        (other,) = result.solutions
        taken[method] = len(residuals(result))
        error = largest(other.u - solution.u, comm)
        pressure = largest(other.pressure.x.array - solution.pressure.x.array, comm) / largest(
            solution.pressure.x.array, comm
        )
        stress = largest(other.cauchy_stress.x.array - solution.cauchy_stress.x.array, comm)
        print(f"{method}: {taken[method]} iterations, {result.solutions[0].factorizations} factorizations, "
              f"{error:.1e} m from direct, pressure {pressure:.1e}, stress {stress:.1e} Pa")  # fmt: skip
        assert residuals(result)[-1] <= 1e-10 * np.sqrt(1.5**2 + 1 + 1)
        assert error <= 2e-10 * np.sqrt(1.5**2 + 1 + 1)
        assert pressure < 1e-8
        assert stress < 1e-8 * largest(solution.cauchy_stress.x.array, comm)
        assert np.array_equal(result.body.mesh.geometry.x, direct.body.mesh.geometry.x)
    assert taken["anderson"] < taken["sellier"]


def test_fixed_points_on_straight_cells_find_the_body_of_the_direct_method(comm: MPI.Intracomm) -> None:
    """All nodes of the quadratic displacements move, whatever the degree of the given cells."""
    case = block((2, 1, 1), geometry=1, material={"law": "neo-hookean", "mu": "30 kPa", "lam": "30 kPa"})
    (direct,) = hpcinv.run(job(**case), comm).solutions
    (solution,) = hpcinv.run(job(method="anderson", **case), comm).solutions
    assert np.linalg.norm(solution.u - direct.u) < 1e-8 * np.linalg.norm(direct.u)


def test_cold_starts_cost_more_and_end_at_the_same_body(comm: MPI.Intracomm) -> None:
    warm = hpcinv.run(job(method="anderson", **tetrahedron()), comm)
    cold = hpcinv.run(job(method="anderson", fixed_point={"warm_start": False}, **tetrahedron()), comm)
    assert largest(warm.solutions[0].u - cold.solutions[0].u, comm) < 1e-11
    assert len(residuals(warm)) == len(residuals(cold))
    counts = [sum(len(solve.iterations) for solve in result.solutions[0].solves) for result in (warm, cold)]
    print(f"Newton iterations: {counts[0]} warm, {counts[1]} cold")
    assert counts[0] < counts[1]


@pytest.mark.release
def test_relaxation_slows_a_good_fixed_point_down(comm: MPI.Intracomm) -> None:
    """Where the plain method leaves a share ±θ of the error, the relaxed one leaves 1 - ω (1 ∓ θ)."""
    omega = 0.8
    plain = residuals(hpcinv.run(job(method="sellier", **tetrahedron()), comm))
    relaxed = residuals(hpcinv.run(job(method="sellier", fixed_point={"relaxation": omega}, **tetrahedron()), comm))
    assert plain[0] == relaxed[0]
    theta, observed = plain[-1] / plain[-2], relaxed[-1] / relaxed[-2]
    print(f"contraction {theta:.4f} plain, {observed:.4f} with ω = {omega}; {len(plain)}, {len(relaxed)} iterations")
    assert observed == pytest.approx(1 - omega * (1 - theta), rel=1e-3)
    assert len(relaxed) > len(plain)


@pytest.mark.parallel([2, 1])
def test_a_stopped_search_is_resumed_where_it_was(comm: MPI.Intracomm, run_directory: Path) -> None:
    path = run_directory / "block.yaml"
    mesh = block()["mesh"] | {"file": str(ROOT / "meshes" / "box.py")}
    on_root(comm, lambda: write_job(path, block(method="sellier", mesh=mesh, certificate=NO_CERTIFICATE)))
    case = hpcinv.load(path)
    asked = 0

    def stop() -> bool:
        nonlocal asked
        asked += 1
        return asked > 16

    with pytest.raises(Interrupted):
        hpcinv.run(case, comm, directory=run_directory / "run", stop_asked=stop)
    resumed = hpcinv.run(case, comm, directory=run_directory / "run", resume=True)
    whole = hpcinv.run(case, comm)
    assert largest(resumed.solutions[0].u - whole.solutions[0].u, comm) < 3e-10
    # Nothing is lost: the search goes on with the body that came next.
    np.testing.assert_allclose(residuals(resumed)[:-1], residuals(whole)[: len(residuals(resumed)) - 1], rtol=1e-3)
    assert len(residuals(resumed)) == len(residuals(whole))


def test_a_round_trip_returns_by_the_direct_method(comm: MPI.Intracomm) -> None:
    result = hpcinv.run(job(analysis="round_trip", method="aitken", **tetrahedron()), comm)
    _, forward = result.solutions
    assert [solution.direction for solution in result.solutions] == ["inverse", "forward"]
    assert all(solve.position_residual is None for solve in forward.solves)
    # What does not vanish is the position residual.
    assert result.errors["round_trip"]["max"] == pytest.approx(residuals(result)[-1], abs=1e-13)


# How a search fails


def run_and_fail(comm: MPI.Intracomm, **case: Any) -> SolveError:
    with pytest.raises(SolveError) as caught:
        hpcinv.run(job(**case), comm)
    print(f"{caught.value}")
    return caught.value


def test_fixed_points_that_need_more_iterations_say_so(comm: MPI.Intracomm) -> None:
    error = run_and_fail(comm, method="sellier", fixed_point={"maximum_iterations": 4}, **tetrahedron())
    assert Outcome.FIXED_POINT_LIMIT.text in str(error)
    assert "anderson" in error.advice


@pytest.mark.parallel([2, 1])
def test_a_search_that_comes_no_closer(comm: MPI.Intracomm) -> None:
    """Pulled hard, the tetrahedron swings between two bodies; all else than the plain method finds the one between."""
    case = tetrahedron(9.81, material=LAWS["neo-hookean"] | {"young": "2 kPa"})
    error = run_and_fail(comm, method="sellier", **case)
    assert Outcome.FIXED_POINT_DIVERGED.text in str(error)
    direct = hpcinv.run(job(**case), comm)
    for changes in (
        {"method": "aitken"},
        {"method": "anderson"},
        {"method": "sellier", "fixed_point": {"relaxation": 0.5}},
    ):
        result = hpcinv.run(job(**case, **changes), comm)
        print(f"{changes}: {len(residuals(result))} iterations")
        assert largest(direct.solutions[0].u - result.solutions[0].u, comm) < 1e-9


def test_a_given_body_that_cannot_carry_its_load_once_more(comm: MPI.Intracomm) -> None:
    """The load grows with the volume: the undeformed body carries it, the deformed one would not a second time."""
    weight = {"effect": "gravity", "acceleration": [0, 9.81, 0], "density": 1000, "density_in": "current"}
    case = tetrahedron(material=LAWS["neo-hookean"] | {"young": "3 kPa"}, effects=[weight])
    error = run_and_fail(comm, method="anderson", **case)
    assert "the fixed-point method did not find the shape" in str(error)
    assert "method: direct" in error.advice
    assert largest(hpcinv.run(job(**case), comm).solutions[0].u, comm) > 0.2


def test_a_step_that_would_turn_the_body_inside_out_is_shortened(comm: MPI.Intracomm) -> None:
    given = job(method="sellier", **tetrahedron())
    body = build_body(given.mesh, given.regions, comm, resolve=given.resolve)
    search = FixedPointMethod(Equations(given, body, Timings()))
    apex = np.flatnonzero(body.mesh.geometry.x[:, 1] > 0.5 / body.length_scale)
    step = np.zeros_like(body.mesh.geometry.x)
    step[apex, 1] = -1.5 / body.length_scale  # 1 - 1.5 < 0, but 1 - 0.75 > 0
    assert search._move(step)
    assert search._X[apex, 1] * body.length_scale == pytest.approx(0.25)
    assert search.min_mesh_J() == pytest.approx(0.25)
    assert not search._move(1e6 * step)
    assert search._X[apex, 1] * body.length_scale == pytest.approx(0.25)
    assert body.mesh.geometry.x[apex, 1] * body.length_scale == 1.0  # it was only looked at
    search.equilibrium.destroy()
