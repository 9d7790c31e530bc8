"""Intervals over pressures and tractions within the friction cone: a stiff wedge, whose force statics knows."""

import math
from pathlib import Path
from typing import Any

import pytest
from helpers.verification import job
from mpi4py import MPI

import hpcinv
from hpcinv.trust.certificate import Line

MESH = Path(__file__).parents[1] / "helpers" / "wedge_mesh.py"
DENSITY, GRAVITY = 1000.0, 9.81


def force_line(cells: int, angle: float, friction: float, young: str, known: dict[str, Any] | None = None) -> Line:
    """Return the line of the certificate on the force of a wedge between walls that lean by an angle (degrees)."""
    interface = {"between": ["side", "face"], "kind": "contact", "friction": friction, "closure": "stick"}
    wedge = job(
        mesh={"file": str(MESH), "parameters": {"angle": angle, "cells": cells}},
        material={
            "wall": {"law": "neo-hookean", "young": "100 MPa", "poisson": 0.3},
            "wedge": {"law": "neo-hookean", "young": young, "poisson": 0.3},
        },
        discretisation={"displacement": 1},
        effects=[
            {
                "effect": "gravity",
                "acceleration": [0, 0, -GRAVITY],
                "density": DENSITY,
                "density_in": "current",
            }
        ],
        supports=[
            {"region": "back", "fix": ["x", "y", "z"]},
            {"region": "x0", "fix": ["x"]},
            {"region": "y0", "fix": ["y"]},
        ],
        interfaces=[interface | ({"known": known} if known else {})],
        uncertainty="contact",
        solver={"tolerance": 1e-12},
    )
    result = hpcinv.run(wedge, MPI.COMM_SELF, progress=False)
    [line] = [line for line in result.certificate.lines if "force on side" in line.name]
    return line


def ends(angle: float, friction: float) -> tuple[float, float]:
    """Return the pressing forces with all friction upwards and downwards; the second is negative if it locks."""
    slope, theta = math.tan(math.radians(angle)), math.radians(angle)
    weight = DENSITY * GRAVITY * 0.015 * (0.03 * 0.06 + slope * 0.06**2 / 2)
    return tuple(weight / (math.sin(theta) + way * friction * math.cos(theta)) for way in (1, -1))  # type: ignore[return-value]


def test_the_force_of_a_wedge_lies_between_full_friction_up_and_down() -> None:
    """Its weight in the given shape is known, and is carried by tractions within the cone."""
    line = force_line(2, 25.0, 0.2, "100 kPa")
    assert line.interval is not None
    low, high = ends(25.0, 0.2)
    assert line.interval["low"] == pytest.approx(low, rel=1e-3)
    assert line.interval["high"] == pytest.approx(high, rel=1e-3)


def test_a_wedge_that_locks_itself_has_no_greatest_force() -> None:
    line = force_line(1, 15.0, 0.3, "200 kPa")
    assert line.interval is not None
    assert line.interval["low"] == pytest.approx(ends(15.0, 0.3)[0], rel=1e-3)
    assert line.interval["high"] is None
    assert "friction locks the bodies" in line.note
