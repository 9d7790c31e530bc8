"""Whole models for FEBio: read back they are the same problem; what they cannot say is refused by its name."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.mesh_data_files import block
from helpers.verification import job

import hpcinv
from hpcinv.__main__ import main
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import OutputError
from hpcinv.formats.cards.febio_sums import SUMS
from hpcinv.formats.cards.febio_writer import CARDS
from hpcinv.job.job import load
from hpcinv.physics.effects import effects
from hpcinv.physics.materials import laws
from hpcinv.studies.second_opinion.febio_model import LOADS, write_model
from hpcinv.studies.second_opinion.loaded_body import Held, LoadedBody, add_loads
from hpcinv.studies.second_opinion.units import Units

MESHES = Path(__file__).parents[2] / "meshes"
BODY: dict[str, Any] = {
    "analysis": "inverse",
    "mesh": {"file": "../meshes/box.py", "parameters": {"lx": 0.1, "ly": 0.1, "lz": 0.2, "nx": 1, "ny": 1, "nz": 2}},
    "material": {"law": "neo-hookean", "mu": 1e4, "lam": 2e4},
    "discretisation": {"displacement": 1, "formulation": "displacement"},
    "effects": [
        {"effect": "gravity", "acceleration": [1, 0, -2], "density": 1000},
        {"effect": "pressure", "region": "x0", "pressure": 100},
        {"effect": "traction", "region": "y1", "traction": [10, 50, 0], "area_in": "reference"},
        {"effect": "traction", "region": "x1", "traction": [0, 30, 10], "area_in": "current"},
    ],
    "supports": [{"region": "z0", "fix": ["x", "y", "z"]}, {"region": "z1", "displacement": ["2 mm", None, None]}],
    "output": {"mesh": ["msh"], "fields": False},
}

REMOTE = {"force": [0.02, 0, 0.1], "moment": [1e-3, 4e-3, -2e-3], "about": [0.05, 0.06, 0.25]}


def body(hexahedra: bool = False, degree: int = 1) -> LoadedBody:
    mesh = block(MESHES, hexahedra, degree)
    law = laws()["neo-hookean"]
    one = {"": law.model_validate(law.example)}
    return LoadedBody(name="a", rest=mesh, loaded=mesh.points, laws=one, forces=np.zeros_like(mesh.points))


@pytest.mark.everyday("False-2", "True-1")
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("hexahedra", [False, True])
def test_a_model_that_is_read_back_loads_the_rest_shape_into_the_given_body(
    hexahedra: bool, degree: int, tmp_path: Path
) -> None:
    spaces = BODY["discretisation"] | {"displacement": degree}
    mesh = BODY["mesh"] | {"parameters": BODY["mesh"]["parameters"] | {"hexahedra": hexahedra}}
    mesh |= {"geometry_degree": degree}
    run, model, back = tmp_path / "run", tmp_path / "part.feb", tmp_path / "back.yaml"
    supports = BODY["supports"] if degree == 2 else [BODY["supports"][0], {"region": "z1", "remote": REMOTE}]
    given_job = job(**BODY | {"mesh": mesh, "discretisation": spaces, "supports": supports})
    given = hpcinv.run(given_job, MPI.COMM_SELF, directory=run, progress=False)
    assert main(["export", str(run), "--deck", str(model), "--unit", "mm"]) == 0
    assert main(["new", "job", "--from", str(model), "--unit", "mm", "--stress-unit", "MPa", str(back)]) == 0
    text = back.read_text()
    assert "Not taken from the file" not in text
    again = load(back).with_({"discretisation": spaces, "certificate": "off"})
    held = ("x", "y", "z") if degree == 1 else ("x",)
    assert {(s.region, tuple(sorted(s.held))) for s in again.supports} == {("z0", ("x", "y", "z")), ("z1", held)}
    assert [s.remote is not None for s in again.supports] == [False, degree == 1]
    assert [type(effect).__name__ for effect in again.effects].count("Traction") == 2
    loaded = hpcinv.run(again, MPI.COMM_SELF, progress=False)
    np.testing.assert_allclose(loaded.given_in_file, given.shape_in_file, rtol=0, atol=1e-9)
    size = np.abs(given.shape_in_file - given.given_in_file).max()
    assert size > 1e-3
    np.testing.assert_allclose(loaded.shape_in_file, given.given_in_file, rtol=0, atol=1e-5 * size)


def test_every_effect_is_written_or_refused_by_its_name() -> None:
    for name, kind in effects().items():
        refused = list(add_loads(body(), [kind.model_validate(kind.example)], LOADS)) if kind not in LOADS else []
        assert kind in LOADS or refused == [f"effects[0]: '{name}' has no counterpart"], name
    per_deformed = {"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 1000, "density_in": "current"}
    gravity = effects()["gravity"].model_validate(per_deformed)
    [line] = add_loads(body(), [gravity], LOADS)
    assert line.startswith("effects[0]: 'gravity' per deformed volume has no counterpart")


def test_every_law_is_written_or_refused_by_its_name(tmp_path: Path) -> None:
    for name, law in laws().items():
        posed, path = body(), tmp_path / f"{name}.feb"
        posed.laws, posed.density = {"": law.model_validate(law.example)}, 1000.0
        posed.fibres = dict.fromkeys(posed.laws[""].families, np.array([0.6, 0.0, 0.8]))
        if name in {*CARDS, *SUMS} - {"holzapfel-ogden"}:  # its example has a_fs
            write_model(path, posed, Units(1e-3))
            [material] = ET.parse(path).getroot().iter("material")
            assert float(material.findtext("density", "")) == pytest.approx(1e-9)  # t/mm³
        else:
            with pytest.raises(OutputError, match=f"law '{name}' has no counterpart in FEBio"):
                write_model(path, posed, Units(1e-3))


def test_displacements_that_vary_are_data_at_the_nodes(tmp_path: Path) -> None:
    """In the order of the node set; the reader lists them, since jobs have formulas there."""
    posed, path = body(), tmp_path / "part.feb"
    [top] = [group for group in posed.rest.groups if group.name == "z1"]
    nodes = np.unique(posed.rest.facets[top.members])
    posed.held.append(Held("supports[0]", nodes, 1, 1e-3 * np.arange(len(nodes), dtype=np.float64), "z1"))
    write_model(path, posed, Units(1e-3))
    root = ET.parse(path).getroot()
    [data] = root.iter("NodeData")
    [listed] = [entry.text or "" for entry in root.iter("NodeSet") if entry.get("name") == "z1"]
    assert [int(entry) for entry in listed.split(",")] == posed.rest.node_tags[nodes].tolist()
    assert [float(entry.text or "") for entry in data] == pytest.approx(np.arange(len(nodes)))
    [condition] = root.findall("Boundary/bc")
    assert condition.findtext("value") == data.get("name")
    back = tmp_path / "back.yaml"
    assert main(["new", "job", "--from", str(path), "--unit", "mm", "--stress-unit", "MPa", str(back)]) == 0
    assert "Not taken from the file: <bc type='prescribed displacement'> on z1" in back.read_text()


def test_two_laws_are_two_parts(tmp_path: Path) -> None:
    posed, path = body(), tmp_path / "part.feb"
    law = laws()["neo-hookean"]
    regions = [group.name for group in posed.rest.groups if group.dim == 3]
    posed.laws = {region: law.model_validate(law.example) for region in regions}
    write_model(path, posed, Units(1.0))
    root = ET.parse(path).getroot()
    assert [part.get("name") for part in root.iter("Elements")] == regions
    assert [domain.get("mat") for domain in root.iter("SolidDomain")] == regions
    assert root.findtext("Module/units") == "SI"


OUTWARD = {"x0": (-1, 0, 0), "x1": (1, 0, 0), "y0": (0, -1, 0), "y1": (0, 1, 0), "z0": (0, 0, -1), "z1": (0, 0, 1)}


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("hexahedra", [False, True])
def test_surfaces_have_the_facets_of_the_elements_and_turn_outward(
    hexahedra: bool, degree: int, tmp_path: Path
) -> None:
    """FEBio presses along the negative normal of a facet, as its nodes turn, and has no forces on nodes it lacks."""
    posed, path = body(hexahedra, degree), tmp_path / "part.feb"
    write_model(path, posed, Units(1.0))
    root, size = ET.parse(path).getroot(), 4 if hexahedra else 3
    rows = [(int(node.get("id", "")), (node.text or "").split(",")) for node in root.iter("node")]
    places = {tag: np.array([float(x) for x in row]) for tag, row in rows}
    kinds = {(False, 1): "tri3", (False, 2): "tri6", (True, 1): "quad4", (True, 2): "quad9"}
    for surface in root.iter("Surface"):
        for facet in surface:
            assert facet.tag == kinds[hexahedra, degree]
            points = np.array([places[int(tag)] for tag in (facet.text or "").split(",")])
            normal = np.cross(points[1] - points[0], points[2] - points[0])
            assert normal / np.linalg.norm(normal) == pytest.approx(np.array(OUTWARD[surface.get("name", "")]))
            edges = (points[:size] + np.roll(points[:size], -1, axis=0)) / 2
            if degree == 2:
                assert points[size : 2 * size] == pytest.approx(edges)
            if len(points) == 9:
                assert points[8] == pytest.approx(points[:4].mean(axis=0))


def test_elements_of_27_nodes_have_the_order_of_febio(tmp_path: Path) -> None:
    """Faces at s = -1, r = 1, s = 1, r = -1, t = -1 and t = 1 of FEHex27::shape_fnc, then the centre."""
    posed, path = body(True, 2), tmp_path / "part.feb"
    write_model(path, posed, Units(1.0))
    root = ET.parse(path).getroot()
    places = {node.get("id"): [float(x) for x in (node.text or "").split(",")] for node in root.iter("node")}
    [part] = root.iter("Elements")
    assert part.get("type") == "hex27"
    faces = [(0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7), (0, 1, 2, 3), (4, 5, 6, 7), range(8)]
    for element in part:
        points = np.array([places[tag] for tag in (element.text or "").split(",")])
        assert points[20:] == pytest.approx(np.array([points[list(face)].mean(axis=0) for face in faces]))


@pytest.mark.parametrize(
    ("law", "kind", "formulation"),
    [
        ({"law": "isochoric-neo-hookean", "mu": 1e4, "kappa": 4e4}, (True, 1), "elastic-solid"),
        ({"law": "isochoric-neo-hookean", "mu": 1e4, "kappa": 4e7}, (True, 1), "three-field-solid"),
        ({"law": "isochoric-neo-hookean", "mu": 1e4, "kappa": 4e7}, (False, 2), "three-field-solid"),
        ({"law": "isochoric-neo-hookean", "mu": 1e4, "kappa": 4e7}, (False, 1), "ut4-solid"),
        ({"law": "hencky", "mu": 1e4, "kappa": 4e7, "volumetric": "logarithmic"}, (True, 1), "elastic-solid"),
        ({"law": "neo-hookean", "mu": 1e4, "lam": 4e7}, (True, 1), "elastic-solid"),
    ],
)
def test_nearly_incompressible_laws_have_a_formulation_with_a_pressure(
    law: dict[str, Any], kind: tuple[bool, int], formulation: str, tmp_path: Path
) -> None:
    posed, path = body(*kind), tmp_path / "part.feb"
    posed.laws = {"": laws()[law["law"]].model_validate(law)}
    write_model(path, posed, Units(1.0))
    [domain] = ET.parse(path).getroot().iter("SolidDomain")
    assert domain.get("type") == formulation
