"""Input files of Abaqus and CalculiX: what is read, the way there and back, damaged files, and CalculiX itself."""

from __future__ import annotations

import dataclasses
import random
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import NO_CERTIFICATE, ROOT, write_job
from helpers.mesh_cases import spec

import hpcinv
from hpcinv.base.mesh_formats import FORMATS, mesh_fault
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import MeshError
from hpcinv.job.resolved_job import file_digest
from hpcinv.mesh import read_source, reorder_to_source
from hpcinv.mesh.mesh_files import UnstorableMesh, save
from hpcinv.mesh.source import MeshSource

pytestmark = pytest.mark.usefixtures("warm_reader")

ASSEMBLY = """*Heading
** two bricks of 20 nodes on one another, moved by 10 along x
*Part, name=Mount
*Node
{nodes}
*Element, type=C3D20R, elset=Lower
  1,  1, 2, 3, 4, 5, 6, 7, 8, 21, 22, 23, 24, 25, 26, 27,
  28, 29, 30, 31, 32
*Element, type=C3D20R
  7,  5, 6, 7, 8, 9, 10, 11, 12, 25, 26, 27, 28, 33, 34, 35,
  36, 37, 38, 39, 40
*Nset, nset=Foot, generate
 1, 4, 1
*Nset, nset=Foot
 21, 22, 23, 24
*Elset, elset="All of it"
 Lower, 7
*Surface, name=Top, type=ELEMENT
 7, S2
*Surface, name=Sides
 "All of it", S3
 Lower, s5
*End Part
*Assembly, name=Assembly
*Instance, name=Mount-1, part=Mount
  10., 0., 0.
*End Instance
*Elset, elset=Upper, instance=Mount-1
 7,
*End Assembly
*Material, name=Rubber
*Hyperelastic, mooney-rivlin
 1., 2., 3.
"""


