"""Lines of the certificate on limit points, along paths and between equilibria."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from helpers.certificate_cases import column, line
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.model.outcome import Outcome
from hpcinv.solver.linear.factorization import Direct
from hpcinv.solver.linear.refined import Refined
from hpcinv.solver.newton import Solve
from hpcinv.trust.certificate import Verdict
from hpcinv.trust.certificate import limit_points as module
from hpcinv.trust.certificate.check import skipped
from hpcinv.trust.certificate.limit_points import LIMIT_POINTS, limit_points
from hpcinv.trust.certificate.stability import STABILITY


@pytest.mark.everyday("2-pressures0", "3-pressures1")
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
    limit_line = line(hpcinv.run(grown, comm), LIMIT_POINTS.name)
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
    monkeypatch.setattr(module, "_precise_sign", lambda *_: 0)
    solves = tuple(Solve(1.0, Outcome.CONVERGED, (), 1, of_solve) for of_solve in signs)
    model: Any = SimpleNamespace(unknowns=SimpleNamespace(unloaded_sign=unloaded, p=None))
    own = SimpleNamespace(solver=SimpleNamespace(start_shape=None))
    solution: Any = SimpleNamespace(solves=solves, start=start, job=own)
    (path_line,) = limit_points(model, solution, skipped(STABILITY, ""))
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
    (path_line,) = limit_points(model, solution, skipped(STABILITY, ""))
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
    assert next(line for line in lines if line.topic == LIMIT_POINTS).verdict is verdict


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
    (path_line,) = limit_points(model, solution, skipped(STABILITY, ""))
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
    monkeypatch.setattr(module, "_precise_sign", lambda *_: 0)
    solves = tuple(Solve(1.0, Outcome.CONVERGED, (), 1, signs, strategy=strategy) for strategy in strategies)
    model: Any = SimpleNamespace(unknowns=SimpleNamespace(unloaded_sign=1, p=None))
    solution: Any = SimpleNamespace(solves=solves, start="")
    (path_line,) = limit_points(model, solution, skipped(STABILITY, ""))
    assert path_line.verdict is verdict
