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
from hpcinv.formats.cards.febio import _CARDS
from hpcinv.job.job import load
from hpcinv.physics.effects import effects
from hpcinv.physics.materials import laws
from hpcinv.studies.second_opinion.febio_model import LOADS, write_model
from hpcinv.studies.second_opinion.loaded_body import Held, LoadedBody, add_loads

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


def body(hexahedra: bool = False) -> LoadedBody:
    mesh = block(MESHES, hexahedra, 1)
    law = laws()["neo-hookean"]
    one = {"": law.model_validate(law.example)}
    return LoadedBody(name="a", rest=mesh, loaded=mesh.points, laws=one, forces=np.zeros_like(mesh.points))


@pytest.mark.parametrize("hexahedra", [False, True])
def test_a_model_that_is_read_back_loads_the_rest_shape_into_the_given_body(hexahedra: bool, tmp_path: Path) -> None:
    mesh = BODY["mesh"] | {"parameters": BODY["mesh"]["parameters"] | {"hexahedra": hexahedra}}
    run, model, back = tmp_path / "run", tmp_path / "part.feb", tmp_path / "back.yaml"
    given = hpcinv.run(job(**BODY | {"mesh": mesh}), MPI.COMM_SELF, directory=run, progress=False)
    assert main(["export", str(run), "--deck", str(model), "--unit", "mm"]) == 0
    assert main(["new", "job", "--from", str(model), "--unit", "mm", "--stress-unit", "MPa", str(back)]) == 0
    text = back.read_text()
    assert "Not taken from the file" not in text
    again = load(back).with_({"discretisation": BODY["discretisation"], "certificate": "off"})
    assert {(s.region, tuple(sorted(s.held))) for s in again.supports} == {("z0", ("x", "y", "z")), ("z1", ("x",))}
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
        if name in _CARDS:
            write_model(path, posed, 1e-3)
            [material] = ET.parse(path).getroot().iter("material")
            assert float(material.findtext("density", "")) == pytest.approx(1e-9)  # t/mm³
        else:
            with pytest.raises(OutputError, match=f"law '{name}' has no counterpart in FEBio"):
                write_model(path, posed, 1e-3)


def test_displacements_that_vary_are_data_at_the_nodes(tmp_path: Path) -> None:
    """In the order of the node set; the reader lists them, since jobs have formulas there."""
    posed, path = body(), tmp_path / "part.feb"
    [top] = [group for group in posed.rest.groups if group.name == "z1"]
    nodes = np.unique(posed.rest.facets[top.members])
    posed.held.append(Held("supports[0]", nodes, 1, 1e-3 * np.arange(len(nodes), dtype=np.float64), "z1"))
    write_model(path, posed, 1e-3)
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
    write_model(path, posed, 1.0)
    root = ET.parse(path).getroot()
    assert [part.get("name") for part in root.iter("Elements")] == regions
    assert [domain.get("mat") for domain in root.iter("SolidDomain")] == regions
    assert root.findtext("Module/units") == "SI"
