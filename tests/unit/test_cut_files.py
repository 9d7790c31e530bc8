"""Mesh files of other programs that were cut, or that say more than one thing by one name."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from helpers.mesh_cases import spec

from hpcinv.base.reading.bdf_files import read_bdf
from hpcinv.base.reading.fault import Fault
from hpcinv.base.reading.inp_files import read_inp
from hpcinv.errors import MeshError
from hpcinv.formats.med import read_med
from hpcinv.formats.medit import read_medit
from hpcinv.formats.readers.elements import _source_of_elements
from hpcinv.formats.unv import read_unv
from hpcinv.mesh import read_source
from hpcinv.mesh.mesh_files import save
from hpcinv.mesh.source import MeshSource

NODES = ["0,0,0", "1,0,0", "0,1,0", "0,0,1", "1,1,1"]
INP = "*NODE\n" + "".join(f"{i},{x}\n" for i, x in enumerate(NODES, 1))
MEDIT = """MeshVersionFormatted 2
Dimension 3
Vertices 5
0 0 0 0
1 0 0 0
0 1 0 0
0 0 1 0
1 1 1 0
Tetrahedra 1
1 2 3 4 3
Tetrahedra
1
2 3 4 5 4
Triangles 1
1 2 3 2
Triangles 1
1 2 4 7
End
"""


def source_of(path: Path, text: str) -> MeshSource:
    path.write_text(text)
    head, arrays = read_inp(path)
    return _source_of_elements(path, arrays, head["ignored"])


def test_nastran_without_its_end_is_refused(tmp_path: Path) -> None:
    grid = "".join(f"GRID,{i},,{x}\n" for i, x in enumerate(NODES, 1))
    text = f"SOL 101\nBEGIN BULK\n{grid}CTETRA,1,1,1,2,3,4\n"
    path = tmp_path / "a.bdf"
    path.write_text(text)
    with pytest.raises(Fault, match="line 2: BEGIN BULK has no ENDDATA"):
        read_bdf(path)
    path.write_text(f"{text}ENDDATA\n")
    assert len(read_bdf(path)[1]["cells"]) == 1
    path.write_text(f"{grid}CTETRA,1,1,1,2,3,4\n")  # bulk data that another file includes
    assert len(read_bdf(path)[1]["cells"]) == 1


def test_medit_has_all_sections_of_a_kind_and_an_end(tmp_path: Path) -> None:
    path = tmp_path / "a.mesh"
    path.write_text(MEDIT)
    arrays = read_medit(path)[1]
    assert arrays["cells"].tolist() == [[0, 1, 2, 3], [1, 2, 3, 4]]
    assert arrays["cells:volume-4"].tolist() == [1]
    assert arrays["skin:surface-7"].tolist() == [[0, 1, 3]]
    path.write_text(MEDIT.partition("Triangles")[0])
    with pytest.raises(Fault, match="has no End"):
        read_medit(path)


def test_universal_files_end_with_their_last_dataset(tmp_path: Path) -> None:
    path = tmp_path / "a.unv"
    path.write_text("    -1\n  2411\n    -1\n    -1\n")
    with pytest.raises(Fault, match="its last dataset has no end"):
        read_unv(path)


@pytest.mark.parametrize(("system", "message"), [(0, ""), (1, "cylindrical"), (2, "spherical")])
def test_med_in_other_coordinates_is_refused(system: int, message: str, tmp_path: Path) -> None:
    source = source_of(tmp_path / "a.inp", f"{INP}*ELEMENT, TYPE=C3D4\n1,1,2,3,4\n2,2,3,4,5\n")
    path = tmp_path / "a.med"
    save(path, source, source.points)
    with h5py.File(path, "r+") as file:
        next(iter(file["ENS_MAA"].values())).attrs["REP"] = np.int32(system)
    if message:
        with pytest.raises(Fault, match=f"its coordinates are {message}"):
            read_med(path)
    else:
        assert len(read_med(path)[1]["cells"]) == 2


def test_nodes_of_no_element_are_counted(tmp_path: Path) -> None:
    source = source_of(tmp_path / "a.inp", f"{INP}*ELEMENT, TYPE=C3D4\n1,1,2,3,4\n")
    assert any("1 of its nodes belong to no element" in note for note in source.notes)
    whole = source_of(tmp_path / "a.inp", f"{INP}*ELEMENT, TYPE=C3D4\n1,1,2,3,4\n2,2,3,4,5\n")
    assert not whole.notes
    (tmp_path / "a.inp").write_text(f"{INP}*ELEMENT, TYPE=C3D4\n1,1,2,3,4\n*STEP\n*STATIC\n")
    with pytest.raises(MeshError, match="STEP has no"):
        read_source(spec(tmp_path / "a.inp"), tmp_path / "a.inp")


def test_a_node_set_and_a_surface_of_one_name_are_two_regions(tmp_path: Path) -> None:
    mesh = f"{INP}*ELEMENT, TYPE=C3D4\n1,1,2,3,4\n2,2,3,4,5\n*SURFACE, NAME=A\n2, S4\n"
    groups = {
        nodes: {group.name: source.facets[group.members] for group in source.groups if group.dim == 2}
        for nodes in ("1,2,3", "2,4,5", "3,4,5")
        for source in [source_of(tmp_path / "a.inp", f"{mesh}*NSET, NSET=A\n{nodes}\n")]
    }
    assert groups["1,2,3"].keys() == {"A", "A-nodes"}
    assert set(groups["1,2,3"]["A-nodes"].ravel().tolist()) == {0, 1, 2}
    alike = [groups[nodes].keys() == {"A"} for nodes in ("2,4,5", "3,4,5")]
    assert sorted(alike) == [False, True]  # one of them is the face, and needs no second name
