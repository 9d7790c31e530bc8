"""Inverse analyses whose contact pressure is the one of least elastic energy."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.verification import job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import JobError
from hpcinv.output.result import Result

GRAVITY = {"effect": "gravity", "acceleration": [0, 0, -0.2], "density": 1.0, "density_in": "current"}
GIVEN: dict[str, Any] = {
    "material": {"law": "neo-hookean", "mu": 1.0, "lam": 2.0},
    "solver": {"tolerance": 1e-12},
    "discretisation": {"displacement": 1},
    "effects": [GRAVITY],
}
CLAMP = {"region": "z0", "fix": ["x", "y", "z"]}
WEDGE = Path(__file__).parents[1] / "helpers" / "wedge_mesh.py"


def blocks(comm: MPI.Intracomm, closure: str, parameters: dict[str, Any], **data: Any) -> Result:
    mesh = {"file": "../meshes/two_blocks.py", "parameters": {"hexahedra": True, **parameters}}
    interface = {"between": ["bottom", "top"], "kind": "contact", "closure": closure}
    return hpcinv.run(job(**GIVEN | {"mesh": mesh, "interfaces": [interface]} | data), comm)


@pytest.mark.parallel([2, 1])
def test_a_free_block_is_carried_with_less_energy_and_comes_back(comm: MPI.Intracomm) -> None:
    """Its weight and the load on it are known in the given shape. The lower block is wider."""
    push = {"effect": "traction", "region": "z1", "traction": [0, 0, -0.1], "area_in": "current"}
    sides = [{"region": "x0", "fix": ["x"]}, {"region": "y0", "fix": ["y"]}]
    posed: dict[str, Any] = {"effects": [GRAVITY, push], "supports": [CLAMP, *sides]}
    shape = {"lower": 2, "upper": 2, "margin": 0.25}
    conforming = blocks(comm, "conforming", shape, analysis="inverse", **posed).solutions[0]
    checked = {"certificate": {"stability": False, "estimate": False}}
    least = blocks(comm, "least-energy", shape, analysis="inverse", **posed | checked)
    (there,) = least.solutions
    assert there.contacts[0].force[2] == pytest.approx(0.2 * 0.5 + 0.1, abs=1e-12)
    assert there.strain_energy < conforming.strain_energy
    assert least.certificate is not None
    (closes,) = (line for line in least.certificate.lines if line.name.startswith("round trip"))
    assert closes.value is not None
    assert closes.value < 1e-8
    assert "store the least elastic energy" in there.contacts[0].assumption


def test_supported_blocks_store_less_than_with_other_closures(comm: MPI.Intracomm) -> None:
    """A block that was moved down hardly presses: nearly all of its way is rigid."""
    posed: dict[str, Any] = {"supports": [CLAMP, {"region": "z1", "displacement": [0, 0, -0.05]}]}
    found = {
        closure: blocks(comm, closure, {"lower": 1, "upper": 2}, analysis="inverse", **posed).solutions[0]
        for closure in ("least-energy", "conforming")
    }
    least = found.pop("least-energy")
    assert least.strain_energy < 0.9999 * found["conforming"].strain_energy
    assert 0 < least.contacts[0].force[2] < 0.1 * found["conforming"].contacts[0].force[2]
    assert least.contacts[0].fields[1].x.array.min() >= 0.0


def test_friction_of_a_wedge_stays_within_its_cone() -> None:
    """Statics bounds the force of the wedge on rough walls that lean by 25°."""
    data: dict[str, Any] = {
        "mesh": {"file": str(WEDGE), "parameters": {"angle": 25.0, "cells": 2}},
        "material": {
            "wall": {"law": "neo-hookean", "young": "100 MPa", "poisson": 0.3},
            "wedge": {"law": "neo-hookean", "young": "100 kPa", "poisson": 0.3},
        },
        "effects": [GRAVITY | {"acceleration": [0, 0, -9.81], "density": 1000.0}],
        "supports": [
            {"region": "back", "fix": ["x", "y", "z"]},
            {"region": "x0", "fix": ["x"]},
            {"region": "y0", "fix": ["y"]},
        ],
    }
    least, coulomb = (
        hpcinv.run(job(**GIVEN | data | {"interfaces": [interface | {"closure": closure}]}), MPI.COMM_SELF).solutions[0]
        for interface in [{"between": ["side", "face"], "kind": "contact", "friction": 0.2}]
        for closure in ("least-energy", "coulomb")
    )
    theta, slope = math.radians(25.0), math.tan(math.radians(25.0))
    weight = 1000.0 * 9.81 * 0.015 * (0.03 * 0.06 + slope * 0.06**2 / 2)
    pressing = [weight / (math.sin(theta) + way * 0.2 * math.cos(theta)) for way in (1, -1)]
    contact = least.contacts[0]
    normal = np.array([-math.cos(theta), 0, math.sin(theta)])
    assert 0.999 * pressing[0] <= normal @ np.array(contact.force) <= 1.001 * pressing[1]
    assert contact.friction is not None
    assert contact.friction.largest <= 1.03 * contact.friction.allowed  # the cone has 16 planes
    assert least.strain_energy < coulomb.strain_energy


def test_a_rigid_obstacle_is_refused() -> None:
    plane = {"shape": "plane", "point": [0, 0, 0], "normal": [0, 0, 1]}
    contact = {"effect": "contact", "region": "z0", "obstacle": plane, "closure": "least-energy"}
    with pytest.raises(JobError, match=r"effects\[0\].closure: 'least-energy' is for interfaces"):
        job(**GIVEN | {"mesh": {"file": "../meshes/two_blocks.py"}, "effects": [contact], "analysis": "inverse"})