def assembly() -> str:
    corners = [(x, y, z) for z in (0, 1, 2) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
    nodes = dict(enumerate(corners, 1))
    pairs = [(1, 2), (2, 3), (3, 4), (4, 1)]
    edges = [*pairs, *((a + 4, b + 4) for a, b in pairs), *((a, a + 4) for a in range(1, 5))]
    edges += [*((a + 8, b + 8) for a, b in pairs), *((a + 4, a + 8) for a in range(1, 5))]
    nodes |= {21 + i: tuple(np.mean([nodes[a], nodes[b]], axis=0)) for i, (a, b) in enumerate(edges)}
    return ASSEMBLY.format(nodes="\n".join(f"{tag}, {x}, {y}, {z}" for tag, (x, y, z) in nodes.items()))


def read(path: Path) -> MeshSource:
    return read_source(spec(path), path)


def groups(source: MeshSource) -> dict[str, tuple[int, int, float]]:
    """Dimension, number of members and sum of their coordinates, of each group."""
    middles = {3: source.points[source.cells].mean(axis=1), 2: source.points[source.facets].mean(axis=1)}
    return {g.name: (g.dim, len(g.members), float(middles[g.dim][g.members].sum().round(9))) for g in source.groups}


def test_sets_surfaces_and_instances_are_regions(tmp_path: Path) -> None:
    path = tmp_path / "mount.inp"
    path.write_text(assembly())
    source = read(path)
    counts = {g.name: (g.dim, len(g.members)) for g in source.groups}
    assert counts == {
        "Lower": (3, 1),
        "All of it": (3, 2),
        "Upper": (3, 1),
        "Top": (2, 1),
        "Sides": (2, 3),
        "Foot": (2, 1),
    }
    assert (source.kind, source.degree, len(source.points)) == ("hexahedron", 2, 12 + 20 + 11 + 2)  # one face is shared
    assert source.points.min(axis=0).tolist() == [10, 0, 0]
    assert source.points.max(axis=0).tolist() == [11, 1, 2]
    (top,) = (source.facets[g.members] for g in source.groups if g.name == "Top")
    assert (source.points[top][..., 2] == 2).all()
    assert source.notes == (
        "only its mesh is read, not HYPERELASTIC, MATERIAL",
        "its elements of 20 nodes were completed to 27",
    )
    shown = FORMATS[".inp"].groups(path)
    assert shown is None  # names in an assembly are known when it is read


SEVERAL = """*PART, NAME=Brick
*NODE
1, 0, 0, 0
2, 1, 0, 0
3, 0, 1, 0
4, 0, 0, 1
*ELEMENT, TYPE=C3D4, ELSET=whole
1, 1, 2, 3, 4
*END PART
*ASSEMBLY, NAME=A
*INSTANCE, NAME=left, PART=Brick
*END INSTANCE
*INSTANCE, NAME=right, PART=Brick
5, 0, 0
*END INSTANCE
*NSET, NSET=foot, INSTANCE=left
1, 2, 3
*ELSET, ELSET=_top_S3, INTERNAL, INSTANCE=right
1
*SURFACE, TYPE=ELEMENT, NAME=top
_top_S3, S3
*ELSET, ELSET=both, INSTANCE=left
1
*ELSET, ELSET=both, INSTANCE=right
1
*END ASSEMBLY
"""


def with_own_meshes(text: str) -> str:
    """Return the file with the mesh in each instance, as Abaqus/CAE writes independent ones."""
    begin, end = text.index("*NODE"), text.index("*END PART")
    return (text[:begin] + text[end:]).replace("*END INSTANCE", text[begin:end] + "*END INSTANCE")


@pytest.mark.parametrize("has_own_meshes", [False, True])
def test_sets_of_an_assembly_belong_to_their_instances(has_own_meshes: bool, tmp_path: Path) -> None:
    path = tmp_path / "a.inp"
    path.write_text(with_own_meshes(SEVERAL) if has_own_meshes else SEVERAL)
    source = read(path)
    counts = {g.name: (g.dim, len(g.members)) for g in source.groups}
    assert counts == {
        "left.whole": (3, 1),
        "right.whole": (3, 1),
        "both": (3, 2),
        "_top_S3": (3, 1),
        "foot": (2, 1),
        "top": (2, 1),
    }
    for name, (low, high) in {"foot": (0, 1), "top": (5, 6)}.items():
        (facets,) = (source.facets[g.members] for g in source.groups if g.name == name)
        assert (source.points[facets][..., 0].min(), source.points[facets][..., 0].max()) == (low, high)
    path.write_text(SEVERAL.replace("_top_S3, S3", "1, S3"))
    with pytest.raises(MeshError, match="set 'top' of the assembly has numbers without instance="):
        read(path)
    path.write_text(SEVERAL.replace("_top_S3, S3", "nowhere, S3"))
    with pytest.raises(MeshError, match="set 'top' has 'nowhere', which is not defined"):
        read(path)


def test_bricks_of_20_nodes_keep_their_geometry(tmp_path: Path) -> None:
    """A quadratic map of a brick, whose face nodes 20 nodes have elsewhere than 27."""
    path = tmp_path / "mount.inp"
    path.write_text(assembly())
    source = read(path)
    x, y, z = source.points.T - [[10], [0], [0]]
    inner = source.node_tags > 40
    bent = np.column_stack([x + 0.2 * y**2, y + 0.1 * z * x, z + 0.3 * x * y])
    # Serendipity elements of 20 nodes have all polynomials of degree 2.
    lines = assembly().splitlines()
    start = lines.index("*Node") + 1
    for i, point in enumerate(bent[~inner].tolist()):
        lines[start + i] = f"{source.node_tags[~inner][i]}, {', '.join(map(repr, point))}"
    path.write_text("\n".join(lines))
    again = read(path)
    np.testing.assert_allclose(again.points[inner] - [10, 0, 0], bent[inner], atol=1e-14)


@pytest.mark.parametrize("hexahedra", [False, True])
@pytest.mark.parametrize("degree", [1, 2])
def test_there_and_back_nodes_and_sets_are_equal(hexahedra: bool, degree: int, tmp_path: Path) -> None:
    box = ROOT / "meshes" / "box.py"
    parameters = {"nx": 2, "ny": 1, "nz": 2, "hexahedra": hexahedra}
    source = read_source(spec(box, parameters=parameters, geometry_degree=degree), box)
    path = tmp_path / "box.inp"
    save(path, source, source.points)
    first = read(path)
    assert groups(first) == groups(source)
    assert set(FORMATS[".inp"].groups(path).names) == {g.name for g in source.groups}  # type: ignore[union-attr]
    save(path, first, first.points)
    second = read(path)
    for name in ("points", "node_tags", "cells", "cell_tags", "facets"):
        assert np.array_equal(getattr(first, name), getattr(second, name)), name
    np.testing.assert_allclose(first.points[first.cells], source.points[source.cells], atol=1e-15)
    renamed = dataclasses.replace(source, groups=(dataclasses.replace(source.groups[0], name="a,b"),))
    with pytest.raises(UnstorableMesh, match="the name 'a,b' is not possible"):
        save(path, renamed, source.points)


FAULTS = {
    "1, 2, 3": "line 1 is not a keyword",
    "": "has no keywords",
    "*NODE\n1, 0, 0, 0": "has no solid elements",
    "*NODE\n1": "line 2: a node has no coordinates",
    "*NODE\n1, 0, 0, x": "line 2: '0, 0, x' are not numbers",
    "*NODE\n1, 0, 0, nan": "line 2: has a number that is not finite",
    "*ELEMENT, TYPE=C3D4\n1, 1, 2, 3, 4": "element 1 has node 1, which is not defined",
    "*ELEMENT, TYPE=C3D4\n1, 1, 2, 3": "line 2: element 1 has 3 nodes, not 4",
    "*ELEMENT, TYPE=C3D4\n1, 1, 2, 3, 4, 5\n2, 1": "line 2: an element C3D4 has 4 nodes, not 5",
    "Cube\n": "has no keywords",
    "*ELEMENT, TYPE=C3D15\n1, 1": "line 1: elements C3D15 are not supported",
    "*ELEMENT\n1, 1": "line 1: *ELEMENT needs TYPE=",
    "*INCLUDE, INPUT=sub/b.inp": "line 1: includes 'sub/b.inp', which does not exist",
    "*NODE, INPUT=a.inp": "line 1: 'a.inp' includes itself",
    "*INCLUDE": "line 1: *INCLUDE needs INPUT=",
    "*SYSTEM\n1,0,0": "line 1: *SYSTEM is not read",
    "*INSTANCE, NAME=a, PART=b\n*END INSTANCE": "line 1: there is no part 'b'",
    "{tet}*ELSET, ELSET=a\na": "set 'a' contains itself",
    "{tet}*ELSET, ELSET=a\nb": "set 'a' has 'b', which is not defined",
    "{tet}*NSET, NSET=a\n9": "set 'a' has 9, which is not defined",
    "{tet}*NSET, NSET=a, GENERATE\n1, 999999999999": "line 9: the generated set has no valid range",
    "{tet}*NSET, NSET=a, GENERATE\n1": "line 9: the generated set has no valid range",
    "{tet}*NSET, NSET=a, GENERATE\n,": "line 9: the generated set has no valid range",
    "{tet}*SURFACE, NAME=a\n1, S5": "surface 'a': element 1 has no face S5",
    "{tet}*SURFACE, NAME=a\n1, SPOS": "surface 'a': 'SPOS' is not a face of a solid element",
}
TET = "*NODE\n1,0,0,0\n2,1,0,0\n3,0,1,0\n4,0,0,1\n*ELEMENT, TYPE=C3D4\n1,1,2,3,4\n"


@pytest.mark.parametrize(("text", "message"), FAULTS.items(), ids=list(FAULTS.values()))
def test_faults_are_named_with_their_line(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "a.inp"
    path.write_text(text.replace("{tet}", TET))
    with pytest.raises(MeshError) as refused:
        read(path)
    assert str(path) in refused.value.message
    assert message in refused.value.message


def test_text_that_calculix_ignores_is_ignored_and_noted(tmp_path: Path) -> None:
    path = tmp_path / "a.inp"
    path.write_text(f">**\n  a tetrahedron\n{TET.replace('1,1,2,3,4', '1,1,2,3,4, 9, 8,')}")
    source = read(path)
    assert source.node_tags[source.cells].tolist() == [[1, 2, 3, 4]]
    text = "only its mesh is read, not 2 lines before the first keyword, entries after the 4 nodes of elements C3D4"
    assert source.notes == (text,)


def test_included_files_are_read_in_their_place(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    nodes, elements = TET.split("*ELEMENT")
    body, inner = tmp_path / "body.inp", tmp_path / "sub" / "mesh.inc"
    body.write_text("*HEADING\na\n*INCLUDE,\n INPUT=sub\\mesh.inc\n*NSET, NSET=Füße,\n*NSET, NSET=Füße\n1, 2, 3\n")
    inner.write_text(f'*Node, input="my nodes.txt"\n*ELEMENT{elements}')
    (tmp_path / "sub" / "my nodes.txt").write_text(nodes.removeprefix("*NODE\n"), encoding="utf-16")
    source = read(body)
    assert len(source.points) == 4
    assert [group.name for group in source.groups] == ["Füße"]
    assert FORMATS[".inp"].groups(body).names == {"Füße"}  # type: ignore[union-attr]
    digest = file_digest(body)
    (tmp_path / "sub" / "my nodes.txt").write_text(nodes.removeprefix("*NODE\n").replace("1,0,0", "1,0,1"))
    assert file_digest(body) != digest
    inner.write_text("*INCLUDE, INPUT=body.inp")
    with pytest.raises(MeshError, match=r"mesh\.inc, line 1: 'body\.inp' includes itself"):
        read(body)
    body.write_text(f"*INCLUDE, INPUT={tmp_path.parent / 'a.inc'}")
    (tmp_path.parent / "a.inc").write_text(TET)
    assert "leads out of the directory" in mesh_fault(tmp_path, "body.inp")


def test_a_packed_mesh_is_refused_as_packed(tmp_path: Path) -> None:
    (tmp_path / "a.inp.gz").write_bytes(b"")
    with pytest.raises(ValueError, match="is packed; unpack it by gunzip"):
        spec(tmp_path / "a.inp.gz")


def test_damaged_files_get_a_message_or_are_read(tmp_path: Path) -> None:
    whole, source = assembly().encode("latin-1"), random.Random(7)
    path = tmp_path / "damaged.inp"
    messages = list[str]()
    for _ in range(12):
        content = bytearray(whole)
        for _ in range(source.randint(1, 20)):
            place = source.randrange(len(content))
            match source.randrange(3):
                case 0:
                    content[place] = source.randrange(256)
                case 1:
                    del content[place : place + source.randrange(200)]
                case _:
                    content[place:place] = content[source.randrange(len(content)) :][:50]
        path.write_bytes(content)
        try:
            read(path)
        except MeshError as error:
            messages.append(error.message)
    assert len(set(messages)) > 5
    assert not [text for text in messages if "Traceback" in text or "Error:" in text]


def test_a_job_on_an_input_file_writes_one(tmp_path: Path) -> None:
    (tmp_path / "mount.inp").write_text(assembly())
    data: dict[str, Any] = {
        "mesh": {"file": "mount.inp", "unit": "mm"},
        "material": {"law": "neo-hookean", "young": "1 MPa", "poisson": 0.4},
        "effects": [{"effect": "pressure", "region": "Top", "pressure": "10 kPa"}],
        "supports": [{"region": "Foot", "fix": ["x", "y", "z"]}],
        "certificate": NO_CERTIFICATE,
    }
    job = hpcinv.load(write_job(tmp_path / "job.yaml", data))
    hpcinv.run(job, MPI.COMM_SELF, directory=tmp_path / "run", progress=False)
    shape, given = read(tmp_path / "run" / "shape.inp"), read(tmp_path / "mount.inp")
    assert np.array_equal(shape.node_tags, given.node_tags)
    assert np.array_equal(shape.cells, given.cells)
    assert {g.name for g in shape.groups} == {g.name for g in given.groups}
    assert 1e-3 < np.abs(shape.points - given.points).max() < 0.1
    wrong = write_job(tmp_path / "wrong.yaml", data, supports=[{"region": "Foott", "fix": ["x", "y", "z"]}])
    with pytest.raises(MeshError, match="no region 'Foott'"):
        hpcinv.run(wrong, MPI.COMM_SELF, progress=False)


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX is not installed")
def test_calculix_finds_the_same_displacements(tmp_path: Path) -> None:
    """A linear problem: on straight tetrahedra of degree 2 its four points integrate exactly."""
    box = ROOT / "meshes" / "box.py"
    source = read_source(spec(box, parameters={"nx": 2, "ny": 1, "nz": 2}, geometry_degree=2), box)
    save(tmp_path / "box.inp", source, source.points)
    deck = (tmp_path / "box.inp").read_text()
    deck += f"*NSET, NSET=EVERY, GENERATE\n1, {source.node_tags.max()}, 1\n"
    deck += "*MATERIAL, NAME=M\n*ELASTIC\n1e6, 0.3\n*DENSITY\n1e-3\n*SOLID SECTION, ELSET=block, MATERIAL=M\n"
    deck += "*BOUNDARY\nz0, 1, 3\n*STEP\n*STATIC\n*DLOAD\nblock, GRAV, 14.142135623730951, 1., 0., -1.\n"
    deck += "*NODE PRINT, NSET=EVERY\nU\n*END STEP\n"
    (tmp_path / "deck.inp").write_text(deck)
    subprocess.run(["ccx", "-i", "deck"], cwd=tmp_path, check=True, capture_output=True, timeout=60)
    rows = [line.split() for line in (tmp_path / "deck.dat").read_text().splitlines() if len(line.split()) == 4]
    theirs = {int(row[0]): np.array(row[1:], dtype=float) for row in rows if row[0].isdigit()}
    result = hpcinv.run(
        {
            "analysis": "forward",
            "mesh": {"file": str(tmp_path / "box.inp")},
            "material": {"law": "neo-hookean", "young": 1e6, "poisson": 0.3},
            "effects": [{"effect": "gravity", "acceleration": [10, 0, -10], "density": 1e-3}],
            "supports": [{"region": "z0", "fix": ["x", "y", "z"]}],
            "discretisation": {"displacement": 2, "formulation": "displacement"},
            "certificate": "off",
            "output": {"unit_warnings": False},
        },
        MPI.COMM_SELF,
        progress=False,
    )
    ours = reorder_to_source(result.body, result.solutions[0].u)
    tags = result.body.source.node_tags
    expected = np.array([theirs[tag] for tag in tags.tolist()])
    assert np.abs(ours - expected).max() < 1e-6 * np.abs(expected).max()
