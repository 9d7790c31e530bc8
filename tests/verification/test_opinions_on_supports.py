"""CalculiX holds bodies along oblique directions as we do; decks with planes are read back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.second_opinions import BLOCK, LOST, distance, job_of_deck, needs_calculix, reaches_given_body, solved
from helpers.verification import job

from hpcinv.__main__ import main
from hpcinv.errors import OutputError
from hpcinv.mesh.source import MeshSource
from hpcinv.physics.effects.thermal_expansion import ThermalExpansion
from hpcinv.studies.second_opinion.calculix_deck import LOADS, write_deck
from hpcinv.studies.second_opinion.calculix_heat import add_expansion
from hpcinv.studies.second_opinion.loaded_body import LoadedBody, loaded_body
from hpcinv.studies.second_opinion.opinion import second_opinion
from hpcinv.studies.second_opinion.same_elements import _not_comparable
from hpcinv.studies.second_opinion.units import Units

TUBE: dict[str, Any] = {
    "file": "../meshes/thick_cylinder.py",
    "parameters": {"inner": 0.05, "outer": 0.1, "length": 0.1, "radial": 2, "around": 3, "along": 2},
}
OBLIQUE = {"region": "x0", "fix": ["normal"], "normal": [2, 1, 0]}
TUBE_SIDES = [{"region": name, "fix": ["normal"]} for name in ("x0", "y0", "z0")]


@needs_calculix
@pytest.mark.release
def test_oblique_planes_hold_as_ours_and_are_read_back(tmp_path: Path) -> None:
    loads = [BLOCK["effects"][0], {"effect": "pressure", "region": "y1", "pressure": 500}]
    run = solved(tmp_path, effects=loads, supports=[*BLOCK["supports"], OBLIQUE])
    assert distance(run) < LOST
    again, text = job_of_deck(run, tmp_path)
    assert "Not taken from the file" not in text
    slides = [support for support in again.supports if support.slides]
    assert [support.region for support in slides] == ["x0"]
    assert slides[0].normal == pytest.approx(np.array([2, 1, 0]) / 5**0.5)
    assert reaches_given_body(run, again) < 1e-5


@needs_calculix
@pytest.mark.release  # test_febio_parts.py has planes that meet, in a deck of two steps
@pytest.mark.parametrize(
    "further", [{"region": "y0", "fix": ["normal"], "normal": [0, 1, 1]}, {"region": "z1", "fix": ["y"]}]
)
def test_planes_that_meet_hold_their_edge_along_both_normals(further: dict[str, Any], tmp_path: Path) -> None:
    assert distance(solved(tmp_path, supports=[*BLOCK["supports"], OBLIQUE, further])) < LOST


@needs_calculix
@pytest.mark.everyday("True")
@pytest.mark.parametrize("hexahedra", [False, True])
def test_curved_faces_hold_along_the_normals_of_their_nodes(hexahedra: bool, tmp_path: Path) -> None:
    mesh = TUBE | {"parameters": TUBE["parameters"] | {"hexahedra": hexahedra}}
    loads = [{"effect": "pressure", "region": "z1", "pressure": 2e3}]
    run = solved(tmp_path, mesh=mesh, effects=loads, supports=[*TUBE_SIDES, {"region": "outer", "fix": ["normal"]}])
    assert distance(run) < LOST


@needs_calculix
def test_nodes_that_move_along_a_curved_surface_stay_where_the_run_found_them(tmp_path: Path) -> None:
    turned = {"region": "z1", "motion": {"rotate": "20 deg", "axis": [0, 0, 1]}}
    supports = [turned, {"region": "outer", "fix": ["normal"], "surface": "cylinder"}]
    run = solved(tmp_path, mesh=TUBE, effects=[], supports=supports)
    assert loaded_body(run, abilities=["slides"]).notes[0].startswith("supports[1]: held along the normals")
    assert distance(run) < LOST


@needs_calculix
@pytest.mark.everyday("1-springs0")
@pytest.mark.parametrize(
    "springs",
    [
        {"normal": 2e5, "tangential": 3e4, "area_in": "reference"},
        {"normal": 1e5, "tangential": 1e5, "area_in": "current"},
        {"normal": 2e5, "area_in": "current"},
    ],
)
@pytest.mark.parametrize("degree", [1, 2])
def test_foundations_have_the_stiffness_of_ours(springs: dict[str, Any], degree: int, tmp_path: Path) -> None:
    foundation = {"effect": "elastic-foundation", "region": "x1", **springs}
    spaces = {"displacement": degree, "formulation": "displacement"}
    mesh = BLOCK["mesh"] | {"geometry_degree": degree}
    run = solved(
        tmp_path,
        mesh=mesh,
        discretisation=spaces,
        effects=[*BLOCK["effects"], foundation],
        supports=[*BLOCK["supports"], OBLIQUE],
    )
    assert distance(run) < LOST


@needs_calculix
@pytest.mark.everyday("inverse")
@pytest.mark.parametrize("direction", ["inverse", "forward"])
def test_remote_loads_turn_a_face_as_ours_and_are_read_back(direction: str, tmp_path: Path) -> None:
    remote = {"force": [0.05, 0.1, -0.02], "moment": [0.02, -0.05, 0.1], "about": ["3 cm", "5 cm", "30 cm"]}
    supports = [*BLOCK["supports"], {"region": "z1", "remote": remote}]
    run = solved(tmp_path, analysis=direction, effects=BLOCK["effects"][:1], supports=supports)
    assert distance(run) < LOST
    again, _ = job_of_deck(run, tmp_path)
    [support] = [support for support in again.supports if support.remote]
    assert support.region == "z1"
    assert support.remote is not None
    assert support.remote.force == pytest.approx([0.05, 0.1, -0.02])
    assert support.remote.moment == pytest.approx([0.02, -0.05, 0.1])
    assert reaches_given_body(run, again) < 1e-5


@needs_calculix
def test_small_thermal_expansion_is_as_ours(tmp_path: Path) -> None:
    heat = {"effect": "thermal-expansion", "coefficient": 2e-4, "temperature_change": 50}
    run = solved(
        tmp_path, effects=[*BLOCK["effects"], heat], supports=[*BLOCK["supports"], {"region": "y1", "fix": ["y"]}]
    )
    assert distance(run) < 5e-4  # 2 (alpha ΔT)² is 2e-4
    with pytest.raises(OutputError, match="no tested counterpart in Abaqus"):
        write_deck(tmp_path / "a.inp", loaded_body(run, LOADS), Units(1.0), "abaqus")
    body = replace(loaded_body(run, LOADS), expansion=())
    hotter = ThermalExpansion.model_validate(heat | {"temperature_change": 150})
    assert "is another strain in CalculiX" in str(add_expansion(body, hotter, "effects[0]"))


def test_abaqus_gets_hybrid_elements_and_directions_of_fibres(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spaces = {"displacement": 2, "formulation": "mixed"}
    law = {"law": "holzapfel-gasser-ogden", "mu": 1e4, "k1": 5e3, "k2": 2, "dispersion": 0.1, "kappa": "incompressible"}
    fibres = {
        "a": {"direction": [3, 0, 4], "given_on": "reference"},
        "b": {"direction": [0, 1, 0], "given_on": "reference"},
    }
    divisions = BLOCK["mesh"]["parameters"] | {"nx": 1, "ny": 1}
    mesh = BLOCK["mesh"] | {"geometry_degree": 2, "parameters": divisions}
    posed = {"mesh": mesh, "discretisation": spaces, "effects": BLOCK["effects"][:1]}
    run = solved(tmp_path, **posed, material=law | {"fibres": ["a", "b"]}, fibres=fibres)
    again, text = job_of_deck(run, tmp_path)
    deck = (tmp_path / "part.inp").read_text()
    assert "*ELEMENT, TYPE=C3D10H\n" in deck
    assert "*CONTROLS" not in deck
    assert "Not taken from the file" not in text
    [law_again] = again.laws.values()
    assert len(law_again.families) == 2
    assert reaches_given_body(run, again, discretisation=spaces) < 1e-5
    body = loaded_body(run)
    with pytest.raises(OutputError, match=r"fibres.b: its direction varies"):
        write_deck(tmp_path / "a.inp", replace(body, fibres={"a": body.fibres["a"]}), Units(1.0), "abaqus")
    capsys.readouterr()
    assert main(["export", str(run), "--deck", str(tmp_path / "other.inp")]) == 2
    assert "CalculiX has no elements for incompressible bodies" in capsys.readouterr().err
    assert main(["export", str(run), "--deck", str(tmp_path / "a.feb"), "--for", "abaqus"]) == 2
    assert "--for abaqus: is for decks whose name ends with .inp" in capsys.readouterr().err


MOTION = {"motion": {"rotate": "20 deg", "axis": [0, 0, 1], "about": [0.05, 0.05, 0], "move": [0, 0, "5 mm"]}}


@needs_calculix
@pytest.mark.release
@pytest.mark.parametrize("moved", [MOTION, {"displacement": ["3 mm", None, "2 mm"]}])
def test_stiff_elements_explain_the_difference_of_a_body_that_supports_move(
    moved: dict[str, Any], tmp_path: Path
) -> None:
    mesh = BLOCK["mesh"] | {"parameters": BLOCK["mesh"]["parameters"] | {"nx": 1, "ny": 1}, "geometry_degree": 2}
    spaces, law = {"displacement": 2, "formulation": "mixed"}, BLOCK["material"] | {"kappa": 1e6}
    supports = [*BLOCK["supports"], {"region": "z1", **moved}]
    run = solved(tmp_path, mesh=mesh, discretisation=spaces, material=law, supports=supports)
    opinion = second_opinion(run, None, 120)
    assert opinion.largest > 1e-2 * opinion.displacement
    assert opinion.by_elements == pytest.approx(opinion.largest, rel=1e-2)
    assert opinion.apart is not None
    assert opinion.apart < LOST * opinion.displacement


@pytest.mark.parametrize(
    ("moved", "element", "word"),
    [
        ({"displacement": ["0.1*x", None, None]}, "C3D10", "formulas of places"),
        (MOTION, "C3D20", "ours have 27 nodes"),
        (MOTION, "C3D10", ""),
        ({"displacement": ["3 mm", None, None]}, "C3D10", ""),
        ({"fix": ["x"]}, "C3D20", ""),
    ],
)
def test_supports_that_another_body_would_move_otherwise_are_not_comparable(
    moved: dict[str, Any], element: str, word: str
) -> None:
    data = {**BLOCK, "supports": [*BLOCK["supports"], {"region": "z1", **moved}]}
    points = np.zeros((1, 3))
    mesh = MeshSource.__new__(MeshSource)  # neither slides nor rigid regions are of it
    body = LoadedBody(name="a", rest=mesh, loaded=points, laws={}, forces=points)
    reason = _not_comparable(job(**data), body, element)
    assert word in reason
    assert bool(reason) == bool(word)
