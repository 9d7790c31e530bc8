"""CalculiX bends sheets as our shells, to what its solids of one element through the thickness explain."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.second_opinions import distance, job_of_deck, needs_calculix, reaches_given_body, solved

from hpcinv.errors import OutputError
from hpcinv.studies.second_opinion.calculix_deck import ABILITIES, LOADS
from hpcinv.studies.second_opinion.foundations import Foundation
from hpcinv.studies.second_opinion.input_file import write_input_file
from hpcinv.studies.second_opinion.loaded_body import loaded_body
from hpcinv.studies.second_opinion.opinion import second_opinion
from hpcinv.studies.second_opinion.regions import group_of
from hpcinv.studies.second_opinion.units import Units

DIVISIONS = {"length": 0.1, "width": 0.03, "nx": 8, "ny": 2}
WEIGHT = {"effect": "gravity", "acceleration": [0, 0, -3], "density": 1000}
SHEET: dict[str, Any] = {
    "mesh": {"file": "../meshes/sheet.py", "parameters": DIVISIONS, "shell": {"thickness": 0.004}},
    "material": {"law": "isochoric-neo-hookean", "mu": 1e5, "kappa": 2e5 / 3},  # Poisson's ratio 0
    "discretisation": {"displacement": 2, "formulation": "displacement"},
    "effects": [WEIGHT],
    "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
}
HINGED = [{"region": "x0", "fix": ["x", "y", "z"], "hinge": True}, {"region": "x1", "fix": ["x"]}]


@needs_calculix
def test_a_given_sheet_is_reached_from_its_curved_rest_shape(tmp_path: Path) -> None:
    mesh = SHEET["mesh"] | {"parameters": DIVISIONS | {"nx": 5}}
    run = solved(tmp_path, **SHEET | {"mesh": mesh, "effects": [WEIGHT | {"acceleration": [0, 0, -1]}]})
    opinion = second_opinion(run, None, 120)
    assert opinion.element == "S8R"
    assert opinion.by_elements is None
    assert opinion.displacement > 0.02
    assert opinion.largest < 1e-2 * opinion.displacement


@needs_calculix
@pytest.mark.everyday("outer")
@pytest.mark.parametrize("face", ["outer", "inner"])
def test_pressures_act_on_their_face_and_are_read_back(face: str, tmp_path: Path) -> None:
    load = {"effect": "pressure", "region": face, "pressure": 5}
    mesh = SHEET["mesh"] | {"parameters": DIVISIONS | {"nx": 5}}
    run = solved(tmp_path, **SHEET | {"analysis": "forward", "mesh": mesh, "effects": [load]})
    assert distance(run) < 1e-2
    again, text = job_of_deck(run, tmp_path)
    assert "DSLOAD" not in text
    spaces = SHEET["discretisation"]
    assert reaches_given_body(run, again, discretisation=spaces, analysis="forward") < 1e-4


@needs_calculix
@pytest.mark.release
def test_hinges_and_planes_of_symmetry_turn_as_ours(tmp_path: Path) -> None:
    traction = {"effect": "traction", "region": "y1", "traction": [0, 50, -10], "area_in": "reference"}
    posed = {"analysis": "forward", "effects": [WEIGHT, traction], "supports": HINGED}
    run = solved(tmp_path, **SHEET | posed)
    assert distance(run) < 1e-2


@needs_calculix
@pytest.mark.release
def test_elements_of_calculix_that_are_too_stiff_come_nearer_on_finer_meshes(tmp_path: Path) -> None:
    material = SHEET["material"] | {"kappa": 4e5}
    distances = []
    for times in (1, 2):
        divisions = DIVISIONS | {"nx": 8 * times, "ny": 2 * times}
        posed = SHEET | {"analysis": "forward", "material": material}
        posed |= {"mesh": SHEET["mesh"] | {"parameters": divisions}}
        distances.append(distance(solved(tmp_path / str(times), **posed)))
    assert distances[1] < 0.6 * distances[0] < 0.03


def test_parts_of_shells_without_counterpart_are_refused(tmp_path: Path) -> None:
    one_cell = SHEET["mesh"] | {"parameters": DIVISIONS | {"nx": 1, "ny": 1}}
    layers = one_cell | {"shell": {"thickness": 0.004, "layers": {"low": 1, "high": 1}}}
    laws = {"low": SHEET["material"], "high": SHEET["material"]}
    run = solved(tmp_path / "layers", **SHEET | {"mesh": layers, "material": laws})
    with pytest.raises(OutputError, match=r"mesh\.shell\.layers"):
        loaded_body(run, LOADS, ABILITIES)
    with pytest.raises(OutputError, match=r"mesh\.shell: only solids are written"):
        loaded_body(run, LOADS)
    turned = {"region": "x1", "motion": {"rotate": "5 deg", "axis": [0, 1, 0]}}
    posed = {"analysis": "forward", "mesh": one_cell, "effects": [], "supports": [*SHEET["supports"], turned]}
    body = loaded_body(solved(tmp_path / "turned", **SHEET | posed), LOADS, ABILITIES)
    with pytest.raises(OutputError, match="turns an edge"):
        write_input_file(tmp_path / "a.inp", body, Units(1.0))
    [law] = body.laws.values()
    foundation = Foundation("effects[0]", group_of(body.rest, "outer"), 1e5, 0.0, False)
    drawn = np.where(
        np.isin(np.arange(len(body.forces)), body.rest.facets[group_of(body.rest, "outer").members]), 1.0, 0
    )
    for change, reason in (
        ({"foundations": [foundation]}, "'elastic-foundation'"),
        ({"expansion": (1e-4, 10.0)}, "'thermal-expansion'"),
        (
            {"laws": {"": type(law).model_validate(SHEET["material"] | {"kappa": "incompressible"})}},
            "no elements for incompressible bodies",
        ),
        ({"forces": drawn[:, None] * [1.0, 0.0, 0.0]}, "tractions on a face, whose moment"),
    ):
        with pytest.raises(OutputError, match=reason):
            write_input_file(tmp_path / "a.inp", replace(body, **change), Units(1.0))
    pressed = replace(body, pressures=[(group_of(body.rest, "y1"), 8.0)])
    with pytest.raises(OutputError, match="'y1' is on an edge of a shell"):
        write_input_file(tmp_path / "a.inp", pressed, Units(1.0))
