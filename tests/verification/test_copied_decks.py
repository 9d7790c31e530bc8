"""A deck of another program, with the nodes of the rest shape: everything else stays, and CalculiX loads it back."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from hpcinv.__main__ import main
from hpcinv.errors import MeshError
from hpcinv.formats.cards.moved_inp import moved_deck
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


def copied(directory: Path) -> str:
    """Find the rest shape of the deck, and return the deck with its nodes."""
    (directory / "part.inp").write_text(DECK)
    job = directory / "part.yaml"
    given = ["--from", str(directory / "part.inp"), "--unit", "mm", "--stress-unit", "MPa", str(job)]
    assert main(["new", "job", *given]) == 0
    content = yaml.safe_load(job.read_text()) | {"analysis": "inverse", "output": {"mesh": ["msh"], "fields": False}}
    content |= {"discretisation": {"displacement": 1, "formulation": "displacement"}, "certificate": "off"}
    job.write_text(yaml.safe_dump(content))
    assert main(["run", str(job), "--output", str(directory / "run"), "--quiet"]) == 0
    new = directory / "rest.inp"
    assert main(["export", str(directory / "run"), "--to", str(new), "--copy-of", str(directory / "part.inp")]) == 0
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
