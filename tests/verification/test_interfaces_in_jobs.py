"""Interfaces with other parts of a job: stopped runs, jobs that share their equations, rigid obstacles."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.verification import job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import Interrupted
from hpcinv.job.job import Job
from hpcinv.model.interfaces.pair import SurfacePair
from hpcinv.model.outcome import Outcome
from hpcinv.output.result import Result
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.solver.newton import Solve
from hpcinv.solver.workspace import Workspace

BOTH = ["bottom", "top"]
GIVEN: dict[str, Any] = {
    "mesh": {"file": "../meshes/two_blocks.py", "parameters": {"lower": 1, "upper": 2}},
    "material": {"law": "neo-hookean", "mu": 1.0, "lam": 2.0},
    "solver": {"tolerance": 1e-12, "strategy": "fixed", "steps": 2},
    "discretisation": {"displacement": 1},
    "effects": [{"effect": "gravity", "acceleration": [0.05, 0, -0.2], "density": 1.0}],
    "supports": [{"region": "z0", "fix": ["x", "y", "z"]}, {"region": "z1", "displacement": [0, 0, -0.05]}],
    "quantities": [{"name": "travel", "of": "norm(ux, uy, uz)", "on": "bottom", "reduce": "mean"}],
}
KINDS: dict[str, tuple[dict[str, Any], list[str]]] = {
    "tied": ({"kind": "tied"}, ["inverse", "forward"]),
    "sliding": ({"kind": "sliding"}, ["forward", "inverse"]),
    "conforming": ({"kind": "contact", "closure": "conforming"}, ["inverse", "forward"]),
    "least": ({"kind": "contact", "closure": "least-energy"}, ["inverse", "forward"]),
    "pressure": ({"kind": "contact", "closure": "pressure", "pressure": "0.02*(1 + x)"}, ["inverse", "forward"]),
    "given": ({"kind": "contact", "closure": "given"}, ["forward", "inverse"]),
    "rubbed": ({"kind": "contact", "closure": "given", "friction": 0.3}, ["forward", "inverse"]),
}


def posed(kind: str, **data: Any) -> Job:
    interface, directions = KINDS[kind]
    analysis = {"analysis": "round_trip", "first": directions[0]}
    return job(**GIVEN | {"interfaces": [{"between": BOTH, **interface}]} | analysis | data)


def after_iterations(number: int) -> Callable[[], bool]:
    """Ask to stop after a number of iterations."""
    left = [number]

    def stop_asked() -> bool:
        left[0] -= 1
        return left[0] < 0

    return stop_asked


def results_of(result: Result) -> np.ndarray:
    forces = [solution.contacts[0].force for solution in result.solutions]
    return np.array([*np.ravel(forces), result.quantities["travel"], result.errors["round_trip"]["max"]])


@pytest.mark.release
@pytest.mark.parallel(2)
@pytest.mark.parametrize(
    ("kind", "from_end"),
    [
        ("tied", 8),
        ("sliding", 2),
        ("conforming", 12),
        ("given", 2),
        ("least", 2),
        ("rubbed", 2),
    ],
)
def test_stopped_runs_resume_on_another_number_of_ranks(
    kind: str, from_end: int, comm: MPI.Intracomm, run_directory: Path
) -> None:
    """Stops are in the second solve: the multipliers of the first one are not in a checkpoint."""
    whole = hpcinv.run(posed(kind), comm)
    iterations = sum(len(solve.iterations) for solution in whole.solutions for solve in solution.solves)
    with pytest.raises(Interrupted):
        hpcinv.run(posed(kind), comm, directory=run_directory, stop_asked=after_iterations(iterations - from_end))
    resumed = None
    if comm.rank == 0:
        resumed = results_of(hpcinv.run(posed(kind), MPI.COMM_SELF, directory=run_directory, resume=True))
    assert np.abs(comm.bcast(resumed) - results_of(whole)).max() < 1e-10


@pytest.mark.parallel(2)
@pytest.mark.parametrize(
    ("strategy", "error"),
    [
        ({"strategy": "fixed", "steps": 1}, 1e-9),
        # Surfaces are searched at predicted states, which a resumed run predicts by another tangent; lost slip is 3e-2.
        pytest.param({"initial_step": 0.3}, 1e-3, marks=pytest.mark.release),
    ],
    ids=["fixed", "adaptive"],
)
def test_slip_of_earlier_steps_is_in_a_checkpoint(
    strategy: dict[str, Any], error: float, comm: MPI.Intracomm, run_directory: Path
) -> None:
    """The block is pressed on, then dragged: the end depends on the slip between."""
    push = {"effect": "traction", "region": "z1", "traction": [0, 0, -0.1], "area_in": "reference", "case": "press"}
    drag = {"region": "z1", "displacement": [0.04, 0.03, None], "case": "drag"}
    data: dict[str, Any] = {"analysis": "forward", "effects": [push], "load_cases": ["press", "drag"]}
    data |= {"supports": [GIVEN["supports"][0], drag], "solver": {"tolerance": 1e-12} | strategy}
    data |= {"interfaces": [{"between": BOTH, "kind": "contact", "friction": 0.3}], "certificate": {"level": "quick"}}
    given = job(**GIVEN | data)

    def end_of(result: Result) -> np.ndarray:
        (contact,) = result.solutions[0].contacts
        assert contact.friction is not None
        return np.array([*contact.force, result.quantities["travel"], contact.friction.energy_lost])

    whole = hpcinv.run(given, comm)
    on_the_way = [solve for solve in whole.solutions[0].solves if solve.load < 1.0]
    asked = sum(len(solve.iterations) + 2 for solve in on_the_way)  # also before and after each solve
    with pytest.raises(Interrupted, match="its state is saved"):
        hpcinv.run(given, comm, directory=run_directory, stop_asked=after_iterations(asked + 1))
    resumed = None
    if comm.rank == 0:
        resumed = end_of(hpcinv.run(given, MPI.COMM_SELF, directory=run_directory, resume=True))
    found, expected = comm.bcast(resumed), end_of(whole)
    assert found[:4] == pytest.approx(expected[:4], rel=error, abs=1e-12)
    assert found[4] == pytest.approx(expected[4], rel=20 * error)  # energy


@pytest.mark.everyday("sliding")
@pytest.mark.parametrize("kind", [pytest.param("tied", marks=pytest.mark.release), "sliding", "given", "pressure"])
def test_cases_that_share_their_equations_equal_single_jobs(kind: str) -> None:
    changes: dict[str, Any] = {"material": {"law": "neo-hookean", "mu": 1.7, "lam": 2.0}}
    changes["supports"] = [GIVEN["supports"][0], {"region": "z1", "displacement": [0, 0, -0.03]}]
    with Workspace(MPI.COMM_SELF) as workspace:
        first, shared = (hpcinv.run(posed(kind, **data), MPI.COMM_SELF, workspace=workspace) for data in ({}, changes))
    single = hpcinv.run(posed(kind, **changes), MPI.COMM_SELF)
    assert np.abs(results_of(shared) - results_of(single)).max() < 1e-10
    assert np.abs(results_of(shared) - results_of(first)).max() > 1e-3


@pytest.mark.release
def test_a_body_on_an_interface_leans_on_a_rigid_wall() -> None:
    """Tolerances of the wall are far above the interface's, which would follow the last digits of the wall's pressure.

    The resultants of all contacts and the supports add up to the weight.
    """
    wall = {
        "effect": "contact",
        "region": "x1",
        "obstacle": {"shape": "plane", "point": [1, 0, 0], "normal": [-1, 0, 0]},
    }
    lean = {"effect": "gravity", "acceleration": [0.1, 0, -0.05], "density": 1.0}
    interfaces = [{"between": BOTH, "kind": "sliding"}]
    given = {key: value for key, value in GIVEN.items() if key not in ("quantities", "solver")}
    data = given | {"effects": [lean, wall], "interfaces": interfaces, "analysis": "forward"}
    obstacle, interface = hpcinv.run(job(**data), MPI.COMM_SELF).solutions[0].contacts
    assert obstacle.force[0] < -1e-3
    assert interface.force[2] > 0.02
    assert interface.tolerance is not None
    assert interface.penetration <= interface.tolerance


def test_half_of_an_update_is_taken_back_after_a_solve_that_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first solve after an update of the multipliers is said to fail; the next one has half of the update."""
    solve, halve, seen = Equilibrium.solve, SurfacePair.halve_update, list[np.ndarray]()

    def failing(self: Equilibrium, *given: Any, **wanted: Any) -> Solve:
        is_first = wanted.get("keeps", False) and not seen
        return Solve(1.0, Outcome.DIVERGED, (), 0) if is_first else solve(self, *given, **wanted)

    def seeing(self: SurfacePair) -> None:
        seen.append(self.multipliers)
        halve(self)
        seen.append(self.multipliers)

    monkeypatch.setattr(Equilibrium, "solve", failing)
    monkeypatch.setattr(SurfacePair, "halve_update", seeing)
    interface = {"between": BOTH, "kind": "contact", "friction": 0.3}
    effects = [{"effect": "gravity", "acceleration": [0, 0, -0.2], "density": 1.0}]
    given = GIVEN | {"solver": {"tolerance": 1e-12}, "effects": effects, "quantities": []}
    result = hpcinv.run(job(**given, analysis="forward", interfaces=[interface]), MPI.COMM_SELF)
    whole, half = seen
    assert np.abs(whole).max() > 0.01
    assert half == pytest.approx(whole / 2, abs=1e-15)  # there were none before
    assert result.solutions[0].contacts[0].largest_pressure > 0.01
