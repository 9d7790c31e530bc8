"""Unknown pressures and motions on paths of all strategies, and where a body presses on an obstacle."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import NO_CERTIFICATE
from helpers.thick_sphere import INNER, OUTER, sphere
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI

OCTANT = math.pi * INNER**3 / 6
BALLOON = {key: value for key, value in sphere(1, hexahedra=True).data.items() if key != "effects"} | {
    "analysis": "forward",
    "certificate": NO_CERTIFICATE,
    "cavities": {"hole": {"surface": "inner", "lid": {"apex": [0, 0, 0]}, "volume": 2.0 * OCTANT}},
}
BAR = {
    "analysis": "forward",
    "mesh": box((3, 1, 1), ly=0.2, lz=0.2, hexahedra=True),
    "material": {"law": "neo-hookean", "mu": 1.0, "lam": 4.0},
    "supports": [
        {"region": "x0", "fix": ["x", "y", "z"]},
        {"region": "x1", "remote": {"about": [1.0, 0.1, 0.1], "force": [4e-3, -1e-4, 0], "moment": [1e-5, 0, 0]}},
    ],
    "certificate": NO_CERTIFICATE,
}
STRATEGIES: list[dict[str, Any]] = [
    {"strategy": "fixed", "steps": 3},
    {"strategy": "arc-length", "initial_step": 0.4},
]


def solved(data: dict[str, Any], comm: MPI.Intracomm, directory: Path | None = None, **changes: Any) -> Any:
    return hpcinv.run(job(**data | changes), comm, directory=directory).solutions[0]


@pytest.mark.everyday("volume-arc-length", "remote load-arc-length")
@pytest.mark.parametrize("strategy", STRATEGIES, ids=["fixed", "arc-length"])
@pytest.mark.parametrize("body", [BALLOON, BAR], ids=["volume", "remote load"])
def test_all_strategies_end_in_the_same_state(body: dict[str, Any], strategy: dict[str, Any]) -> None:
    expected = solved(body, MPI.COMM_SELF, solver={"tolerance": 1e-10})
    found = solved(body, MPI.COMM_SELF, solver={"tolerance": 1e-10} | strategy)
    assert len(found.solves) > 1
    u, size = expected.u, np.abs(expected.u).max()
    assert np.abs(found.u - u).max() < 1e-8 * size
    for ours, theirs in zip(found.cavities, expected.cavities, strict=True):
        assert ours.pressure == pytest.approx(theirs.pressure, rel=1e-8)
    for ours, theirs in zip(found.remote_loads, expected.remote_loads, strict=True):
        assert ours.motion.move == pytest.approx(theirs.motion.move, rel=1e-7, abs=1e-9)


def test_a_balloon_passes_its_largest_pressure_along_the_length_of_the_path() -> None:
    """The pressure has a maximum at 2.6 times the volume; the load factor, which the volume follows, has none."""
    beyond = BALLOON | {"cavities": {"hole": BALLOON["cavities"]["hole"] | {"volume": 12.0 * OCTANT}}}
    found = solved(beyond, MPI.COMM_SELF, solver={"strategy": "arc-length", "initial_step": 0.05})
    assert sum(solve.limit_point for solve in found.solves) == 0
    assert found.cavities[0].volume == pytest.approx(12.0 * OCTANT, rel=1e-9)


@pytest.mark.release
@pytest.mark.parallel([2, 1])
def test_a_balloon_of_given_volume_presses_on_a_plate_as_one_of_the_pressure_found(comm: MPI.Intracomm) -> None:
    plate = {
        "effect": "contact",
        "region": "outer",
        "obstacle": {"shape": "plane", "point": [0, 0, 1.02 * OUTER], "normal": [0, 0, -1]},
    }
    blown = solved(BALLOON, comm, effects=[plate])
    (cavity,), (contact,) = blown.cavities, blown.contacts
    assert contact.area > 0.0
    assert cavity.volume == pytest.approx(2.0 * OCTANT, rel=1e-9)
    pressure = {"effect": "pressure", "region": "inner", "pressure": cavity.pressure}
    pressed = solved({**BALLOON, "cavities": {}}, comm, effects=[pressure, plate])
    size = np.abs(blown.u).max(initial=1e-300)
    assert np.abs(pressed.u - blown.u).max(initial=0.0) < 1e-5 * size
    assert pressed.contacts[0].force == pytest.approx(contact.force, rel=1e-4, abs=1e-6)
