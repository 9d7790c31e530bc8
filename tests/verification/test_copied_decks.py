"""A deck of another program, with the nodes of the rest shape: everything else stays, and CalculiX loads it back."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from hpcinv.__main__ import main
from hpcinv.errors import MeshError
from hpcinv.formats.cards.moved_cdb import moved_archive
from hpcinv.formats.cards.moved_feb import moved_model
from hpcinv.formats.cards.moved_inp import moved_deck
from hpcinv.geometry.workshop.run_shapes import read_shape
from hpcinv.studies.second_opinion.calculix import command, displacements

DECK = """** a foot of rubber, as scanned
*Heading
 from a scan
*NODE, NSET=All
1,0,0,0
2,10,0,0
3,0,10,0
** a note between nodes
4,  0.0, 0, 10.0
5,10,10,10
99, 50, 0, 0
*ELEMENT, TYPE=C3D4, ELSET=Body
1,1,2,3,4
2,2,3,4,5
*NSET, NSET=Foot
1,2,3
*SURFACE, NAME=Side
2, S3
*SOLID SECTION, ELSET=Body, MATERIAL=Rubber
*MATERIAL, NAME=Rubber
*HYPERELASTIC, NEO HOOKE
0.1, 5
*STEP, NLGEOM
*STATIC
.2, 1.
*BOUNDARY
Foot, 1, 3
*DLOAD
2, P3, 0.01
*NODE PRINT, NSET=All
U
*END STEP
"""


MODEL = """<?xml version="1.0"?>
<febio_spec version="4.0">
<!-- a foot of rubber: <node id="1">7,7,7</node> -->
<Material><material id="1" name="Rubber" type="neo-Hookean"><E>0.3</E><v>0.4</v></material></Material>
<Mesh>
<Nodes name="All">
<node id="1">0,0,0</node>
<node id="2">10,0,0</node>
<node id="3">0,10,0</node> <!-- note -->
<node id="4">  0.0, 0, 10.0</node>
<node id='5'>10,10,10</node>
<node id="99">50,0,0</node>
</Nodes>
<Elements type="tet4" name="Body"><elem id="1">1,2,3,4</elem><elem id="2">2,3,4,5</elem></Elements>
<NodeSet name="Foot">1,2,3</NodeSet>
<Surface name="Side"><tri3 id="1">3,5,4</tri3></Surface>
</Mesh>
<MeshDomains><SolidDomain name="Body" mat="Rubber"/></MeshDomains>
<Boundary>
<bc node_set="Foot" type="zero displacement"><x_dof>1</x_dof><y_dof>1</y_dof><z_dof>1</z_dof></bc>
</Boundary>
<Loads><surface_load surface="Side" type="pressure"><pressure>0.01</pressure></surface_load></Loads>
</febio_spec>
"""
ARCHIVE = f"""! a foot of rubber
/PREP7
ET,1,285
NBLOCK,6,SOLID,99,6
(3i9,6e21.13e3)
        1        0        0
        2        0        0 1.0000000000000E+001
        3        0        0 0.0000000000000E+000 1.0000000000000E+001
        4        0        0 0.0000000000000E+000 0.0000000000000E+000 1.0000000000000E+001
        5        0        0 1.0000000000000E+001 1.0000000000000E+001 1.0000000000000E+001
       99        0        0 5.0000000000000E+001
N,R5.3,LOC,       -1,
EBLOCK,19,SOLID,2,2
(19i9)
{"".join(f"{i:9d}" for i in (1, 1, 1, 1, 0, 0, 0, 0, 4, 0, 1, 1, 2, 3, 4))}
{"".join(f"{i:9d}" for i in (1, 1, 1, 1, 0, 0, 0, 0, 4, 0, 2, 2, 3, 4, 5))}
       -1
CMBLOCK,FOOT,NODE,2
(8i10)
         1        -3
