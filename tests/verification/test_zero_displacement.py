"""States whose exact displacement is zero: held all round, or balanced, so that only the stress shows what acts.

The registry drives the tests: a new effect with an inelastic strain, or a stress of its own, is tested by its example.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.closed_forms import LAM, MU, NEO_HOOKEAN, neo_hookean_stress
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.job.job import Job
from hpcinv.output.result import Result
from hpcinv.physics.effects import Effect, effects
from hpcinv.trust.certificate import equilibrium_residual
from hpcinv.trust.certificate.check import Verdict
from hpcinv.trust.certificate.discretisation import DISCRETISATION
from hpcinv.trust.certificate.round_trip import ROUND_TRIP

STRETCH = 1.04
HEATED = {"effect": "thermal-expansion", "coefficient": "1e-3 1/K", "temperature_change": "40 K"}
HELD = [{"region": "boundary", "fix": ["x", "y", "z"]}]
ROLLERS = [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"]
FORMS = {
    "displacement": NEO_HOOKEAN,
    "mixed": {"law": "isochoric-neo-hookean", "mu": MU, "kappa": 100 * MU},
}
UPWARDS, DOWNWARDS = (
    {"effect": "gravity", "acceleration": [0, 0, g], "density": 1000} for g in ("9.81 m/s^2", "-9.81 m/s^2")
)


def strains_or_stresses_by_itself(kind: type[Effect]) -> bool:
    return kind.inelastic_strain is not Effect.inelastic_strain or kind.potential is not Effect.potential


EXAMPLES = {
    name: kind.model_validate(kind.example) for name, kind in effects().items() if strains_or_stresses_by_itself(kind)
}


def case(**data: Any) -> Job:
    common: dict[str, Any] = {
        "mesh": box((1, 1, 1), hexahedra=True),
        "material": FORMS["displacement"],
        "effects": [HEATED],
        "supports": HELD,
        "quantities": [{"name": "stress", "of": "sxx", "on": "block", "reduce": "mean"}],
    }
    return job(**(common | data))


def check(result: Result, comm: MPI.Intracomm, most: int) -> None:
    """Every solve is accepted, with few factorizations, and nothing moves."""
    for solution in result.solutions:
        largest = comm.allreduce(float(np.abs(solution.u).max(initial=0.0)), op=MPI.MAX)
        print(f"{solution.direction}: {solution.factorizations} factorizations, largest displacement {largest:.1e} m")
        assert all(solve.outcome.accepted for solve in solution.solves)
        assert solution.factorizations <= most
        assert largest < 1e-13


@pytest.mark.everyday(
    "active-stress-forward-displacement", "growth-forward-displacement", "thermal-expansion-forward-displacement"
)
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("direction", ["forward", "inverse"])
@pytest.mark.parametrize("name", EXAMPLES)
def test_body_held_all_round_is_solved_at_once(name: str, direction: str, form: str, comm: MPI.Intracomm) -> None:
    effect = EXAMPLES[name]
    families = {family: {"direction": [1, 0.5, 0.2], "given_on": "reference"} for family in effect.families}
    result = hpcinv.run(case(analysis=direction, material=FORMS[form], effects=[effect.example], fibres=families), comm)
    check(result, comm, most=1)
    assert abs(result.quantities["stress"]) > 1e-3 * MU


def heated_stress() -> float:
    """Stress at the elastic stretch 1/STRETCH in all directions."""
    F = np.eye(3) / STRETCH
    return float((neo_hookean_stress(F) @ F.T)[0, 0] / np.linalg.det(F))


STRATEGIES: dict[str, dict[str, Any]] = {
    "short steps": {"solver": {"initial_step": 0.2}},
    "fixed steps": {"solver": {"strategy": "fixed", "steps": 3}},
    "full Newton": {"solver": {"reuse_tangent": False}},
    "arc length": {"solver": {"strategy": "arc-length"}},
    "short arcs": {"solver": {"strategy": "arc-length", "initial_step": 0.1}},
    "iterative": {"solver": {"linear": "iterative"}},
    "line search": {"solver": {"petsc": {"snes_linesearch_type": "l2"}}},
    "single precision": {"solver": {"petsc": {"pc_precision": "single"}}},
    "Sellier": {"analysis": "inverse", "method": "sellier"},
    "Anderson": {"analysis": "inverse", "method": "anderson"},
    "round trip": {"analysis": "round_trip", "first": "inverse"},
    "there and back": {"analysis": "round_trip", "first": "forward"},
    "load cases": {"load_cases": ["first", "second"], "effects": [HEATED | {"case": "second"}]},
}


@pytest.mark.everyday(
    "fixed steps",
    "full Newton",
    "arc length",
    "iterative",
    "line search",
    "single precision",
    "Anderson",
    "there and back",
    "load cases",
)
@pytest.mark.parametrize("name", STRATEGIES)
def test_every_strategy_reaches_zero_displacement(name: str, comm: MPI.Intracomm) -> None:
    result = hpcinv.run(case(**({"analysis": "forward"} | STRATEGIES[name])), comm)
    check(result, comm, most=7)
    assert result.quantities["stress"] == pytest.approx(heated_stress(), rel=1e-10)


def in_balance_with(stretches: list[float]) -> list[dict[str, Any]]:
    """Pressures that pull with the stress of the elastic stretches that a prestrain leaves."""
    F = np.diag(1 / np.array(stretches))
    stress = neo_hookean_stress(F) @ F.T / np.linalg.det(F)
    prestrain = {"effect": "prestrain", "tensor": stretches, "given_on": "reference"}
    pulls = [{"effect": "pressure", "region": f"{a}1", "pressure": -stress[i, i]} for i, a in enumerate("xyz")]
    return [prestrain, *pulls]


BALANCES: dict[str, list[dict[str, Any]]] = {
    "loads and strains": [UPWARDS, DOWNWARDS, HEATED, {"effect": "growth", "stretch": 1 / STRETCH}],
    "strain and load": in_balance_with([1 / 1.1, 1.03, 1.02]),
}


@pytest.mark.everyday("forward")
@pytest.mark.parallel([2, 1])
@pytest.mark.parametrize("direction", ["forward", "inverse"])
def test_balanced_loads_move_nothing_and_pass(direction: str, comm: MPI.Intracomm) -> None:
    for name, in_balance in BALANCES.items() if direction == "forward" else [*BALANCES.items()][-1:]:
        result = hpcinv.run(
            case(analysis=direction, effects=in_balance, supports=ROLLERS, certificate="standard"), comm
        )
        print(name)
        check(result, comm, most=1)
        lines = {line.name: line for line in result.certificate.lines}
        print(*lines.values(), sep="\n")
        assert result.certificate.verdict is Verdict.PASS
        assert "loads and inelastic strains" in lines[DISCRETISATION.name].note
        assert "loads and inelastic strains" in lines[ROUND_TRIP.name].note


@pytest.mark.release
def test_held_under_its_weight_passes(comm: MPI.Intracomm) -> None:
    """An incompressible block in a box with a free top: p = ρ g (H - z), and nothing moves."""
    sides = [{"region": f"{axis}{end}", "fix": [axis]} for axis in "xy" for end in (0, 1)]
    given = case(
        analysis="forward",
        material={"law": "isochoric-neo-hookean", "mu": MU, "kappa": "incompressible"},
        effects=[DOWNWARDS],
        supports=[*sides, {"region": "z0", "fix": ["z"]}],
        certificate="standard",
    )
    result = hpcinv.run(given, comm)
    print(*result.certificate.lines, sep="\n")
    assert result.certificate.verdict is Verdict.PASS
    assert result.quantities["stress"] == pytest.approx(-1000 * 9.81 / 2, rel=1e-10)
    assert not result.totals.warnings


@pytest.mark.release
def test_units_change_nothing(comm: MPI.Intracomm) -> None:
    """The same body in units of length and stress that are a thousand and a million times as large."""
    results = [
        hpcinv.run(
            case(
                analysis="forward",
                mesh=box((2, 2, 2), hexahedra=True, lx=size, ly=size, lz=size),
                material={"law": "neo-hookean", "mu": MU * stress, "lam": LAM * stress},
            ),
            comm,
        )
        for size, stress in ((1.0, 1.0), (1e3, 1e6), (1e-3, 1e-6))
    ]
    assert {result.solutions[0].factorizations for result in results} == {1}
    stresses = [result.quantities["stress"] / factor for result, factor in zip(results, (1.0, 1e6, 1e-6), strict=True)]
    assert stresses == pytest.approx([heated_stress()] * 3, rel=1e-10)


def test_small_displacements_keep_their_digits(comm: MPI.Intracomm) -> None:
    """A strain of 1e-11: nothing is taken for a rounding error because it is small."""
    pulled = [
        hpcinv.run(
            case(
                analysis="forward",
                material=NEO_HOOKEAN,
                effects=[{"effect": "traction", "region": "x1", "traction": [load, 0, 0], "area_in": "reference"}],
                supports=ROLLERS,
            ),
            comm,
        )
        .solutions[0]
        .u
        for load in (1e-8, 2e-8)
    ]
    assert np.abs(pulled[1] - 2 * pulled[0]).max() < 1e-9 * np.abs(pulled[0]).max()


TURN = {"c": float(np.cos(0.7)), "s": float(np.sin(0.7))}


@pytest.mark.everyday("motion0", "motion3")
@pytest.mark.parametrize(
    ("direction", "motion"),
    [
        ("forward", {"motion": {"rotate": "40 deg", "axis": [0, 0, 1], "about": [0, 0, 0]}}),
        ("inverse", {"motion": {"rotate": "40 deg", "axis": [0, 0, 1], "about": [0, 0, 0]}}),
        ("forward", {"displacement": [0.013, 0.07, 0]}),
        ("inverse", {"displacement": [0.013, 0.07, 0]}),
    ],
)
def test_a_rigid_motion_has_no_residual(direction: str, motion: dict[str, Any], comm: MPI.Intracomm) -> None:
    moved = {"region": "x0"} | motion
    result = hpcinv.run(case(analysis=direction, effects=[], supports=[moved], certificate="quick"), comm)
    (line,) = (line for line in result.certificate.lines if line.topic == equilibrium_residual.EQUILIBRIUM)
    print(line.value, line.note)
    assert line.verdict == Verdict.PASS
    assert "move rigidly" in line.note
    assert line.value is not None
    assert line.value < 1e-9  # Newton's method ends at 1e-10 of the displacement


def test_rounding_errors_in_a_nearly_rigid_motion_do_not_fail(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Numbers with few digits strain a turned body a little, as in the decks of other programs."""
    monkeypatch.setattr(equilibrium_residual, "_RIGID", 0.0)  # such a body is hardly loaded, not rigid
    turned = ["x*(c - 1) - y*s*(1 + 1e-10)", "x*s + y*(c - 1)", 0]
    moved = {"region": "x0", "displacement": turned, "constants": TURN}
    result = hpcinv.run(case(analysis="forward", effects=[], supports=[moved], certificate="quick"), comm)
    (line,) = (line for line in result.certificate.lines if line.topic == equilibrium_residual.EQUILIBRIUM)
    assert line.value is not None
    assert line.value > 1e-3
    assert line.verdict == Verdict.UNDECIDED
