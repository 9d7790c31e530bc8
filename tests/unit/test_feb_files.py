"""Model files of FEBio as meshes: what is read, the way there and back, and faults."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest
from helpers.command_line import ROOT
from helpers.mesh_cases import spec

from hpcinv.base.mesh_formats import FORMATS
from hpcinv.errors import MeshError
from hpcinv.mesh import read_source
from hpcinv.mesh.mesh_files import save
from hpcinv.mesh.source import MeshSource

pytestmark = pytest.mark.usefixtures("warm_reader")

FORMAT_4 = """<?xml version="1.0" encoding="ISO-8859-1"?>
<febio_spec version="4.0">
<Module type="solid"/>
<Material><material id="1" name="m" type="neo-Hookean"><E>1</E><v>0.3</v></material></Material>
<Mesh>
<Nodes name="Object">
<node id="1">0,0,0</node><node id="2">1,0,0</node><node id="3">1,1,0</node><node id="4">0,1,0</node>
<node id="11">0,0,1</node><node id="12">1,0,1</node><node id="13">1,1,1</node><node id="14">0,1,1</node>
<node id="21">0,0,2</node><node id="22">1,0,2</node><node id="23">1,1,2</node><node id="24">0,1,2</node>
</Nodes>
<Elements type="hex8" name="lower"><elem id="1">1,2,3,4,11,12,13,14</elem></Elements>
<Elements type="hex8"><elem id="5">11,12,13,14,21,22,23,24</elem></Elements>
<Elements type="quad4" name="skin"><elem id="9">1,2,3,4</elem></Elements>
<Surface name="top"><quad4 id="1">21,22,23,24</quad4></Surface>
<NodeSet name="foot">1,2,3,4</NodeSet>
<ElementSet name="both">1,5</ElementSet>
</Mesh>
</febio_spec>
"""
FORMAT_25 = FORMAT_4.replace("Mesh>", "Geometry>").replace(
    '<NodeSet name="foot">1,2,3,4</NodeSet>',
    '<NodeSet name="foot"><node id="1"/><node id="2"/><node id="3"/><node id="4"/></NodeSet>',
)


def read(path: Path) -> MeshSource:
    return read_source(spec(path), path)


def groups(source: MeshSource) -> dict[str, tuple[int, int, float]]:
    """Dimension, number of members and sum of their coordinates, of each group."""
    middles = {3: source.points[source.cells].mean(axis=1), 2: source.points[source.facets].mean(axis=1)}
    return {g.name: (g.dim, len(g.members), float(middles[g.dim][g.members].sum().round(9))) for g in source.groups}


@pytest.mark.parametrize("text", [FORMAT_4, FORMAT_25], ids=["4.0", "2.5"])
def test_parts_sets_and_surfaces_are_regions(text: str, tmp_path: Path) -> None:
    path = tmp_path / "a.feb"
    path.write_text(text)
    source = read(path)
    solids = {g.name: len(g.members) for g in source.groups if g.dim == 3}
    surfaces = {g.name: len(g.members) for g in source.groups if g.dim == 2}
    assert solids == {"lower": 1, "part-2": 1, "both": 2, "Object": 2}  # an object has all nodes
    assert surfaces == {"top": 1, "foot": 1, "Object": 10}
    assert source.node_tags.tolist() == [1, 2, 3, 4, 11, 12, 13, 14, 21, 22, 23, 24]
    assert source.cell_tags.tolist() == [1, 5]
    assert source.notes == ("only its mesh is read, not Material",)
    shown = FORMATS[".feb"].groups(path)
    assert shown is not None
    assert {"lower", "both", "top", "foot", "Object"} <= shown.names


def test_names_of_regions_are_read_by_the_parser_of_the_content(tmp_path: Path) -> None:
    path = tmp_path / "a.feb"
    path.write_text(FORMAT_4.replace("<Mesh>", '<Mesh><!-- <NodeSet name="gone"> -->'))
    groups = FORMATS[".feb"].groups(path)
    assert groups is not None
    assert "foot" in groups.names
    assert "gone" not in groups.names
    path.write_text(FORMAT_4.removesuffix("</febio_spec>\n"))
    assert FORMATS[".feb"].groups(path) is None  # the reader says that it is cut


def test_surfaces_on_shells_apart_from_the_body_are_left_out(tmp_path: Path) -> None:
    floor = '<Elements type="quad4" name="floor"><elem id="10">31,32,33,34</elem></Elements><Surface name="top">'
    corners = "".join(
        f'<node id="{31 + i}">{x},{y},-1</node>' for i, (x, y) in enumerate([(0, 0), (1, 0), (1, 1), (0, 1)])
    )
    text = FORMAT_4.replace("</Nodes>", f"{corners}</Nodes>").replace('<Surface name="top">', floor)
    text = text.replace("</Surface>", '</Surface><Surface name="ground"><quad4 id="1">34,33,32,31</quad4></Surface>')
    text = text.replace('"hex8" name="lower"', '"HEX8G8" name="lower"').replace(
        "1,2,3,4</NodeSet>", "1,2\n3,4,\n</NodeSet>"
    )
    path = tmp_path / "a.feb"
    path.write_text(text.replace('<quad4 id="1">21,', '<quad4 id="7">1,2,3,4</quad4><quad4 id="1">21,'))
    assert groups(read(path))["top"] == (2, 2, 4.0)  # the shell on the body is one of its facets
    assert "ground" not in groups(read(path))
    path.write_text(text.replace('<quad4 id="1">21,22,23,24</quad4>', '<tri3 id="1">21,22,23</tri3>'))
    with pytest.raises(MeshError, match="surface 'top' has facets that no solid element has"):
        read(path)


@pytest.mark.parametrize("hexahedra", [False, True])
@pytest.mark.parametrize("degree", [1, 2])
def test_there_and_back_nodes_and_sets_are_equal(hexahedra: bool, degree: int, tmp_path: Path) -> None:
    box = ROOT / "meshes" / "box.py"
    parameters = {"nx": 2, "ny": 1, "nz": 2, "hexahedra": hexahedra}
    source = read_source(spec(box, parameters=parameters, geometry_degree=degree), box)
    path = tmp_path / "box.feb"
    save(path, source, source.points)
    first = read(path)
    assert groups(first) == groups(source)
    save(path, first, first.points)
    second = read(path)
    for name in ("points", "node_tags", "cells", "cell_tags", "facets"):
        assert np.array_equal(getattr(first, name), getattr(second, name)), name
    np.testing.assert_allclose(first.points[first.cells], source.points[source.cells], atol=1e-15)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<febio_spec", "<febio", "is not XML: mismatched tag"),
        ("febio_spec", "febio", "is not a model of FEBio with a mesh"),
        ("Mesh>", "Mash>", "is not a model of FEBio with a mesh"),
        ('type="hex8"', 'type="quad4"', "has no solid elements"),
        ('type="hex8"', 'type="penta6"', "elements 'penta6' are not supported"),
        ('<elem id="1">1,', '<elem id="1">', "element 1 has 7 nodes, not 8"),
        ('<elem id="1">1,', '<elem id="1">99,', "an element has node 99, which is not defined"),
        ('<node id="1">0,', '<node id="1">nan,', "node 1 has no three finite coordinates"),
        ('<node id="1">', '<node id="one">', "<node> has id 'one', not a number"),
        ('<NodeSet name="foot">1,', '<NodeSet name="foot">77,', "a node set has node 77, which is not defined"),
        ('<quad4 id="1">21,22,23,24', '<quad4 id="1">1,2,23,24', "1 of 1 facets of surface 'top' belong to no solid"),
        ("<febio_spec", "<!DOCTYPE a><febio_spec", "has definitions of entities"),
    ],
)
def test_faults_are_named(old: str, new: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "a.feb"
    path.write_text(FORMAT_4.replace(old, new))
    with pytest.raises(MeshError) as refused:
        read(path)
    assert str(path) in refused.value.message
    assert message in refused.value.message


def test_damaged_files_get_a_message_or_are_read(tmp_path: Path) -> None:
    source, path, messages = random.Random(3), tmp_path / "damaged.feb", list[str]()
    for _ in range(8):
        content = bytearray(FORMAT_4.encode())
        for _ in range(source.randint(1, 6)):
            place = source.randrange(len(content))
            content[place : place + source.randrange(40)] = bytes([source.randrange(256)])
        path.write_bytes(content)
        try:
            read(path)
        except MeshError as error:
            messages.append(error.message)
    assert messages
    assert not [text for text in messages if "Traceback" in text or "Error:" in text]
