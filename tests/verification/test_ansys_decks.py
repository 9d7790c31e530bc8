"""Whole decks for Ansys: read back they are the same problem; what they cannot say is refused by its name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.mesh_data_files import block
from helpers.second_opinions import BLOCK, reaches_given_body, solved
from helpers.verification import job

import hpcinv
from hpcinv.__main__ import main
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.reading.archive_conditions import BRICK, COLLAPSED, TETRAHEDRON
from hpcinv.base.reading.element_faces import FACES
from hpcinv.errors import OutputError
from hpcinv.formats.cards.ansys import _CARDS
from hpcinv.job.job import Job, load
from hpcinv.mesh.source import Group
from hpcinv.physics.materials import laws
from hpcinv.studies.second_opinion.ansys_archive import write_archive
from hpcinv.studies.second_opinion.loaded_body import Held, LoadedBody
from hpcinv.studies.second_opinion.slides import Slide
from hpcinv.studies.second_opinion.units import Units

MESHES = Path(__file__).parents[2] / "meshes"
SIZE = {"lx": 0.1, "ly": 0.1, "lz": 0.2, "nx": 1, "ny": 1, "nz": 2}
BODY: dict[str, Any] = {
    "analysis": "inverse",
    "mesh": {"file": "../meshes/box.py", "parameters": SIZE},
    "material": {"law": "isochoric-neo-hookean", "mu": 1e4, "kappa": 4e4},
    "discretisation": {"displacement": 1, "formulation": "displacement"},
    "effects": [
        {"effect": "gravity", "acceleration": [1, 0, -2], "density": 1000},
        {"effect": "pressure", "region": "x0", "pressure": 100},
        {"effect": "pressure", "region": "x1", "pressure": 50},
        {"effect": "traction", "region": "y1", "traction": [10, 50, 0], "area_in": "reference"},
    ],
    "supports": [
        {"region": "z0", "fix": ["x", "y", "z"]},
        {"region": "y0", "fix": ["y"]},
        {"region": "z1", "displacement": ["2 mm", None, None]},
    ],
    "output": {"mesh": ["msh"], "fields": False},
}


def body(hexahedra: bool = False, degree: int = 1) -> LoadedBody:
    mesh = block(MESHES, hexahedra, degree)
    law = laws()["isochoric-neo-hookean"]
    one = {"": law.model_validate({"law": "isochoric-neo-hookean", "mu": 1e4, "kappa": 4e4})}
    return LoadedBody(name="a", rest=mesh, loaded=mesh.points, laws=one, forces=np.zeros_like(mesh.points))


def read_back(deck: Path, unit: str = "mm", stress: str = "MPa") -> tuple[Job, str]:
    """Return the job that a deck becomes, and its text."""
    path = deck.with_name("back.yaml")
    assert main(["new", "job", "--from", str(deck), "--unit", unit, "--stress-unit", stress, str(path)]) == 0
    return load(path), path.read_text()


@pytest.mark.everyday("False-1", "False-2")
@pytest.mark.parametrize(("hexahedra", "degree"), [(False, 1), (False, 2), (True, 1)])
def test_a_deck_that_is_read_back_loads_the_rest_shape_into_the_given_body(
    hexahedra: bool, degree: int, tmp_path: Path
) -> None:
    spaces = {"displacement": degree, "formulation": "displacement"}
    mesh = {"file": "../meshes/box.py", "parameters": SIZE | {"hexahedra": hexahedra}, "geometry_degree": degree}
    run, deck = tmp_path / "run", tmp_path / "part.cdb"
    given = hpcinv.run(
        job(**BODY | {"mesh": mesh, "discretisation": spaces}), MPI.COMM_SELF, directory=run, progress=False
    )
    assert main(["export", str(run), "--deck", str(deck), "--unit", "mm"]) == 0
    again, text = read_back(deck)
    assert "Not taken from the file" not in text
    regions = {"z0": ("x", "y", "z"), "y0": ("y",), "z1": ("x",)}
    assert {support.region: tuple(sorted(support.held)) for support in again.supports} == regions
    kinds = sorted((type(effect).__name__, getattr(effect, "region", "")) for effect in again.effects)
    assert kinds == [("Gravity", ""), ("Pressure", "x0"), ("Pressure", "x1"), ("Traction", "y1")]
    loaded = hpcinv.run(again.with_({"discretisation": spaces, "certificate": "off"}), MPI.COMM_SELF, progress=False)
    size = np.abs(given.shape_in_file - given.given_in_file).max()
    assert size > 1e-3
    np.testing.assert_allclose(loaded.shape_in_file, given.given_in_file, rtol=0, atol=1e-5 * size)


FACES_OF_ANSYS = {
    "brick": (BRICK, "IJKLMNOP", {1: "JILK", 2: "IJNM", 3: "JKON", 4: "KLPO", 5: "LIMP", 6: "MNOP"}),
    "tetrahedron": (TETRAHEDRON, "IJKL", {1: "JIK", 2: "IJL", 3: "JKL", 4: "KIL"}),
    "collapsed": (COLLAPSED, "IJKM", {1: "JIKK", 2: "IJMM", 3: "JKMM", 5: "KIMM"}),  # K is L; M is N, O and P
}
"""faces by the letters of their nodes, in the Element Reference; of a brick with L as K, and N, O and P as M"""


@pytest.mark.parametrize("shape", FACES_OF_ANSYS)
def test_faces_have_the_numbers_of_the_element_reference(shape: str) -> None:
    places, letters, faces = FACES_OF_ANSYS[shape]
    ours = FACES[len(letters)]
    assert {face: {letters[i] for i in ours[place]} for face, place in places.items()} == {
        face: set(nodes) for face, nodes in faces.items()
    }


@pytest.mark.parametrize(
    ("hexahedra", "degree", "kappa", "lines"),
    [
        (False, 1, 4e4, ["ET,1,185"]),
        (False, 1, 1e7, ["ET,1,285"]),
        (False, 2, 4e4, ["ET,1,187"]),
        (False, 2, "incompressible", ["ET,1,187", "KEYOPT,1,6,1"]),
        (True, 1, 1e7, ["ET,1,185", "KEYOPT,1,6,1"]),
        (True, 2, 4e4, ["ET,1,186", "KEYOPT,1,2,1"]),
        (True, 2, 1e7, ["ET,1,186", "KEYOPT,1,6,1"]),
    ],
)
def test_nearly_incompressible_laws_have_elements_with_a_pressure(
    hexahedra: bool, degree: int, kappa: float | str, lines: list[str], tmp_path: Path
) -> None:
    posed, path = body(hexahedra, degree), tmp_path / "part.dat"
    law = laws()["isochoric-neo-hookean"]
    posed.laws = {"": law.model_validate({"law": "isochoric-neo-hookean", "mu": 1e4, "kappa": kappa})}
    deck = write_archive(path, posed, Units(1.0))
    written = [line for line in path.read_text().splitlines() if line.startswith(("ET,", "KEYOPT,"))]
    assert written == lines
    assert f"ET,1,{deck.element.removeprefix('SOLID')}" == lines[0]


def test_gravity_is_an_acceleration_of_the_frame_the_other_way(tmp_path: Path) -> None:
    posed, path = body(), tmp_path / "part.cdb"
    posed.density, posed.acceleration = 1000.0, np.array([0.0, 0.0, -9.81])
    write_archive(path, posed, Units(1e-3))
    text = path.read_text()
    assert "\nACEL,0.0,0.0,9810.0\n" in text
    assert float(text.partition("\nMP,DENS,1,")[2].split()[0]) == pytest.approx(1e-9)  # t/mm³
    assert "\n/UNITS,MPA\n" in text


def test_every_law_is_written_or_refused_by_its_name(tmp_path: Path) -> None:
    for name, law in laws().items():
        posed, path = body(), tmp_path / f"{name}.cdb"
        volume = {"volumetric": "simo-taylor"} if name in ("arruda-boyce", "gent") else {}  # which Ansys has
        posed.laws = {"": law.model_validate(law.example | volume)}
        if name in _CARDS and name != "neo-hookean":
            write_archive(path, posed, Units(1.0))
            assert "TB,HYPER,1," in path.read_text()
        else:
            with pytest.raises(OutputError, match=f"law '{name}' has no counterpart in Ansys"):
                write_archive(path, posed, Units(1.0))
            assert not path.exists()


def test_two_laws_are_two_materials(tmp_path: Path) -> None:
    posed, path = body(), tmp_path / "part.cdb"
    law = laws()["isochoric-neo-hookean"]
    cells = np.arange(len(posed.rest.cells))
    halves = Group("low", 3, 8, cells[::2]), Group("high", 3, 9, cells[1::2])
    posed.rest = replace(posed.rest, groups=(*posed.rest.groups, *halves))
    moduli = {"low": 1e4, "high": 2e4}
    posed.laws = {
        region: law.model_validate({"law": "isochoric-neo-hookean", "mu": mu, "kappa": 4e4})
        for region, mu in moduli.items()
    }
    write_archive(path, posed, Units(1.0))
    again, _ = read_back(path, "m", "Pa")
    found = sorted(law.quantities()["mu"][0] for law in again.laws.values())
    assert found == pytest.approx(list(moduli.values()))


def test_displacements_that_vary_are_of_each_node(tmp_path: Path) -> None:
    posed, path = body(), tmp_path / "part.cdb"
    [top] = [group for group in posed.rest.groups if group.name == "z1"]
    nodes = np.unique(posed.rest.facets[top.members])
    values = 1e-3 * np.arange(len(nodes), dtype=np.float64)
    posed.held.append(Held("supports[0]", nodes, 1, values, "z1"))
    write_archive(path, posed, Units(1e-3))
    rows = [line.split(",") for line in path.read_text().splitlines() if line.startswith("D,")]
    assert [(int(node), label) for _, node, label, _ in rows] == [(tag, "UY") for tag in posed.rest.node_tags[nodes]]
    assert [float(value) for *_, value in rows] == pytest.approx(values * 1e3)


def test_a_suffix_of_no_program_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(tmp_path), "--deck", str(tmp_path / "part.k")]) != 0
    assert "Let its name end with .inp, .feb, .cdb, .dat." in capsys.readouterr().err


def test_planes_are_equations_of_their_nodes_and_are_read_back(tmp_path: Path) -> None:
    planes = [
        {"region": "x0", "fix": ["normal"], "normal": [2, 1, 0]},
        {"region": "y0", "fix": ["normal"], "normal": [0, 1, 1]},
    ]
    pressed = [BLOCK["effects"][0], {"effect": "pressure", "region": "y1", "pressure": 500}]
    run, deck = solved(tmp_path, effects=pressed, supports=[*BLOCK["supports"], *planes]), tmp_path / "part.cdb"
    assert main(["export", str(run), "--deck", str(deck), "--unit", "mm"]) == 0
    again, text = read_back(deck)
    assert "Not taken from the file" not in text
    slides = {support.region: support.normal for support in again.supports if support.slides}
    assert slides["x0"] == pytest.approx(np.array([2, 1, 0]) / 5**0.5)
    assert slides["y0"] == pytest.approx(np.array([0, 1, 1]) / 2**0.5)
    assert reaches_given_body(run, again) < 1e-5


def test_equations_begin_with_a_displacement_that_nothing_else_holds(tmp_path: Path) -> None:
    """The program eliminates the first term; what follows from other supports of a node has no equation."""
    posed, path = body(), tmp_path / "part.cdb"
    [side] = [group for group in posed.rest.groups if group.name == "x0"]
    nodes = np.unique(posed.rest.facets[side.members])
    first, second, third, *_ = nodes.tolist()
    posed.held = [Held("supports[0]", np.array([first, second]), 0, np.zeros(2))]
    posed.held += [Held("supports[1]", np.array([second]), 1, np.zeros(1))]
    directions = np.tile([0.8, 0.6, 0.0], (len(nodes), 1))
    posed.slides = [Slide("supports[2]", nodes, directions, np.zeros(len(nodes)), "x0")] * 2  # the same once more
    write_archive(path, posed, Units(1.0))
    rows = [line.split(",") for line in path.read_text().splitlines() if line.startswith("CE,")]
    found = {int(row[3]): row[4::3] for row in rows}
    tags = posed.rest.node_tags
    assert len(rows) == len(nodes) - 1
    assert (found[tags[first]], found[tags[third]]) == (["UY", "UX"], ["UX", "UY"])
    assert tags[second] not in found
    posed.slides = [replace(posed.slides[0], values=np.full(len(nodes), 1e-3))]
    with pytest.raises(OutputError, match=r"supports\[2\]: nodes move along the normals"):
        write_archive(path, posed, Units(1.0))
