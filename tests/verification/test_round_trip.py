"""The certificate's round trip: what it costs, that it closes on a solution, and only there."""

from __future__ import annotations

from dataclasses import replace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from helpers.command_line import NO_CERTIFICATE
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.job.job import Job
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.trust.certificate import Line, Verdict
from hpcinv.trust.certificate import round_trip as module
from hpcinv.trust.certificate.round_trip import remaining, round_trip
from hpcinv.trust.stability import inertia
from hpcinv.trust.stability.forward_factors import ForwardFactors

GRAVITY = {"effect": "gravity", "acceleration": [0, 0, -0.15], "density": 1000}
FOLLOWER = {"effect": "pressure", "region": "z1", "pressure": 100.0}
LAWS = {
    "displacement": {"law": "neo-hookean", "young": "10 kPa", "poisson": 0.3},
    "mixed": {"law": "isochoric-neo-hookean", "mu": "4 kPa", "kappa": "incompressible"},
}


def cantilever(
    direction: str, form: str, *, curved: bool = True, effect: dict[str, Any] = GRAVITY, **changes: Any
) -> Job:
    """It bends by about a third of its length or more."""
    return job(
        analysis=direction,
        mesh=box((5, 1, 1), lx=3.0) | {"geometry_degree": 2 if curved else 1},
        material=LAWS[form],
        effects=[effect],
        supports=[{"region": "x0", "fix": ["x", "y", "z"]}],
        **{"certificate": NO_CERTIFICATE | {"round_trip": "near"}, **changes},
    )


class Case:
    """A job, its model and its solution."""

    def __init__(self, case_job: Job, comm: MPI.Intracomm) -> None:
        without = case_job.model_copy(update={"certificate": type(case_job.certificate).model_validate("off")})
        result = hpcinv.run(without, comm)
        self.job, self.solution = case_job, result.solutions[0]
        self.model = Equations(case_job, result.body, Timings())

    def line(self, solution: Solution | None = None, start: str = "near") -> Line:
        certificate = self.job.certificate.model_copy(update={"round_trip": start})
        job = self.job.model_copy(update={"certificate": certificate})
        solution = replace(solution or self.solution, job=job)
        forward = ForwardFactors(self.model, solution)
        (line,) = round_trip(self.model, solution, forward)
        forward.destroy()
        print(f"{start}: {line.verdict.value} {line.value} {line.note[:70]}")
        return line

    def perturbed(self, change: Any) -> Solution:
        """The solution with a displacement that is changed by a function of it and of the positions (scaled)."""
        u = self.solution.displacement.copy()
        x = u.function_space.tabulate_dof_coordinates()
        u.x.array[:] = change(u.x.array.reshape(-1, 3), x).ravel()
        return replace(self.solution, displacement=u, u=self.model.unknowns.geometry_values(u))


@pytest.mark.everyday("displacement-forward")
@pytest.mark.parallel([2, 1])
@pytest.mark.parametrize("direction", ["inverse", "forward"])
@pytest.mark.parametrize("form", ["displacement", "mixed"])
def test_near_the_solution_as_along_the_path(direction: str, form: str, comm: MPI.Intracomm) -> None:
    effects = (GRAVITY, FOLLOWER) if direction == "inverse" else (FOLLOWER, GRAVITY)
    for curved, effect in zip((True, False), effects, strict=True):
        case = Case(cantilever(direction, form, curved=curved, effect=effect), comm)
        near, path = case.line(), case.line(start="path")
        assert near.value is not None
        assert path.value is not None
        if curved:
            assert max(near.value, path.value) < 1e-8
            assert near.verdict is path.verdict is Verdict.PASS
        else:
            assert near.value == pytest.approx(path.value, rel=0.15, abs=1e-5)
            assert near.verdict is path.verdict


