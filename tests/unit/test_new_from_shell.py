"""``hpcinv new job --from`` of shells: sections, faces and edges of loads, directors that supports hold."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from hpcinv.__main__ import main
from hpcinv.base.reading.inp_files import read_inp_shells
from hpcinv.job.job import load

PLATE = """*NODE, NSET=ALL
1,0,0,0
2,1,0,0
3,2,0,0
4,0,1,0
5,1,1,0
6,2,1,0
*ELEMENT, TYPE=S4, ELSET=PLATE
1, 1,2,5,4
2, 2,3,6,5
*NSET, NSET=LEFT
1,4
*NSET, NSET=RIGHT
3,6
*NSET, NSET=LOW
1,2,3
*SURFACE, NAME=TOP
PLATE, SPOS
*MATERIAL, NAME=STEEL
*ELASTIC
200.,0.3
*DENSITY
1e-9
*MATERIAL, NAME=SOFT
*ELASTIC
100.,0.3
*SHELL SECTION, ELSET=PLATE, MATERIAL=STEEL
0.1, 5
*STEP
*BOUNDARY
LEFT, ENCASTRE
*END STEP
"""
STEP = "*BOUNDARY\nLEFT, ENCASTRE\n"
SECTION = "*SHELL SECTION, ELSET=PLATE, MATERIAL=STEEL\n0.1, 5\n"


@pytest.fixture(autouse=True)
def _read_in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Read without a process of its own, which takes a second."""

    def read(action: str, path: Path, failure: str, advice: str) -> Any:
        assert action == "inp-shells"
        return read_inp_shells(path)

    # In this order: a module that is imported for its patch must not find the other one patched, and keep that.
    for module in ("hpcinv.formats.readers.shell_surfaces", "hpcinv.mesh.io.isolated"):
        monkeypatch.setattr(f"{module}.read_isolated", read)


def job_of(tmp_path: Path, text: str) -> tuple[dict[str, Any], str]:
    """Return the job of a deck, and its text."""
    (tmp_path / "plate.inp").write_text(text)
    output = tmp_path / "plate.yaml"
    options = ["--unit", "mm", "--stress-unit", "MPa", "--force"]
    assert main(["new", "job", "--from", str(tmp_path / "plate.inp"), *options, str(output)]) == 0
    written = output.read_text()
    return yaml.safe_load(written), written


def with_step(lines: str, section: str = SECTION) -> str:
    """Return the plate with other conditions."""
    return PLATE.replace(STEP, lines).replace(SECTION, section)


def test_a_section_is_the_shell_of_the_mesh(tmp_path: Path) -> None:
    job, text = job_of(tmp_path, PLATE)
    assert job["mesh"] == {"file": "plate.inp", "unit": "mm", "shell": {"thickness": "0.1 mm"}}
    assert job["supports"] == [{"region": "LEFT", "fix": ["x", "y", "z"]}]
    assert "Not taken" not in text
    job, _ = job_of(tmp_path, PLATE.replace("MATERIAL=STEEL\n0", "MATERIAL=STEEL, OFFSET=SPOS\n0"))
    assert job["mesh"]["shell"]["surface"] == "outer"
    turned = PLATE.replace("1,2,5,4", "1,4,5,2").replace("2,3,6,5", "2,5,6,3")
    job, _ = job_of(tmp_path, turned.replace("MATERIAL=STEEL\n0", "MATERIAL=STEEL, OFFSET=-0.5\n0"))
    assert job["mesh"]["shell"]["surface"] == "inner"


def test_layers_begin_opposite_to_the_normals(tmp_path: Path) -> None:
    section = "*SHELL SECTION, ELSET=PLATE, COMPOSITE\n0.1,,STEEL\n0.2,,SOFT\n"
    job, _ = job_of(tmp_path, with_step(STEP, section))
    assert job["mesh"]["shell"] == {"thickness": "0.3 mm", "layers": {"layer1": 0.1, "layer2": 0.2}}
    assert {name: law["young"] for name, law in job["material"].items()} == {"layer1": "200 MPa", "layer2": "100 MPa"}


def test_thickness_at_nodes_is_an_array_of_the_mesh(tmp_path: Path) -> None:
    section = "*SHELL SECTION, ELSET=PLATE, MATERIAL=STEEL, NODAL THICKNESS\n*NODAL THICKNESS\nALL, 0.1\nRIGHT, 0.2\n"
    job, _ = job_of(tmp_path, with_step(STEP, section))
    assert job["mesh"]["shell"] == {"thickness": {"data": "nodal_thickness", "unit": "mm"}}
    job, _ = job_of(tmp_path, with_step(STEP, section.replace("RIGHT", "LEFT").replace("0.2", "0.1")))
    assert job["mesh"]["shell"] == {"thickness": "0.1 mm"}


