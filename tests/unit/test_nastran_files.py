"""Bulk data of Nastran and archives of Ansys: fields, sets, frames and included files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.other_format_cases import BDF, TEXTS, cdb, read, volume

from hpcinv.base.mesh_formats import FORMATS
from hpcinv.errors import MeshError


@pytest.mark.usefixtures("same_process")
def test_fields_and_sets_of_nastran(tmp_path: Path) -> None:
    path = tmp_path / "a.bdf"
    path.write_text(BDF)
    source = read(path)
    assert source.points.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    found = {(group.dim, group.name) for group in source.groups}
    assert found == {(3, "rubber"), (2, "property-30"), (2, "foot"), (2, "set-5"), (2, "set-6"), (3, "set-11")}
    assert source.notes == ("only its mesh is read, not MAT1",)


SYSTEMS = """BEGIN BULK
GRDSET,,1
CORD2R,1,,1.,2.,3.,2.,2.,3.
,1.,3.,3.
CORD2C         2       1      0.      0.      1.      0.      0.      2.
              1.      0.      1.
CORD2S,4,2,0.,0.,0.,0.,0.,1.
,1.,90.,0.
GRID,1,0,1.,2.,3.
GRID,2,2,2.,90.,3.
GRID,3,4,3.,90.,0.
GRID,4,,-1.,0.5,0.25
CTETRA,1,7,1,2,3,4
ENDDATA
"""


@pytest.mark.usefixtures("same_process")
def test_coordinate_systems_of_nastran(tmp_path: Path) -> None:
    path = tmp_path / "a.bdf"
    path.write_text(SYSTEMS)
    # the system 1 has the axes y, z, x and the origin (1, 2, 3); 2 begins further by 1 along x; 4 has their second as x
    expected = np.array([[1.0, 2, 3], [5, 2, 5], [2, 2, 6], [1.25, 1, 3.5]])
    np.testing.assert_allclose(read(path).points, expected, atol=1e-15)
    for old, new, message in (
        ("CORD2S,4,2", "CORD2S,4,3", "line 7: coordinate system 3 is not defined"),
        ("CORD2R,1,,1", "CORD2R,1,2,1", "coordinate system [12] refers to itself"),
        ("CORD2R,1,", "CORD1R,1,", "coordinate system 1 is a CORD1R, which is not read"),
        (",1.,3.,3.", ",3.,2.,3.", "line 3: the points of coordinate system 1 are on one line"),
    ):
        path.write_text(SYSTEMS.replace(old, new))
        with pytest.raises(MeshError, match=message):
            read(path)


def test_elements_without_a_property_in_nastran(tmp_path: Path) -> None:
    """As meshio writes them: fields without a property, which is then of the element's number, and other names."""
    grid = "".join(f"GRID,{number},,{x},{y},{z}\n" for number, (x, y, z) in enumerate(TEN_NODES, 1))
    for card, nodes in (
        ("CTETRA  7               1       2       3       4\n", 4),
        (
            "CTETRA_ 7               1       2       3       4       5       6       +1\n"
            "+1      7       8       9       10\n",
            10,
        ),
    ):
        path = tmp_path / "a.bdf"
        path.write_text(f"BEGIN BULK\n{grid}{card}ENDDATA\n")
        source = read(path)
        assert source.cells.shape == (1, nodes)
        assert [(group.dim, group.name) for group in source.groups] == [(3, "property-7")]


TEN_NODES = (
    *((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)),
    *((0.5, 0, 0), (0.5, 0.5, 0), (0, 0.5, 0), (0, 0, 0.5), (0.5, 0, 0.5), (0, 0.5, 0.5)),
)


@pytest.mark.usefixtures("same_process")
def test_degenerate_bricks_and_ranges_of_ansys(tmp_path: Path) -> None:
    path = tmp_path / "a.cdb"
    path.write_text(cdb())
    source = read(path)
    assert (source.kind, source.cell_tags.tolist()) == ("tetrahedron", [5])
    assert volume(source) == pytest.approx(1 / 6)
    assert {(g.dim, g.name, len(g.members)) for g in source.groups} == {(2, "FOOT", 1), (3, "BODY", 1)}
    assert source.notes == ("only its mesh is read, not MP",)
    path.write_text(cdb((1, 2, 3, 3, 4, 4, 4, 2)))
    with pytest.raises(MeshError, match="element 5 is a prism or a pyramid"):
        read(path)


@pytest.mark.usefixtures("same_process")
def test_files_that_nastran_includes_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.bdf"
    path.write_text(BDF)
    whole = read(path)
    head, rest = BDF.split("GRID           4")
    path.write_text(f"{head}include 'sub/\nrest.blk'\nENDDATA".replace("SET 6", "SET 8 = ALL\nSET 6"))
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "rest.blk").write_text(f"GRID           4{rest}")
    assert read(path).points == pytest.approx(whole.points)
    assert [group.name for group in read(path).groups] == [group.name for group in whole.groups]
    assert FORMATS[".bdf"].data_files(path) == ["sub/rest.blk"]


@pytest.mark.usefixtures("same_process")
@pytest.mark.parametrize("suffix", TEXTS)
@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig"])
def test_text_is_read_in_other_encodings(suffix: str, encoding: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_text(TEXTS[suffix])
    points = read(path).points
    path.write_text(TEXTS[suffix], encoding=encoding)
    assert (read(path).points == points).all()
