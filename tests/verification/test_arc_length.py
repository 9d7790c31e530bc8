"""Arc-length continuation: limit points of the load, and the states beyond them, against closed forms."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.closed_forms import NEO_HOOKEAN, root
from helpers.paths import J_LIMIT, LIMIT, cube, tension
from helpers.small_systems import SmallSystem
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.errors import Interrupted, JobError, SolveError
from hpcinv.model.outcome import Outcome
from hpcinv.output.progress import Progress
from hpcinv.output.result import Result
from hpcinv.solver.arc_length import ArcLengthSteps
from hpcinv.solver.bordering import Bordering
from hpcinv.solver.equilibrium_path import EquilibriumPath
from hpcinv.solver.newton import Solve
from hpcinv.solver.observer import SolveEvent
from hpcinv.trust.certificate.check import Verdict

# Small systems of equations, without finite elements.


def force(w: float) -> float:
    """Of a shallow truss: it turns at ``w = 1 ∓ 1/√3``, where it is ±`TOP`."""
    return w * (w - 1) * (w - 2)


TOP, TURNS = 2 / 3**1.5, (1 - 3**-0.5, 1 + 3**-0.5)


def truss(full: float) -> SmallSystem:
    """``λ full = force(w)``."""
    return SmallSystem(
        1,
        lambda x, load: np.array([force(x[0]) - load * full]),
        lambda x: np.array([[3 * x[0] ** 2 - 6 * x[0] + 2]]),
    )


def truss_and_spring(full: float, k: float) -> SmallSystem:
    """The truss pushed through a spring: with a soft one its other end goes back as well (snap-back)."""
    return SmallSystem(
        2,
        lambda x, load: np.array([force(x[0]) - k * (x[1] - x[0]), k * (x[1] - x[0]) - load * full]),
        lambda x: np.array([[3 * x[0] ** 2 - 6 * x[0] + 2 + k, -k], [-k, k]]),
    )


def test_the_first_state_at_full_load_is_the_answer_if_the_load_does_not_turn_before() -> None:
    system = truss(0.9 * TOP)
    *_, last = EquilibriumPath(system.equilibrium(), 1e-12).follow(ArcLengthSteps())
    assert (last.outcome, last.load, last.strategy) == (Outcome.CONVERGED, 1.0, "arc-length")
    assert system.x.array[0] == pytest.approx(root(lambda w: force(w) - 0.9 * TOP, 0.0, TURNS[0]), rel=1e-10)


@pytest.mark.parametrize("first", [1.0, 0.3, 0.05])
def test_the_limit_point_is_found_and_ends_the_path(first: float) -> None:
    system = truss(1.5 * TOP)
    solves = list(EquilibriumPath(system.equilibrium(), 1e-12).follow(ArcLengthSteps(first)))
    assert [s.limit_point for s in solves[-2:]] == [True, False]
    assert solves[-1].outcome is Outcome.LIMIT_POINT
    assert solves[-1].load * 1.5 == pytest.approx(1.0, abs=1e-8)
    assert system.x.array[0] == pytest.approx(TURNS[0], abs=1e-4)


@pytest.mark.parametrize(
    ("share", "limit_points", "low", "high"), [(0.9, 1, TURNS[0], 1.0), (0.9, 2, 2.0, 3.0), (1.5, 2, 2.0, 3.0)]
)
def test_states_beyond_limit_points_are_found_in_order(
    share: float, limit_points: int, low: float, high: float
) -> None:
    system = truss(share * TOP)
    solves = list(EquilibriumPath(system.equilibrium(), 1e-12).follow(ArcLengthSteps(limit_points=limit_points)))
    assert sum(s.limit_point for s in solves) == limit_points
    assert (solves[-1].outcome, solves[-1].load) == (Outcome.CONVERGED, 1.0)
    assert system.x.array[0] == pytest.approx(root(lambda w: force(w) - share * TOP, low, high), rel=1e-10)


def test_a_branch_that_ends_in_one_more_limit_point_than_allowed_says_so() -> None:
    """Beyond the maximum the load falls to its minimum at -TOP, and never meets the full load on the way."""
    system = truss(1.5 * TOP)
    solves = list(EquilibriumPath(system.equilibrium(), 1e-12).follow(ArcLengthSteps(limit_points=1)))
    assert [s.load * 1.5 for s in solves if s.limit_point] == pytest.approx([1.0, -1.0], abs=1e-7)
    assert solves[-1].outcome is Outcome.LIMIT_POINT


def test_snap_back_is_followed() -> None:
    k = 0.2  # the whole path goes back where force'(w) < -k
    system = truss_and_spring(1.5 * TOP, k)
    ends = []
    solves = []
    for solve in EquilibriumPath(system.equilibrium(), 1e-12).follow(ArcLengthSteps(limit_points=2)):
        solves.append(solve)
        ends.append(system.x.array[1])
    w = root(lambda w: force(w) - 1.5 * TOP, 2.0, 3.0)
    assert system.x.array == pytest.approx([w, w + 1.5 * TOP / k], rel=1e-10)
    assert solves[-1].outcome.accepted
    assert min(np.diff(ends)) < 0  # the loaded end has moved against its load


def test_the_search_is_bounded() -> None:
    """A load that nears its limit for ever: ``λ = 1 - exp(-x)``."""
    system = SmallSystem(
        1, lambda x, load: np.array([1 - np.exp(-x[0]) - 2 * load]), lambda x: np.array([[np.exp(-x[0])]])
    )
    solves = list(EquilibriumPath(system.equilibrium(), 1e-12).follow(ArcLengthSteps(most=12, easy=0, first=0.2)))
    assert solves[-1].outcome is Outcome.STEP_LIMIT
    assert len(solves) <= 13


def test_a_correction_that_wanders_to_another_path_fails() -> None:
    """The paths are ``x = (λ, y)`` with ``y`` = -1, 0 or 1; from 0.45 corrections grow twice, then reach -1."""
    system = SmallSystem(
        2,
        lambda x, load: np.array([x[0] - load, x[1] ** 3 - x[1]]),
        lambda x: np.diag([1.0, 3 * x[1] ** 2 - 1]),
    )
    t, bordering = system.position(), Bordering(system.equilibrium(reuse=0.0))
    t.array[:] = 1.0, 0.0
    ends = {}
    for y in (0.2, 0.45):
        start = system.position()
        start.array[:] = 0.5, y
        corrected = bordering.correct(start, 0.5, t, 1e-10, direction=1, scale=1.0)
        ends[y] = corrected.solve.outcome
        assert not corrected.solve.outcome.accepted or abs(corrected.x.array[1]) < 1e-8
    assert ends == {0.2: Outcome.CONVERGED, 0.45: Outcome.DIVERGED}


# A cube under tension from all sides.


@pytest.mark.release
@pytest.mark.parametrize("analysis", ["inverse", pytest.param("forward", marks=pytest.mark.release)])
@pytest.mark.parallel([2])
def test_two_shapes_carry_the_same_tension(analysis: str, comm: MPI.Intracomm) -> None:
    for limit_points, low, high in ((0, 1.0, J_LIMIT), (1, J_LIMIT, 20.0)):
        result = hpcinv.run(cube(0.9, analysis, limit_points=limit_points), comm)
        J = root(lambda J: tension(J) - 0.9 * LIMIT, low, high)
        ratios = result.solutions[0].J.x.array
        print(f"{analysis}, {limit_points} limit points: J = {ratios[0]:.10f}, closed form {J:.10f}")
        assert np.abs(ratios - J).max() < 1e-9 * J
        assert sum(s.limit_point for s in result.solutions[0].solves) == limit_points


@pytest.mark.release
def test_the_certificate_says_that_another_shape_carries_the_same_load(comm: MPI.Intracomm) -> None:
    given = cube(0.9, limit_points=1)
    asked = given.model_copy(update={"certificate": given.certificate.model_copy(update={"stability": True})})
    lines = {line.name: line for line in hpcinv.run(asked, comm).certificate.lines}
    line = lines["limit points of the path"]
    assert (line.value, line.verdict) == (1.0, Verdict.WARN)
    assert "it reaches the full load once before" in line.note


@pytest.mark.release
@pytest.mark.parametrize("analysis", ["inverse", "forward"])
def test_the_largest_tension_is_reported(analysis: str, comm: MPI.Intracomm, run_directory: Path) -> None:
    with pytest.raises(SolveError, match=r"the load reaches its maximum on this path \(limit point\)") as caught:
        hpcinv.run(cube(1.25, analysis), comm)
    reached = float(str(caught.value).split("load factor ")[1].split(" of")[0])
    assert reached == pytest.approx(0.8, abs=1e-5)


@pytest.mark.parallel([2, 1])
def test_a_run_interrupted_beyond_the_limit_point_goes_on_there(comm: MPI.Intracomm, run_directory: Path) -> None:
    file = run_directory / "cube.yaml"
    on_root(comm, lambda: file.write_text(cube(0.9, limit_points=1).model_dump_json(exclude_unset=True)))
    job, solves = hpcinv.load(file), list[Solve]()

    class Listener(Progress):
        def solved(self, event: SolveEvent) -> None:
            solves.append(event.solve)

    def beyond() -> bool:
        return any(solve.limit_point for solve in solves)

    with pytest.raises(Interrupted):
        hpcinv.run(job, comm, directory=run_directory / "run", progress=Listener(comm, None), stop_asked=beyond)
    result = hpcinv.run(job, comm, directory=run_directory / "run", resume=True)
    J = root(lambda J: tension(J) - 0.9 * LIMIT, J_LIMIT, 20.0)
    assert np.abs(result.solutions[0].J.x.array - J).max() < 1e-9 * J
    assert sum(s.limit_point for s in result.solutions[0].solves) == 1


# The rest


@pytest.mark.release
def test_load_cases_and_prescribed_displacements(comm: MPI.Intracomm) -> None:
    """The same state as by load steps, with the path's corners at the ends of the cases."""

    def pushed(**solver: Any) -> Result:
        return hpcinv.run(
            job(
                analysis="forward",
                mesh=box((2, 1, 1), hexahedra=True),
                material=NEO_HOOKEAN,
                load_cases=["push", "weight", "pull"],
                effects=[{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 300, "case": "weight"}],
                supports=[
                    {"region": "x0", "fix": ["x", "y", "z"]},
                    {"region": "x1", "displacement": ["-0.2 m", None, None], "case": "push"},
                    {"region": "z1", "displacement": [None, "0.1*x", None], "case": "pull"},
                ],
                solver=solver,
            ),
            comm,
        )

    arc = pushed(strategy="arc-length", initial_step=0.4)
    assert {1 / 3, 2 / 3} < {s.load for s in arc.solutions[0].solves}
    assert np.abs(arc.shape - pushed().shape).max() < 1e-10


@pytest.mark.parametrize(
    ("solver", "complaint"),
    [
        (
            {"limit_points": 1},
            "solver.limit_points: is not valid with 'strategy: adaptive'; remove it, or choose 'strategy: arc-length'",
        ),
        ({"strategy": "fixed", "rescue": []}, "solver.rescue: is not valid with 'strategy: fixed'"),
        ({"strategy": "arc-length", "steps": 3}, "solver.steps: is not valid with 'strategy: arc-length'"),
        ({"strategy": "arc-length", "limit_points": -1}, "solver.limit_points: "),
        ({"rescue": ["prayer"]}, "solver.rescue"),
    ],
)
def test_options_without_use_are_refused(solver: dict[str, Any], complaint: str) -> None:
    with pytest.raises(JobError) as caught:
        job(mesh=box(), material=NEO_HOOKEAN, supports=[{"region": "x0", "fix": ["x", "y", "z"]}], solver=solver)
    assert complaint in str(caught.value)