MP,EX,1,0.3
MP,PRXY,1,0.4
D,FOOT,ALL,0
SFE,2,3,PRES,,0.01
FINISH
"""


def copied(directory: Path, deck: str = DECK, suffix: str = ".inp") -> str:
    """Find the rest shape of a deck, and return the deck with its nodes."""
    part = directory / f"part{suffix}"
    part.write_text(deck)
    job = directory / "part.yaml"
    given = ["--from", str(part), "--unit", "mm", "--stress-unit", "MPa", str(job)]
    assert main(["new", "job", *given]) == 0
    content = yaml.safe_load(job.read_text()) | {"analysis": "inverse", "output": {"mesh": ["msh"], "fields": False}}
    content |= {"discretisation": {"displacement": 1, "formulation": "displacement"}, "certificate": "off"}
    job.write_text(yaml.safe_dump(content))
    assert main(["run", str(job), "--output", str(directory / "run"), "--quiet"]) == 0
    new = directory / f"rest{suffix}"
    assert main(["export", str(directory / "run"), "--to", str(new), "--copy-of", str(part)]) == 0
    return new.read_text()


def test_only_the_coordinates_of_nodes_of_the_mesh_change(tmp_path: Path) -> None:
    old, new = DECK.splitlines(), copied(tmp_path).splitlines()
    changed = [before for before, after in zip(old, new, strict=True) if before != after]
    assert changed == ["1,0,0,0", "2,10,0,0", "3,0,10,0", "4,  0.0, 0, 10.0", "5,10,10,10"]
    places = np.array([[float(x) for x in line.split(",")[1:]] for line in new[4:7]])
    assert places == pytest.approx(np.array([[0, 0, 0], [10, 0, 0], [0, 10, 0]]), abs=1e-9)  # the foot


@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX is not installed")
def test_calculix_loads_the_copy_into_the_first_deck(tmp_path: Path) -> None:
    new = copied(tmp_path)
    tags = np.array([4, 5])
    moved = displacements(command(None), tmp_path / "rest.inp", tags, 60)
    rows = {line.split(",")[0]: line.split(",")[1:] for line in new.splitlines()[4:10]}
    rest = np.array([[float(x) for x in rows[str(tag)]] for tag in tags])
    assert np.abs(moved).max() > 0.05
    assert rest + moved == pytest.approx(np.array([[0, 0, 10], [10, 10, 10]]), abs=1e-4)  # it stops at 0.5 %


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("*NODE, NSET=All", "*NODE, NSET=All, SYSTEM=C", "line 4: .NODE, SYSTEM=C: coordinates are not x, y, z"),
        ("*NODE, NSET=All", "*NODE, NSET=All, INPUT=a.txt", "line 4: .NODE: nodes do not have their coordinates"),
        ("*NSET, NSET=Foot", "*NGEN\n1, 3, 1\n*NSET, NSET=Foot", "line 15: .NGEN: nodes do not have"),
        ("1,0,0,0", "1,0,0,0,0,0,1", "line 5: node 1 has a direction"),
        ("5,10,10,10\n", "", "node 5 of the mesh is not among its lines"),
        ("*HEADING", "*PART, NAME=A\n*END PART\n*PART, NAME=B", "line 4: .PART: several parts"),
    ],
)
def test_decks_whose_coordinates_are_elsewhere_are_refused(old: str, new: str, message: str) -> None:
    text = DECK.replace("*Heading", "*HEADING")
    with pytest.raises(MeshError, match=message):
        moved_deck(text.replace(old, new, 1), dict.fromkeys(range(1, 6), (0.0, 0.0, 0.0)))


def test_a_moved_instance_is_refused() -> None:
    text = "*PART, NAME=A\n*NODE\n1,0,0,0\n*END PART\n*ASSEMBLY\n*INSTANCE, PART=A\n1,0,0\n*END INSTANCE\n"
    with pytest.raises(MeshError, match=r"line 7: \*INSTANCE moves or turns its part"):
        moved_deck(text, {1: (0.0, 0.0, 0.0)})


@pytest.mark.parametrize(("deck", "suffix", "first"), [(MODEL, ".feb", 6), (ARCHIVE, ".cdb", 5)])
def test_copies_for_other_programs_are_read_as_the_same_job(deck: str, suffix: str, first: int, tmp_path: Path) -> None:
    """Only the lines of nodes of the mesh change; the copy, loaded forward, is the first deck's body."""
    new = copied(tmp_path, deck, suffix)
    old, lines = deck.splitlines(), new.splitlines()
    changed = [i for i, (before, after) in enumerate(zip(old, lines, strict=True)) if before != after]
    assert set(changed) <= set(range(first, first + 5))
    assert {first + 3, first + 4} <= set(changed)
    job, run = tmp_path / "again.yaml", tmp_path / "again"
    given = ["--from", str(tmp_path / f"rest{suffix}"), "--unit", "mm", "--stress-unit", "MPa", str(job)]
    assert main(["new", "job", *given]) == 0
    spaces = {"displacement": 1, "formulation": "displacement"}
    more = {"output": {"mesh": ["msh"], "fields": False}, "discretisation": spaces, "certificate": "off"}
    job.write_text(yaml.safe_dump(yaml.safe_load(job.read_text()) | more))
    assert main(["run", str(job), "--output", str(run), "--quiet"]) == 0
    found, rest = (read_shape(run, shape).points * 1e3 for shape in ("deformed", "undeformed"))
    given_places = np.array([[0, 0, 0], [10, 0, 0], [0, 10, 0], [0, 0, 10], [10, 10, 10]])
    assert np.abs(rest[:5] - given_places).max() > 0.05
    assert found[:5] == pytest.approx(given_places, abs=1e-5)


def test_models_and_archives_without_a_node_are_refused() -> None:
    places = dict.fromkeys(range(1, 8), (0.0, 0.0, 0.0))
    for move, text in ((moved_model, MODEL), (moved_archive, ARCHIVE)):
        with pytest.raises(MeshError, match="node 6 of the mesh is not"):
            move(text, places)
    twice = MODEL.replace('<node id="99">', '<node id="1">')
    with pytest.raises(MeshError, match="line 12: node 1 is written twice"):
        moved_model(twice, {1: (0.0, 0.0, 0.0)})
    with pytest.raises(MeshError, match=r"line 5: .* is not a format"):
        moved_archive(ARCHIVE.replace("(3i9,6e21.13e3)", "(nine)"), {1: (0.0, 0.0, 0.0)})


def test_numbers_of_a_block_keep_its_width() -> None:
    text = ARCHIVE.replace("(3i9,6e21.13e3)", "(3i9,6e16.9)")
    line = moved_archive(text, {1: (-1.5, 1e-120, -1e-7)}).splitlines()[5]
    assert line == "        1        0        0-1.500000000E+00 0.000000000E+00-1.000000000E-07"


def test_copies_need_the_same_program(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(tmp_path), "--to", "a.inp", "--copy-of", "a.feb"]) != 0
    assert "--copy-of: needs two decks with one of the endings .inp, .feb, .cdb" in capsys.readouterr().err
