"""Shells draped over rigid obstacles with friction, and their flat unloaded shape back from the draped one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import ROOT
from helpers.verification import job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.job.yaml_reader import read_yaml

STRIP: dict[str, Any] = dict(read_yaml(ROOT / "jobs" / "draped-strip.yaml"))
SCARF: dict[str, Any] = {
    "mesh": {
        "file": "../meshes/sheet.py",
        "parameters": {"length": 1.0, "width": 0.2, "nx": 16, "ny": 1},
        "shell": {"thickness": 0.02},
    },
    "material": {"law": "neo-hookean", "young": 1e6, "poisson": 0.3},
    "supports": [{"region": "x0", "fix": ["x", "z"]}, {"region": "y0", "fix": ["y"]}],
    "solver": {"tolerance": 1e-9},
}
"""half of a scarf that is held at the top of a shoulder"""
SHOULDER = {"shape": "cylinder", "point": [0, 0, -0.31], "axis": [0, 1, 0], "radius": 0.3}


@pytest.mark.parametrize("cells", [8, pytest.param(20, marks=pytest.mark.release)])
def test_a_strip_that_slid_over_the_edge_of_a_table_is_flat_again(cells: int, comm: MPI.Intracomm) -> None:
    data = {key: value for key, value in STRIP.items() if key not in ("job", "quantities")}
    parameters = STRIP["mesh"]["parameters"] | {"nx": cells}
    result = hpcinv.run(job(**data | {"mesh": STRIP["mesh"] | {"parameters": parameters}}), comm)
    there, back = (solution.contacts[0] for solution in result.solutions)
    assert there.friction is not None
    assert there.friction.sliding_area == pytest.approx(there.area)
    assert there.friction.energy_lost > 0
    assert np.abs(result.solutions[0].u).max() > 0.4
    assert result.errors["round_trip"]["max"] < 1e-7  # of 1.5 m
    assert back.force == pytest.approx(there.force, abs=1e-9)


@pytest.mark.release
def test_a_scarf_on_a_shoulder_is_flat_again(comm: MPI.Intracomm) -> None:
    gravity = {"effect": "gravity", "acceleration": [0, 0, -0.4], "density": 1000.0}
    contact = {"effect": "contact", "region": "outer", "obstacle": SHOULDER, "friction": 0.3, "closure": "given"}
    data = SCARF | {"analysis": "round_trip", "first": "forward", "effects": [gravity, contact]}
    result = hpcinv.run(job(**data), comm)
    (contact_report,) = result.solutions[0].contacts
    assert contact_report.friction is not None
    assert contact_report.friction.energy_lost > 0
    assert result.errors["round_trip"]["max"] < 1e-7


@pytest.mark.release
def test_a_thick_cloth_on_a_sphere_is_flat_again(comm: MPI.Intracomm) -> None:
    """A quarter; a thinner cloth wrinkles under its load. The pole is held."""
    sphere = {"shape": "sphere", "centre": [0, 0, -1.015], "radius": 1.0}
    parameters = {"length": 0.6, "width": 0.6, "nx": 4, "ny": 4}
    sides = [{"region": "x0", "fix": ["x"]}, {"region": "y0", "fix": ["y"]}, {"region": "pole", "fix": ["z"]}]
    data = SCARF | {
        "mesh": {"file": "../meshes/sheet.py", "parameters": parameters, "shell": {"thickness": 0.03}},
        "regions": {"pole": {"vertices": [[0, 0, 0.015]]}},
        "supports": sides,
    }
    gravity = {"effect": "gravity", "acceleration": [0, 0, -1.0], "density": 1000.0}
    contact = {"effect": "contact", "region": "outer", "obstacle": sphere, "friction": 0.3, "closure": "given"}
    result = hpcinv.run(job(**data, analysis="round_trip", first="forward", effects=[gravity, contact]), comm)
    (report,) = result.solutions[0].contacts
    assert report.force[2] > 1
    assert report.friction is not None
    assert report.friction.energy_lost > 0
    assert np.abs(result.solutions[0].u).max() > 0.1
    assert result.errors["round_trip"]["max"] < 1e-7


@pytest.mark.release
def test_the_draped_shape_alone_gives_the_strip_within_two_percent_of_its_drop(
    comm: MPI.Intracomm, tmp_path: Path
) -> None:
    """Where it presses beyond the edge the flat strip was up to 3 mm off the table, which `coulomb` assumes to be 0."""
    weight, contact = STRIP["effects"]
    contact = {key: value for key, value in contact.items() if key != "closure"}
    kept = {key: STRIP[key] for key in ("material", "supports", "solver", "mesh")}
    drape = hpcinv.run(job(**kept, analysis="forward", effects=[weight, contact]), comm, directory=tmp_path / "drape")
    assert np.abs(drape.solutions[0].u).max() > 0.4
    ends = [{"name": name, "of": of, "on": "x1", "reduce": "mean"} for name, of in (("end", "X"), ("tip", "Z"))]
    draped = {"file": str(tmp_path / "drape" / "shape.msh"), "shell": {"director": "data"}}
    data = kept | {"mesh": draped, "quantities": ends, "analysis": "inverse"}
    result = hpcinv.run(job(**data, effects=[weight, contact | {"closure": "coulomb"}]), comm)
    assert result.quantities["end"] == pytest.approx(1.5, abs=1e-3)
    assert abs(result.quantities["tip"]) < 0.02 * 0.45
