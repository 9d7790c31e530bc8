"""Parts that contact alone holds: a block that lies on another one, with weight and pressure on it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.verification import job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import MeshError
from hpcinv.model.interfaces import pins
from hpcinv.output.result import Result

AREA, HEIGHT = 0.1**2, 0.03
GIVEN: dict[str, Any] = {
    "mesh": {
        "file": "../meshes/two_blocks.py",
        "parameters": {"lx": 0.1, "ly": 0.1, "lower_height": HEIGHT, "upper_height": HEIGHT, "hexahedra": True},
    },
    "material": {"law": "neo-hookean", "young": 1e4, "poisson": 0.3},
    "solver": {"tolerance": 1e-12},
    "discretisation": {"displacement": 1},
    "supports": [{"region": "z0", "fix": ["x", "y", "z"]}],
    "effects": [
        {"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 1000.0},
        {"effect": "traction", "region": "z1", "traction": [0, 0, -400], "area_in": "reference"},
    ],
}
SLANTED = {"effects": [GIVEN["effects"][0] | {"acceleration": [0.5, 0, -9.81]}, GIVEN["effects"][1]]}


def solved(comm: MPI.Intracomm, closure: str = "", **data: Any) -> Result:
    assumed = {"closure": closure} if closure else {}
    interfaces = [{"between": ["bottom", "top"], "kind": "contact", **assumed}]
    return hpcinv.run(job(**GIVEN | {"interfaces": interfaces} | data), comm)


@pytest.mark.parallel([2, 1])
def test_a_block_that_lies_on_another_comes_back(comm: MPI.Intracomm) -> None:
    current = [GIVEN["effects"][0], GIVEN["effects"][1] | {"area_in": "current"}]
    result = solved(comm, "conforming", analysis="round_trip", first="inverse", effects=current)
    there, back = (solution.contacts[0] for solution in result.solutions)
    assert result.errors["round_trip"]["max"] < 1e-11
    assert back.force == pytest.approx(there.force, abs=1e-8)
    assert there.area == pytest.approx(AREA, rel=1e-12)
    assert there.largest_pressure > 400.0


def test_weight_and_pressure_are_carried_whatever_the_springs(monkeypatch: pytest.MonkeyPatch) -> None:
    soft = solved(MPI.COMM_SELF, analysis="forward").solutions[0]
    weight = 1000.0 * 9.81 * AREA * HEIGHT
    assert soft.contacts[0].force == pytest.approx((0, 0, weight + 400 * AREA), rel=1e-8, abs=1e-9)
    monkeypatch.setattr(pins, "STIFFNESS", 32.0)
    stiff = solved(MPI.COMM_SELF, analysis="forward", certificate={"level": "quick"})
    assert np.abs(stiff.solutions[0].u - soft.u).max() < 1e-10 * np.abs(soft.u).max() + 1e-13
    assert stiff.certificate is not None
    (line,) = (line for line in stiff.certificate.lines if line.name == "balance of free parts")
    assert line.value is not None
    assert line.value < 1e-9


@pytest.mark.parametrize(
    ("closure", "data", "match"),
    [
        ("conforming", SLANTED, r"pressure does not balance the loads of the part with 'bottom'.* 0\.153 N"),
        ("touching", {}, "closure: 'touching' does not balance its loads"),
    ],
)
def test_loads_that_pressure_cannot_balance_are_named(closure: str, data: dict[str, Any], match: str) -> None:
    with pytest.raises(MeshError, match=match):
        solved(MPI.COMM_SELF, closure, analysis="inverse", **data)


def test_supports_of_both_blocks_leave_nothing_to_springs() -> None:
    held = [*GIVEN["supports"], {"region": "z1", "fix": ["x", "y"]}]
    result = solved(MPI.COMM_SELF, "conforming", analysis="inverse", supports=held, certificate={"level": "quick"})
    assert result.certificate is not None
    assert not [line for line in result.certificate.lines if line.name == "balance of free parts"]
