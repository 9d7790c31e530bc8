"""Derivatives of bodies that are tied, slide, press on each other, stick and rub, by differences of whole runs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.command_line import NO_CERTIFICATE
from helpers.verification import job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.keys import assigned
from hpcinv.errors import JobError
from hpcinv.solver.workspace import Workspace

WEIGHT: dict[str, Any] = {"effect": "gravity", "acceleration": [0.02, 0.01, -0.1], "density": 1.0}
PUSH: dict[str, Any] = {"effect": "traction", "region": "z1", "traction": [0.02, 0.01, -0.1], "area_in": "reference"}
GIVEN: dict[str, Any] = {
    "mesh": {
        "file": "../meshes/two_blocks.py",
        "parameters": {"lower": 3, "upper": 2, "margin": 0.3, "lower_height": 0.4, "upper_height": 0.3},
    },
    "material": {
        "lower": {"law": "neo-hookean", "mu": 2.0, "lam": 3.0},
        "upper": {"law": "neo-hookean", "mu": 1.0, "lam": 2.0},
    },
    "solver": {"tolerance": 1e-13, "strategy": "fixed", "steps": 1},
    "discretisation": {"displacement": 1},
    "effects": [WEIGHT],
    "supports": [{"region": "z0", "fix": ["x", "y", "z"]}],
    "quantities": [
        {"name": "travel", "of": "norm(ux, uy, uz)", "on": "bottom", "reduce": "mean"},
        {"name": "stress", "of": "szz", "on": "top", "reduce": "mean"},
    ],
    "certificate": NO_CERTIFICATE,
}
VALUES = {"material.upper.mu": 1.0, "material.lower.lam": 3.0, "effects[0].density": 1.0}
LIFT = {"region": "z1", "displacement": ["0.02", "0.01", "lift"], "constants": {"lift": -0.03}}
MOVED = [GIVEN["supports"][0], LIFT]
KINDS: dict[str, tuple[str, dict[str, Any], dict[str, Any]]] = {
    "tied": ("inverse", {"kind": "tied"}, {"effects": [WEIGHT, PUSH]}),
    "sliding": ("forward", {"kind": "sliding"}, {"supports": MOVED}),
    "pressed": ("forward", {"kind": "contact"}, {"supports": MOVED}),
    "conforming": ("inverse", {"kind": "contact", "closure": "conforming"}, {"supports": MOVED}),
    "sticks": ("forward", {"kind": "contact", "friction": 2.0}, {"effects": [WEIGHT, PUSH]}),
    "slides": ("forward", {"kind": "contact", "friction": 0.1}, {"supports": MOVED}),
    "rubs": ("inverse", {"kind": "contact", "friction": 0.3, "closure": "coulomb"}, {"supports": MOVED}),
}
STEP = 1e-4


def posed(kind: str) -> dict[str, Any]:
    analysis, interface, data = KINDS[kind]
    return GIVEN | {"analysis": analysis, "interfaces": [{"between": ["bottom", "top"], **interface}]} | data


@pytest.mark.everyday("pressed")
@pytest.mark.parallel([2, 1])
@pytest.mark.parametrize("kind", KINDS)
def test_slopes_are_differences_of_runs(kind: str, comm: MPI.Intracomm) -> None:
    given, values = posed(kind), dict(VALUES)
    if given["supports"] is MOVED:
        values["supports[1].constants.lift"] = -0.03
    rates = {key: value * (1 + 0.7 * place) * (-1) ** place for place, (key, value) in enumerate(values.items())}
    with Workspace(comm) as workspace:

        def found(**changes: Any) -> Any:
            return hpcinv.run(job(**given | changes), comm, workspace=workspace)

        ahead, behind = (
            found(**assigned(given, {key: values[key] + step * rate for key, rate in rates.items()})).quantities
            for step in (STEP, -STEP)
        )
        result = found(sensitivities=list(values))
        expected = {name: (np.array(ahead[name]) - behind[name]) / (2 * STEP) for name in ahead}
        slopes, weights = result.sensitivities.slopes, {"travel": 2.0, "stress": 0.5}
        gradient = result.vjp(weights).numbers
        along = result.jvp(rates)
    for name, value in expected.items():
        total = sum(rate * np.array(slopes[name][key]) for key, rate in rates.items())
        assert total == pytest.approx(value, rel=1e-5, abs=1e-7 * np.abs(value).max())
        assert along[name] == pytest.approx(total, rel=1e-8, abs=1e-10)
    weighted = sum(weights[name] * float(value) for name, value in expected.items())
    assert sum(rate * gradient[key] for key, rate in rates.items()) == pytest.approx(weighted, rel=1e-5)
    assert "stays so" in result.sensitivities.assumption


@pytest.mark.parametrize(
    ("data", "match"),
    [
        ({"solver": {}}, r"friction: is not possible with derivatives, since its slip depends on the load steps"),
        ({"load_cases": ["one", "two"]}, "friction: is not possible with derivatives"),
    ],
)
def test_slip_of_several_steps_has_no_derivatives(data: dict[str, Any], match: str) -> None:
    with pytest.raises(JobError, match=match):
        job(**posed("sticks") | {"sensitivities": ["material.upper.mu"]} | data)
