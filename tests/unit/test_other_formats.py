"""Meshes of other programs: the way there and back, files of other writers, and damaged files."""

from __future__ import annotations

import random
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import ROOT
from helpers.other_format_cases import TEXTS, UNV, read, volume

from hpcinv.errors import MeshError
from hpcinv.mesh.checks import check
from hpcinv.mesh.io.gmsh_model import session
from hpcinv.mesh.mesh_files import UnstorableMesh, save
from hpcinv.mesh.source import Group, MeshSource

KINDS = [(False, 1), (False, 2), (True, 1), (True, 2)]
"""hexahedra or tetrahedra, and the degree of their geometry"""


@cache
def box(hexahedra: bool, degree: int) -> MeshSource:
    """A box with coordinates of all digits and a third region that overlaps the others."""
    path = ROOT / "meshes" / "box.py"
    parameters = {"nx": 2, "ny": 1, "nz": 2, "hexahedra": hexahedra}
    source = read(path, parameters=parameters, geometry_degree=degree)
    points = source.points * np.array([1 / 3, 0.7, 1.1]) - 1 / 7
    members = np.arange(len(source.cells) // 2)
    more = (Group("half", 3, 7, members), Group("lower_half", 3, 8, members[: len(members) // 2 + 1]))
    kept = tuple(group for group in source.groups if group.dim == 2)
    return MeshSource(
        **(vars(source) | {"points": points, "groups": (*kept, *more), "node_tags": source.node_tags + 100})
    )


def contents(source: MeshSource, digits: int = 17) -> Mapping[str, Any]:
    """Cells and groups by the coordinates of vertices, whatever the order."""

    def sets(rows: Any) -> frozenset[tuple[str, ...]]:
        size = {4: 4, 10: 4, 8: 8, 27: 8}[source.cells.shape[1]]
        size = size if rows.shape[1] == source.cells.shape[1] else {4: 3, 8: 4}[size]
        shown = [
            [f"{x:.{digits}g},{y:.{digits}g},{z:.{digits}g}" for x, y, z in source.points[row[:size]]] for row in rows
        ]
        return frozenset(tuple(sorted(entry)) for entry in shown)

    groups = {
        (group.dim, group.name): sets((source.cells if group.dim == 3 else source.facets)[group.members])
        for group in source.groups
    }
    tags = {
        f"{x:.{digits}g},{y:.{digits}g},{z:.{digits}g}": tag
        for (x, y, z), tag in zip(source.points, source.node_tags, strict=True)
    }
    return {"cells": sets(source.cells), "groups": groups, "tags": tags}


BLOCKS = {"all elements", "unnamed", "property-2"}
"""of cells without a group, where each cell is in a block"""
CIRCLES = [".inp", ".feb", ".cdb", ".unv", ".med", ".e", ".vtk", ".vtu", ".bdf", ".msh"]


@pytest.mark.usefixtures("same_process")
@pytest.mark.parametrize(("hexahedra", "degree"), KINDS)
@pytest.mark.parametrize("suffix", CIRCLES)
def test_nodes_numbers_and_sets_come_back(suffix: str, hexahedra: bool, degree: int, tmp_path: Path) -> None:
    source, path = box(hexahedra, degree), tmp_path / f"box{suffix}"
    digits = 9 if suffix == ".bdf" else 17  # fields of 16 characters
    save(path, source, source.points)
    first = read(path)
    expected, result = contents(source, digits), contents(first, digits)
    assert result["cells"] == expected["cells"]
    assert result["groups"].items() >= expected["groups"].items()
    assert {name for _, name in result["groups"].keys() - expected["groups"].keys()} <= BLOCKS
    if not hexahedra or degree == 1:  # of bricks, face nodes are completed
        assert result["tags"] == expected["tags"]
    save(path, first, first.points)
    second = read(path)
    for name in ("points", "node_tags", "cells", "cell_tags", "facets"):
        assert np.array_equal(getattr(first, name), getattr(second, name)), name
    assert contents(second) == contents(first)


def test_quadratic_triangles_of_unv_have_corners_and_middles_by_turns(tmp_path: Path) -> None:
    """By our own reader the middles would not be missed: it takes the corners of a facet."""
    source, path = box(False, 2), tmp_path / "box.unv"
    save(path, source, source.points)
    nodes, elements = (path.read_text().split("    -1\n")[k].splitlines() for k in (1, 3))
    assert (nodes[0].strip(), elements[0].strip()) == ("2411", "2412")
    heads = [line.split() for line in nodes[1::2]]
    points = {
        int(head[0]): np.array(line.replace("D", "E").split(), float)
        for head, line in zip(heads, nodes[2::2], strict=True)
    }
    facets = [line for head, line in zip(elements[1::2], elements[2::2], strict=False) if head.split()[1:2] == ["92"]]
    assert facets
    for line in facets:
        places = np.array([points[int(node)] for node in line.split()])
        assert np.allclose(places[1::2], (places[::2] + np.roll(places[::2], -1, axis=0)) / 2)


@cache
def written_by_gmsh(folder: Path, suffix: str, hexahedra: bool, degree: int) -> Path:
    """A brick of 2 x 1 x 1 by gmsh, with its ends and its volume as groups."""
    path = folder / f"{degree}{'h' if hexahedra else 't'}{suffix}"
    with session("brick") as gmsh:
        gmsh.model.occ.addBox(0, 0, 0, 2, 1, 1)
        gmsh.model.occ.synchronize()
        for dim, tag in gmsh.model.getEntities():
            if hexahedra and dim == 1:
                gmsh.model.mesh.setTransfiniteCurve(tag, 3)
            elif hexahedra and dim == 2:
                gmsh.model.mesh.setTransfiniteSurface(tag)
                gmsh.model.mesh.setRecombine(2, tag)
            elif hexahedra and dim == 3:
                gmsh.model.mesh.setTransfiniteVolume(tag)
        gmsh.model.addPhysicalGroup(3, [1], 1, "whole")
        gmsh.model.addPhysicalGroup(2, [1], 2, "left")
        gmsh.model.addPhysicalGroup(2, [2], 3, "right")
        gmsh.option.setNumber("Mesh.SecondOrderIncomplete", int(suffix != ".vtk"))
        gmsh.option.setNumber("Mesh.SaveGroupsOfNodes", 0)
        gmsh.option.setNumber("Mesh.SaveElementTagType", 2)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.7)
        gmsh.model.mesh.generate(3)
        gmsh.model.mesh.setOrder(degree)
        gmsh.write(str(path))
    return path


NAMES_OF_GMSH = {
    ".med": ("whole", "left", "right"),
    ".unv": ("whole", "left", "right"),
    ".bdf": ("property-1", "property-2", "property-3"),
    ".mesh": ("volume-1", "surface-2", "surface-3"),
}


@pytest.mark.usefixtures("same_process")
@pytest.mark.parametrize(("hexahedra", "degree"), KINDS)
@pytest.mark.parametrize("suffix", [".med", ".unv", ".bdf", ".mesh"])
def test_files_of_gmsh_are_read(suffix: str, hexahedra: bool, degree: int, tmp_path: Path) -> None:
    """Their volume, and the places of their groups; middle nodes are in the middle of straight edges."""
    path = written_by_gmsh(tmp_path, suffix, hexahedra, degree)
    if suffix == ".mesh" and degree == 2 and hexahedra:  # gmsh writes 20 nodes into a section of 8
        return
    if suffix == ".mesh" and degree == 2:
        with pytest.raises(MeshError, match="has curved cells"):
            read(path)
        return
    source = read(path)
    check(source)
    assert volume(source) == pytest.approx(2, rel=1e-9)
    whole, left, right = NAMES_OF_GMSH[suffix]
    groups = {group.name: group for group in source.groups}
    assert len(groups[whole].members) == len(source.cells)
    for name, x in ((left, 0), (right, 2)):
        points = source.points[source.facets[groups[name].members]]
        assert np.abs(points[..., 0] - x).max() < 1e-9
        assert points[..., 1].max() - points[..., 1].min() == pytest.approx(1)


@pytest.mark.usefixtures("same_process")
def test_bricks_of_27_nodes_in_med_are_the_same_as_in_msh(tmp_path: Path) -> None:
    paths = tmp_path / "a.med", tmp_path / "a.msh"
    with session("bricks") as gmsh:
        box = gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
        gmsh.model.occ.synchronize()
        gmsh.model.mesh.setTransfiniteAutomatic()
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
        gmsh.model.addPhysicalGroup(3, [box], name="whole")
        gmsh.model.mesh.generate(3)
        gmsh.model.mesh.setOrder(2)
        tags, flat, _ = gmsh.model.mesh.getNodes()
        for tag, point in zip(tags, flat.reshape(-1, 3), strict=True):
            gmsh.model.mesh.setNode(tag, point + 0.02 * np.sin(9 * point[[1, 2, 0]] + [0, 1, 2]), [])
        for path in paths:
            gmsh.write(str(path))
    med, msh = map(read, paths)
    assert (med.cells.shape[1], med.nodes_per_cell) == (27, 27)
    assert volume(med) == pytest.approx(volume(msh), rel=1e-12)
    middles = [np.sort(source.points[source.cells].mean(axis=1), axis=0) for source in (med, msh)]
    np.testing.assert_allclose(*middles, atol=1e-12)


@pytest.mark.parametrize(("hexahedra", "degree"), KINDS)
@pytest.mark.parametrize("suffix", [".med", ".unv", ".bdf"])
def test_gmsh_reads_what_is_written(suffix: str, hexahedra: bool, degree: int, tmp_path: Path) -> None:
    if suffix == ".bdf" and hexahedra and degree == 2:  # gmsh reads 8 nodes of 20
        return
    source, path = box(hexahedra, degree), tmp_path / f"box{suffix}"
    save(path, source, source.points)
    with session("again") as gmsh:
        gmsh.merge(str(path))
        _, (tags,), _ = gmsh.model.mesh.getElements(3)
        volumes = gmsh.model.mesh.getElementQualities(tags, "volume")
        names = {gmsh.model.getPhysicalName(*group) for group in gmsh.model.getPhysicalGroups()}
    assert sum(volumes) == pytest.approx(1 / 3 * 0.7 * 1.1, rel=1e-9)
    if suffix == ".med":
        assert names == {group.name for group in source.groups}


@pytest.mark.parametrize(("hexahedra", "degree"), KINDS)
def test_vtk_reads_the_sets_of_exodus_files(hexahedra: bool, degree: int, tmp_path: Path) -> None:
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOExodus import vtkExodusIIReader

    source, path = box(hexahedra, degree), tmp_path / "box.e"
    save(path, source, source.points)
    reader = vtkExodusIIReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    surfaces = {group.name: group for group in source.groups if group.dim == 2}
    kind = reader.SIDE_SET
    assert {reader.GetObjectName(kind, at) for at in range(reader.GetNumberOfObjects(kind))} == surfaces.keys()
    for at in range(reader.GetNumberOfObjects(kind)):
        reader.SetObjectStatus(kind, at, int(reader.GetObjectName(kind, at) == "z1"))
    reader.Update()
    blocks, sets = reader.GetOutput().GetBlock(0), reader.GetOutput().GetBlock(4)
    assert sum(blocks.GetBlock(at).GetNumberOfCells() for at in range(2)) == len(source.cells)
    grid = next(sets.GetBlock(at) for at in range(sets.GetNumberOfBlocks()) if sets.GetBlock(at) is not None)
    assert grid.GetNumberOfCells() == len(surfaces["z1"].members)
    top = vtk_to_numpy(grid.GetPoints().GetData())
    assert np.abs(top[:, 2] - source.points[:, 2].max()).max() < 1e-7  # VTK reads into single precision


@pytest.mark.usefixtures("same_process")
def test_bricks_of_27_nodes_keep_all_nodes(tmp_path: Path) -> None:
    """C3D27 with a face node that 20 nodes would have elsewhere; input files have 14 digits."""
    whole = box(True, 2)
    for suffix in (".inp", ".e"):
        first, path = MeshSource(**(vars(whole) | {"nodes_per_cell": 27})), tmp_path / f"box{suffix}"
        points = first.points + 0.01 * np.sin(7 * first.points[:, [1, 2, 0]])
        save(path, first, points)
        source = read(path)
        assert source.notes == ()
        assert len(source.points) == len(points)
        save(path, source, source.points)
        again = read(path)
        assert np.array_equal(again.points, source.points)
        assert np.array_equal(again.cells, source.cells)
        assert {tuple(row) for row in source.points.round(12).tolist()} == {
            tuple(row) for row in points.round(12).tolist()
        }


@pytest.mark.usefixtures("same_process")
@pytest.mark.parametrize("name", ["PART.INP", "Part.Cdb", "part.NAS", "part.EX2"])
def test_suffixes_may_be_capital(name: str, tmp_path: Path) -> None:
    source, suffix = box(False, 1), Path(name).suffix.lower()
    save(tmp_path / f"a{suffix}", source, source.points)
    (tmp_path / f"a{suffix}").rename(tmp_path / name)
    assert len(read(tmp_path / name).cells) == len(source.cells)


FAULTS = [
    (".bdf", "GRID,2,,1.0", "GRID,2,,x", "line 9: 'x' is not a number"),
    (".bdf", "GRID,2,,1.0", "GRID,2,,nan", "node 2 has a coordinate that is not finite"),
    (".bdf", "GRID,2,,1.0", "GRID,2,8,1.0", "line 9: coordinate system 8 is not defined"),
    (".bdf", "GRID,2,,1.0", "GRID,1,,1.0", "node 1 is defined twice"),
    (".bdf", "GRID,2,,1.0", "GRID,12,,1.0", "element 1 has node 2, which is not defined"),
    (".bdf", "CTETRA  ", "CPENTA  ", "elements CPENTA are not supported"),
    (".bdf", "CTETRA  ", "CHEXA   ", "element 1 has 4 nodes"),
    (".bdf", "CTETRA  ", "CROD    ", "has no solid elements"),
    (
        ".bdf",
        "SET3          11    ELEM       1",
        "SET3          11    ELEM      77",
        "set 'set-11' has element 77, which is not",
    ),
    (".bdf", "MAT1    ", "INCLUDE 'b.bdf' $", "includes 'b.bdf', which does not exist"),
    (".bdf", "MAT1    ", "INCLUDE 'a.bdf' $", "'a.bdf' includes itself"),
    (".bdf", "1    THRU       3", "9    THRU       3", "the range to 3 is not valid"),
    (".cdb", "(19i9)", "(nineteen)", "'(nineteen)' is not a format of a block"),
    (".cdb", "EBLOCK,19,SOLID", "EBLOCK,10,", "has no solid elements"),
    (".cdb", "        4        4        4        4\n", "        4        4\n", "element 5 has 6 nodes, not 8"),
    (".cdb", "1.0000000000000E+000", "1.0000000000000E+0x0", "is not a number"),
    (".cdb", "1.0000000000000E+000", "                 NAN", "node 2 has a coordinate that is not finite"),
    (".cdb", "        3        3", "       33       33", "element 5 has node 33, which is not defined"),
    (".cdb", "         1        -3", "         1       -99", "set 'FOOT' has node 5, which is not defined"),
    (".cdb", "       -1\nCMBLOCK,FOOT    ,NODE,       2\n(8i10)", "", "an element has 0 numbers, not 11"),
    (".cdb", "(8i10)\n         5\nMP,EX,1,2.0\n", "(8i10)", "ends within a block"),
    (".cdb", "BODY,ELEM,       1", "BODY,ELEM,       x", "'x' is not a whole number"),
    (".unv", "         1       111", "         1       112", "elements of the type 112 are not supported"),
    (
        ".unv",
        "         1         2         3         4\n",
        "         1         2         3\n",
        "a dataset ends too early",
    ),
    (".unv", "  0.0D+00  0.0D+00  1.0D+00", "  0.0D+00  0.0D+00", "line 10: a node has 2 coordinates, not 3"),
    (".unv", "         7         1 ", "         7        11 ", "set 'foot' has node 11, which is not defined"),
    (
        ".unv",
        "         7         1         0         0",
        5 * "         7",
        "members of group 1 are not four numbers each",
    ),
    (".unv", UNV[-60:], "", "its last dataset has no end"),
    (".unv", UNV, "", "has no datasets"),
    (".mesh", "Dimension 3", "Dimension 2", "is not a mesh in three dimensions"),
    (".mesh", "Vertices\n4", "Vertices\n400", "section vertices has fewer than 400 entries"),
    (".mesh", "Vertices\n4", "Vertices\nfour", "section vertices does not say how many entries"),
    (".mesh", "1 2 3 4 3", "1 2 3 9 3", "element 1 has node 9, which is not defined"),
    (".mesh", "1 2 3 4 3", "1 2 3 4.5 3", "section tetrahedra has entries that are not whole numbers"),
    (".mesh", "0 0 1 0", "0 0 inf 0", "node 4 has a coordinate that is not finite"),
    (".mesh", "Tetrahedra", "TetrahedraP2", "has curved cells"),
    (".mesh", "Tetrahedra", "Prisms", "has prisms"),
]


@pytest.mark.usefixtures("same_process")
@pytest.mark.parametrize(("suffix", "old", "new", "message"), FAULTS, ids=[fault[3][:30] for fault in FAULTS])
def test_faults_are_named(suffix: str, old: str, new: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{suffix}"
    assert old in TEXTS[suffix]
    path.write_text(TEXTS[suffix].replace(old, new, 1))
    with pytest.raises(MeshError) as refused:
        read(path)
    assert str(path) in refused.value.message
    assert message in refused.value.message


@pytest.mark.usefixtures("same_process")
@pytest.mark.parametrize("suffix", [".bdf", ".cdb", ".unv", ".mesh", ".med", ".e"])
def test_damaged_files_get_a_message_or_are_read(suffix: str, tmp_path: Path) -> None:
    whole = TEXTS.get(suffix, "").encode()
    if not whole:
        save(tmp_path / f"a{suffix}", box(False, 1), box(False, 1).points)
        whole = (tmp_path / f"a{suffix}").read_bytes()
    source, path, messages = random.Random(5), tmp_path / f"damaged{suffix}", list[str]()
    for _ in range(40):
        content = bytearray(whole)
        for _ in range(source.randint(1, 8)):
            if len(content) < 2:
                break
            place = source.randrange(len(content))
            match source.randrange(4):
                case 0:
                    content[place] = source.randrange(256)
                case 1:
                    del content[place : place + source.randrange(100)]
                case 2:
                    del content[max(place, 1) :]
                case _:
                    content[place : place + 4] = source.choice([b"nan ", b"-1  ", b"9999", b"\xff\xff\xff\x7f"])
        path.write_bytes(content)
        try:
            read(path)
        except MeshError as error:
            messages.append(error.message)
    assert len(set(messages)) > 1
    assert not [text for text in messages if "Traceback" in text or "Error:" in text]


@pytest.mark.everyday(".med", ".e")
@pytest.mark.parametrize("suffix", [".bdf", ".cdb", ".unv", ".mesh", ".med", ".e", ".vtk"])
def test_a_file_that_is_cut_is_refused_by_its_own_process(suffix: str, tmp_path: Path) -> None:
    path, source = tmp_path / f"a{suffix}", box(False, 1)
    if suffix == ".mesh":
        source = MeshSource(**(vars(source) | {"groups": source.groups[:0], "facets": source.facets[:0]}))
    save(path, source, source.points)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 3])
    with pytest.raises(MeshError) as refused:
        read(path)
    assert str(path) in refused.value.message
    assert "Error:" not in refused.value.message


def test_data_that_a_format_cannot_hold_are_reported(tmp_path: Path) -> None:
    source = box(False, 2)
    for suffix, message in ((".mesh", "curved cells are not possible"), (".cdb", "the name 'a b' is not possible")):
        renamed = MeshSource(**(vars(source) | {"groups": (Group("a b", 3, 1, np.arange(2)),)}))
        with pytest.raises(UnstorableMesh, match=message):
            save(tmp_path / f"a{suffix}", renamed, source.points)
    assert not list(tmp_path.iterdir())
