"""Quantities between two states: against the closed form, and against the quantities of both states."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.command_line import NO_CERTIFICATE
from helpers.soft_column import SOFT, column_length, gravity
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import JobError

WEIGHT = {"density": 1000, "density_in": "current"}
TOP: dict[str, Any] = {"of": "displacement", "at": [0.1, 0.1, 1]}
STATES = [
    {"name": "standing", "given": True, "effects": [gravity(-1, **WEIGHT)]},
    {"name": "hanging", "effects": [gravity(1, **WEIGHT)]},
    {"name": "floating", "effects": [gravity(0.5, **WEIGHT)]},
]
COLUMN: dict[str, Any] = {
    "mesh": box((1, 1, 16), lx="0.2 m", ly="0.2 m"),
    **SOFT,
    "supports": [{"region": "boundary", "fix": ["x", "y"]}, {"region": "z0", "fix": ["z"]}],
    "states": STATES,
    "discretisation": {"displacement": 1},
}


@pytest.mark.parallel([1, 2])
def test_way_between_states_and_its_error(comm: MPI.Intracomm) -> None:
    """The top of a column that stands in the scan and hangs in the second state, by quadrature of its closed form."""
    result = hpcinv.run(
        job(
            **COLUMN | {"states": STATES[:2], "certificate": NO_CERTIFICATE | {"estimate": True}},
            quantities=[
                {"name": "way", "state": "hanging", "from": "standing", **TOP},
                {"name": "top", **TOP},
                {"name": "higher", "of": "z", "at": TOP["at"], "state": "hanging", "from_state": "standing"},
            ],
            sensitivities={"material.mu": "500 Pa"},
        ),
        comm,
    )
    found: Any = result.quantities
    estimate: Any = result.estimate
    sensitivities: Any = result.sensitivities
    assert list(found) == ["way", "top-standing", "top-hanging", "higher"]
    assert found["way"] == pytest.approx(np.subtract(found["top-hanging"], found["top-standing"]), abs=1e-15)
    assert found["higher"] == pytest.approx(found["way"][2], abs=1e-15)
    assert found.units["way"] == "m"

    error = column_length(1) - 1 - found["way"][2]  # the standing column is 1 m high
    bars = {name: value[2] for name, value in estimate.quantities.items() if name != "higher"}
    print(f"error {error:.2e}, estimates {bars}")
    assert list(bars) == ["way", "top-standing", "top-hanging"]
    assert bars["way"] / error == pytest.approx(1, abs=0.1)
    assert bars["way"] == pytest.approx(bars["top-hanging"] - bars["top-standing"], rel=1e-9)
    assert estimate.quantities["higher"] == pytest.approx(bars["way"], rel=1e-3)  # to second order

    slopes = {name: by_key["material.mu"][2] for name, by_key in sensitivities.slopes.items() if name != "higher"}
    assert slopes["way"] == pytest.approx(slopes["top-hanging"] - slopes["top-standing"], rel=1e-9)
    assert sensitivities.deviations["way"][2] == pytest.approx(abs(slopes["way"]) * 500, rel=1e-12)


def test_without_a_state_all_others_are_taken() -> None:
    given = job(**COLUMN, quantities=[{"name": "way", "from": "standing", **TOP}])
    assert [(q.name, q.state, q.from_state) for q in given.quantities] == [
        ("way-hanging", "hanging", "standing"),
        ("way-floating", "floating", "standing"),
    ]
    planned = {step.job.state: [q.name for q in step.job.quantities] for step in given.plan}
    assert planned["standing"] == ["way-hanging in standing", "way-floating in standing"]
    assert planned["hanging"] == ["way-hanging in hanging"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"from": "lying", "state": "hanging"}, r"quantities\[0\].from: there is no loaded state 'lying'"),
        ({"from": "hanging", "state": "hanging"}, r"quantities\[0\].from: is the state 'hanging' itself"),
        ({"from": "hanging", "from_state": "hanging"}, r"from: is the same key as 'from_state'; give one of them"),
        ({"from": "standing", "of": "von_misses"}, "von_mises"),
        (
            {"from": "standing", "state": "hanging", "of": "reaction", "at": None, "on": "z1"},
            r"'z1' is not the region of a support in state 'hanging'",
        ),
    ],
)
def test_faults_of_states_are_named(changes: dict[str, Any], message: str) -> None:
    quantity = {key: value for key, value in {"name": "way", **TOP, **changes}.items() if value is not None}
    with pytest.raises(JobError, match=message):
        job(**COLUMN, quantities=[quantity])


def test_a_quantity_from_a_state_needs_states() -> None:
    plain = {key: value for key, value in COLUMN.items() if key != "states"}
    with pytest.raises(JobError, match="there is no loaded state 'standing'"):
        job(**plain, effects=[gravity(1)], quantities=[{"name": "way", "from": "standing", **TOP}])