CHANGES = {
    "one hundredth too much": lambda u, x: 1.01 * u,
    "one part": lambda u, x: u + 0.01 * np.abs(u).max() * np.sin(3 * x[:, [1, 2, 0]] / x.max()) * (x[:, :1] / x.max()),
    "another load": lambda u, x: 0.5 * u,
    "none": lambda u, x: 0.0 * u,
}


@pytest.mark.everyday("True-displacement-inverse", "False-displacement-forward")
@pytest.mark.parametrize("direction", ["inverse", "forward"])
@pytest.mark.parametrize("form", ["displacement", "mixed"])
@pytest.mark.parametrize("curved", [True, False])
def test_perturbed_solutions_fail_the_round_trip(direction: str, form: str, curved: bool, comm: MPI.Intracomm) -> None:
    case = Case(cantilever(direction, form, curved=curved), comm)
    for name, change in CHANGES.items():
        print(name)
        assert case.line(case.perturbed(change)).verdict is not Verdict.PASS


# Forward, the factors of the solve serve.
@pytest.mark.everyday("inverse-True", "forward-False")
@pytest.mark.parametrize(
    ("direction", "curved", "factorizations"), [("inverse", True, 1), ("inverse", False, 1), ("forward", False, 0)]
)
def test_one_factorization_serves_round_trip_and_stability(
    direction: str, curved: bool, factorizations: int, comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    factorize = Mock(wraps=inertia._factorized)
    monkeypatch.setattr(inertia, "_factorized", factorize)
    certificate = NO_CERTIFICATE | {"round_trip": "near", "stability": True}
    cantilever_job = cantilever(direction, "mixed", curved=curved, certificate=certificate)
    result = hpcinv.run(cantilever_job, comm)
    assert factorize.call_count == factorizations
    verdicts = {line.name.split(",")[0]: line.verdict for line in result.certificate.lines}
    assert verdicts["stability: unstable directions"] is Verdict.PASS
    assert verdicts["round trip"] is not Verdict.SKIPPED


def test_without_factors_newton_solves_the_return(comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch) -> None:
    """As where there is no memory for them, or where the corrections with them do not settle."""
    case = Case(cantilever("forward", "mixed", curved=False), comm)
    with_factors = case.line().value
    for name, value in (("_CORRECTIONS", 0), ("_GROWTH", 0.0)):
        with monkeypatch.context() as patch:
            patch.setattr(module, name, value)
            assert case.line().value == pytest.approx(with_factors, rel=0.1)
    monkeypatch.setattr(ForwardFactors, "factors", None)
    assert case.line().value == pytest.approx(with_factors, rel=0.1)


@pytest.mark.everyday("inverse-straight")
@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("curved", [True, False], ids=["curved", "straight"])
@pytest.mark.parametrize("direction", ["inverse", "forward"])
def test_multigrid_stands_in_for_factors(
    direction: str, curved: bool, comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in bodies whose factorization takes too long: no Newton's method begins, and the value is the same."""
    case = Case(cantilever(direction, "mixed", curved=curved), comm)
    with_factors = case.line()
    monkeypatch.setattr(ForwardFactors, "affordable", False)
    monkeypatch.setattr(Equilibrium, "solve", lambda *_, **__: pytest.fail("the round trip is solved again"))
    line = case.line()
    assert line.verdict is with_factors.verdict
    assert line.value == pytest.approx(with_factors.value, rel=0.15, abs=1e-5)


def test_limit_of_a_geometric_sequence() -> None:
    assert remaining([1.0]) == float("inf")
    assert remaining([1.0, 0.5, 0.25]) == pytest.approx(0.25)
    assert remaining([1.0, 0.5, 0.001]) == pytest.approx(0.001)  # one good step proves no contraction
    assert remaining([1e-3, 2e-3]) == float("inf")
    assert remaining([1e-3, 1e-12]) == 1e-12  # of rounding errors
    assert remaining([1e-3, float("nan")]) != remaining([1e-3, 1e-4])