@pytest.mark.parametrize(
    ("lines", "supports", "unused"),
    [
        ("LEFT, PINNED\n", [{"region": "LEFT", "fix": ["x", "y", "z"], "hinge": True}], ""),
        ("LEFT, XSYMM\n", [{"region": "LEFT", "fix": ["x"]}], ""),
        ("LOW, 2, 4\n", [{"region": "LOW", "fix": ["y"]}, {"region": "LOW", "fix": ["z"], "hinge": True}], ""),
        ("LOW, 3\nLOW, 6\n", [{"region": "LOW", "fix": ["z"], "hinge": True}], ""),  # about its normal it is free
        ("LOW, 3, 4\n", [{"region": "LOW", "fix": ["z"], "hinge": True}], "rotations of 'LOW' about x, where"),
        ("LEFT, 1, 6\nRIGHT, 1, 1, 0.2\n", [{"region": "LEFT", "fix": ["x", "y", "z"]}], ""),
        (
            "LEFT, 1, 6\nRIGHT, 5, 5, 0.2\n",
            [{"region": "LEFT", "fix": ["x", "y", "z"]}],
            "rotations of 'RIGHT' about y",
        ),
        ("1, 1, 6\n4, 1, 6\n", [{"region": "held-rxryrzxyz", "fix": ["x", "y", "z"]}], ""),
        (
            "5, 1, 3\n",
            [{"region": "held_xyz_vertices", "fix": ["x", "y", "z"]}],
            "'held-xyz' that span no edge are held at",
        ),
    ],
)
def test_rotations_that_are_held_hold_the_director(
    tmp_path: Path, lines: str, supports: list[Any], unused: str
) -> None:
    job, text = job_of(tmp_path, with_step(f"*BOUNDARY\n{lines}"))
    assert job["supports"][: len(supports)] == supports
    assert (unused in text) if unused else ("Not taken" not in text)


def test_a_pressure_pushes_along_the_normals(tmp_path: Path) -> None:
    back = {"effect": "pressure", "region": "PLATE|inner", "pressure": "0.5 MPa"}
    job, _ = job_of(tmp_path, PLATE.replace("*END", "*DLOAD\nPLATE, P, 0.5\n*END"))
    assert job["effects"] == [back]
    job, _ = job_of(tmp_path, PLATE.replace("*END", "*DSLOAD\nTOP, P, 0.5\n*END"))
    assert job["effects"] == [{**back, "region": "TOP|outer"}]
    job, _ = job_of(tmp_path, PLATE.replace("*END", "*DLOAD\n2, P, 0.5\n*END"))
    assert job["effects"] == [{**back, "region": "pressed|inner"}]
    mixed = PLATE.replace("2,3,6,5", "2,5,6,3").replace("*END", "*DLOAD\nPLATE, P, 0.5\n2, P, 0.1\n*END")
    job, text = job_of(tmp_path, mixed)
    assert job["effects"] == [{**back, "region": "pressed|outer", "pressure": "0.1 MPa"}]
    assert "Not taken from the file: pressure on 'PLATE', whose elements have opposite normals" in text


def test_forces_and_moments_of_an_edge_act_on_its_band(tmp_path: Path) -> None:
    lines = "*DLOAD\n2, EDNOR2, 0.3\nPLATE, GRAV, 9810, 0,0,-1\n*CLOAD\nRIGHT, 3, 0.05\n3, 5, 1e-3\n6, 5, 1e-3\n"
    job, text = job_of(tmp_path, PLATE.replace("*END", f"{lines}*END"))
    gravity, pressure, traction, moment = job["effects"]
    assert pressure == {"effect": "pressure", "region": "edge-loaded", "pressure": "3 MPa"}
    assert gravity["effect"] == "gravity"
    assert traction["region"] == "RIGHT"
    assert traction["traction"] == ["0 MPa", "0 MPa", "1 MPa"]
    assert moment == {"effect": "edge-moment", "region": "turned", "moment": ["0 N", "0.002 N", "0 N"]}
    assert "Not taken" not in text
    load(tmp_path / "plate.yaml")
    job, text = job_of(tmp_path, PLATE.replace("*END", "*CLOAD\n3, 6, 1e-3\n6, 6, 1e-3\n*END"))
    assert "which turn the edge in the surface" in text
    job, text = job_of(tmp_path, PLATE.replace("*END", "*CLOAD\n3, 5, 1.\n6, 5, 1.\n1, 5, 1.\n*END"))
    assert "1 of its nodes are on no edge and cell of 'turned'" in text
    assert not job["effects"]


