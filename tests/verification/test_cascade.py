"""What is tried where the job's strategy fails: who wins, its answer and its cost."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from helpers.closed_forms import root
from helpers.paths import OCTANT, SPHERE, cube, tried
from helpers.verification import job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.job.job import Job
from hpcinv.model.outcome import Outcome
from hpcinv.output.result import Result
from hpcinv.solver.methods import fallbacks
from hpcinv.solver.methods.fallbacks import Attempt, attempts
from hpcinv.solver.newton import NewtonIteration, Solve

MU, B = 1.0, 10.0  # Fung–Demiray


def sphere(pressure: float, analysis: str = "forward", *, radial: int = 2, **solver: Any) -> Job:
    """A thick sphere of an incompressible material that stiffens exponentially."""
    return job(
        analysis=analysis,
        mesh=SPHERE | {"parameters": SPHERE["parameters"] | {"radial": radial}},
        material={"law": "fung-demiray", "mu": MU, "b": B, "kappa": "incompressible"},
        effects=[{"effect": "pressure", "region": "inner", "pressure": pressure}],
        supports=OCTANT,
        solver={"continuation": "steps"} | solver,  # a power series needs no rescue
        quantities=[{"name": "radius", "of": "norm(x, y, z)", "on": "inner", "reduce": "mean"}],
    )


def carried(a: float) -> float:
    """Pressure that takes the inner radius from 1 to ``a``, ``∫ dW/dλ / (λ³ - 1) dλ`` from ``λ_b`` to ``λ_a`` by Gauss.

    ``W = μ/2b (exp(b (I1 - 3)) - 1)``, ``I1 = 2 λ² + λ⁻⁴``.
    """
    low, high = (1.5**3 - 1 + a**3) ** (1 / 3) / 1.5, a
    points, weights = np.polynomial.legendre.leggauss(60)
    stretch = (high + low) / 2 + (high - low) / 2 * points
    I1 = 2 * stretch**2 + stretch**-4
    slope = MU / 2 * np.exp(B * (I1 - 3)) * (4 * stretch - 4 * stretch**-5)
    return float(np.sum(weights * slope / (stretch**3 - 1)) * (high - low) / 2)


def winners(result: Result) -> list[str]:
    return [attempt.strategy for attempt in attempts(result.solutions[0].solves)]


@pytest.mark.release
def test_arc_length_reaches_a_load_of_which_the_smallest_step_is_too_large(comm: MPI.Intracomm) -> None:
    result = hpcinv.run(sphere(30.0, radial=4, minimum_step=0.02), comm)
    radius, exact = result.quantities["radius"], root(lambda a: carried(a) - 30.0, 1.01, 2.0)
    failed, won = attempts(result.solutions[0].solves)
    print(f"inner radius {radius:.5f}, closed form {exact:.5f}; {failed}, {won}")
    assert radius == pytest.approx(exact, rel=1e-3)
    assert (failed.strategy, failed.load, won.strategy, won.load) == ("load steps", None, "arc-length", 1.0)
    assert won.outcome.accepted
    assert failed.factorizations + won.factorizations == result.solutions[0].factorizations
    assert won.factorizations < fallbacks.EFFORT["arc-length"]


@pytest.mark.release
@pytest.mark.parametrize("rescue", ["arc-length", "line-search"])
def test_every_rescue_finds_what_small_steps_find(rescue: str, comm: MPI.Intracomm) -> None:
    small = hpcinv.run(sphere(1.0), comm)
    assert winners(small) == ["load steps"]
    one_step = hpcinv.run(sphere(1.0, minimum_step=0.9, rescue=[rescue]), comm)
    assert winners(one_step) == ["load steps", rescue]
    assert np.abs(one_step.shape - small.shape).max() < 1e-9
    exact = root(lambda a: carried(a) - 1.0, 1.01, 2.0)
    assert one_step.quantities["radius"] == pytest.approx(exact, rel=1e-3)


def failing(problem: fallbacks.Problem) -> Iterator[Solve]:
    yield problem.path.report(Solve(1.0, Outcome.DIVERGED, (NewtonIteration(1.0, 1.0, 1.0, True),), 1))


def test_a_fixed_point_leads_to_the_direct_solution(comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch) -> None:
    direct = hpcinv.run(sphere(0.2, "inverse"), comm)
    monkeypatch.setattr(fallbacks, "_strategy", failing)
    options = {"snes_linesearch_maxstep": 1e3, "snes_linesearch_maxstp": 1e3}
    result = hpcinv.run(sphere(0.2, "inverse", rescue=["anderson"], petsc=options), comm)
    assert winners(result) == ["load steps", "anderson"]
    assert np.abs(result.shape - direct.shape).max() < 1e-9
    assert np.abs(result.solutions[0].displacement.x.array - direct.solutions[0].displacement.x.array).max() < 1e-9


def test_the_cascade_goes_on_to_the_next_and_gives_up_in_bounds(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fallbacks, "EFFORT", dict.fromkeys(fallbacks.EFFORT, 5))
    attempts_made = attempts(tried(sphere(30.0, radial=2, minimum_step=0.02), comm))
    print(attempts_made)
    assert [attempt.strategy for attempt in attempts_made] == ["load steps", "arc-length", "line-search"]
    assert attempts_made[1].outcome is Outcome.STEP_LIMIT
    assert all(
        attempt.factorizations <= 5 + 25 for attempt in attempts_made[1:]
    )  # the one that exceeds them is finished


@pytest.mark.release
def test_no_rescue_is_tried_beyond_a_limit_point(comm: MPI.Intracomm) -> None:
    """Beyond a limit point, and where no body can be in the state."""
    beyond_fold = attempts(tried(cube(1.25), comm))
    no_shape = job(
        mesh=SPHERE,
        material={"law": "mooney-rivlin", "c1": 0.5, "c2": 0.0, "d1": "incompressible"},
        effects=[{"effect": "pressure", "region": "inner", "pressure": 2.5}],
        supports=OCTANT,
    )
    print(beyond_fold)
    assert [attempt.strategy for attempt in beyond_fold] == ["arc-length"]
    # Load steps take the largest load for a limit point; the power series, which follows them, ends there.
    solves = tried(no_shape, comm)
    assert {solve.strategy for solve in solves} == {"load steps", "power series"}
    assert solves[-1].outcome is Outcome.VOLUME_CHANGED


def test_attempts_are_counted_by_strategy() -> None:
    iteration = NewtonIteration(1.0, 1.0, 1.0, True)
    solves = [
        Solve(0.5, Outcome.CONVERGED, (iteration,) * 2, 2),
        Solve(1.0, Outcome.DIVERGED, (iteration,) * 3, 3),
        Solve(0.7, Outcome.CONVERGED, (iteration,), 1, strategy="arc-length"),
        Solve(1.0, Outcome.ROUND_OFF, (iteration,), 1, strategy="arc-length"),
    ]
    assert attempts(solves) == [
        Attempt("load steps", 0.5, Outcome.DIVERGED, 2, 5, 5),
        Attempt("arc-length", 1.0, Outcome.ROUND_OFF, 2, 2, 2),
    ]