@pytest.mark.parametrize(
    ("line", "unused"),
    [
        ("2, EDNOR, 0.3", "*DLOAD of single nodes or elements (1)"),
        ("2, EDNOR5, 0.3", "*DLOAD of single nodes or elements (1)"),
        ("PLATE, EDNOR5, 0.3", "*DLOAD, EDNOR5 on PLATE"),
        ("PLATE, P7, 0.3", "*DLOAD, P7 on PLATE"),
    ],
)
def test_loads_on_edges_that_no_element_has_are_listed(tmp_path: Path, line: str, unused: str) -> None:
    job, text = job_of(tmp_path, PLATE.replace("*END", f"*DLOAD\n{line}\n*END"))
    assert not job["effects"]
    assert unused in text


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("*STEP", "*SOLID SECTION, ELSET=B, MATERIAL=STEEL\n*STEP"), "shells tied to solids or beams"),
        (("MATERIAL=STEEL\n0.1", "MATERIAL=STEEL, OFFSET=0.2\n0.1"), "has OFFSET=0.2, which has no counterpart"),
        (("*STEP", "*ELEMENT, TYPE=S4, ELSET=B\n3, 1,2,5,4\n*STEP"), "more than two cells meet"),
        (
            ("*STEP", "*ELSET, ELSET=B\n2\n*SHELL SECTION, ELSET=B, MATERIAL=STEEL\n0.2\n*STEP"),
            "shells of PLATE and B have other thicknesses",
        ),
        ((SECTION, "*SHELL SECTION, ELSET=PLATE, COMPOSITE\n0.1, 3\n"), "a layer needs its thickness"),
        ((SECTION, "*SHELL GENERAL SECTION, ELSET=PLATE\n1,2,3\n"), "has stiffnesses instead of MATERIAL="),
        (("0.1, 5", "thin"), "'thin' is not a number"),
    ],
)
def test_shells_without_a_counterpart_are_refused(
    tmp_path: Path, change: tuple[str, str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "plate.inp").write_text(PLATE.replace(*change, 1))
    options = ["--unit", "mm", "--stress-unit", "MPa", str(tmp_path / "plate.yaml")]
    assert main(["new", "job", "--from", str(tmp_path / "plate.inp"), *options]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "plate.yaml").exists()


UD = "*ELASTIC, TYPE=ENGINEERING CONSTANTS\n140., 10., 10., 0.3, 0.3, 0.4, 5., 5.,\n3.5\n"
AXES = "*ORIENTATION, NAME=O0\n1,0,0,0,1,0\n*ORIENTATION, NAME=O45\n1,0,0,0,1,0\n3, 45.\n"


def test_plies_of_a_flat_shell_have_their_axes(tmp_path: Path) -> None:
    section = "*SHELL SECTION, ELSET=PLATE, COMPOSITE\n0.1,,STEEL,O0\n0.2,,SOFT,O45\n"
    text = PLATE.replace("*ELASTIC\n200.,0.3\n", UD).replace("*ELASTIC\n100.,0.3\n", UD.replace("140.", "70."))
    job, _ = job_of(tmp_path, text.replace(SECTION, AXES + section))
    assert job["material"].keys() == {"layer1", "layer2"}
    first = [job["fibres"][name]["direction"] for name in job["material"]["layer1"].get("fibres", "abc")]
    second = [job["fibres"][name]["direction"] for name in ("ax2", "bx2", "cx2")]
    assert first == [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    assert second[0] == pytest.approx([0.5**0.5, 0.5**0.5, 0])
    assert second[1] == pytest.approx([-(0.5**0.5), 0.5**0.5, 0])


@pytest.mark.parametrize(
    ("axes", "named"), [(",O0|,O45", "*ORIENTATION O0, O45"), ("|", "the axes of the coordinates")]
)
def test_plies_of_a_curved_shell_are_refused_by_the_name_of_their_axes(
    axes: str, named: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second = axes.split("|")
    section = f"*SHELL SECTION, ELSET=PLATE, COMPOSITE\n0.1,,STEEL{first}\n0.2,,STEEL{second}\n"
    text = PLATE.replace("*ELASTIC\n200.,0.3\n", UD).replace("6,2,1,0\n", "6,2,1,0.5\n")
    (tmp_path / "plate.inp").write_text(text.replace(SECTION, AXES + section))
    options = ["--unit", "mm", "--stress-unit", "MPa", str(tmp_path / "plate.yaml")]
    assert main(["new", "job", "--from", str(tmp_path / "plate.inp"), *options]) == 2
    assert named in capsys.readouterr().err
