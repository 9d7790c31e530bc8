"""Surfaces of shells in files of other programs: the same bodies and regions as from MSH files."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.sheets import sheet

from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import JobError, MeshError
from hpcinv.job.job import load
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.job.shell_section import Shell
from hpcinv.mesh.body import read_source
from hpcinv.mesh.io.gmsh_model import session
from hpcinv.mesh.io.isolated import read_isolated
from hpcinv.mesh.io.vtu import VTK_TYPES
from hpcinv.mesh.io.vtu_writer import Array, Grid, write_vtu
from hpcinv.mesh.mesh_files import save_body
from hpcinv.mesh.midsurface import thicken
from hpcinv.mesh.readers import read_surface
from hpcinv.mesh.source import MeshSource

pytestmark = pytest.mark.usefixtures("warm_reader")

NUMBERS = {"left": 1, "right": 2, "x0": 0}
"""values of the array 'part'"""
NODES = """*NODE
1, 0, 0, 0
2, 1, 0, 0
3, 2, 0, 0
4, 0, 1, 0
5, 1, 1, 0
6, 2, 1, 0
*ELEMENT, TYPE=S4R, ELSET=left
1, 1, 2, 5, 4
*ELEMENT, TYPE=S3, ELSET=right
2, 2, 3, 5
3, 3, 6, 5
"""


def save_bent_sheets(folder: Path, degree: int, split: str) -> None:
    """Write a sheet of gmsh as .msh, as .vtu with named regions, thickness and numbers of parts, and as .inp."""
    with session("sheet") as gmsh:
        occ, mesh = gmsh.model.occ, gmsh.model.mesh
        occ.fragment([(2, occ.addRectangle(0, 0, 0, 1, 1))], [(2, occ.addRectangle(1, 0, 0, 1, 1))])
        occ.synchronize()
        for _, curve in gmsh.model.getEntities(1):
            mesh.setTransfiniteCurve(curve, 3)
        gmsh.option.setNumber("Mesh.SecondOrderIncomplete", 0)
        for tag in (1, 2):
            mesh.setTransfiniteSurface(tag)
            if split == "quadrilateral" or (split == "both" and tag == 1):
                mesh.setRecombine(2, tag)
        ends = [t for _, t in gmsh.model.getEntities(1) if gmsh.model.getBoundingBox(1, t)[3] < 1e-3]
        for dim, entities, name in ((2, [1], "left"), (2, [2], "right"), (1, ends, "x0")):
            gmsh.model.addPhysicalGroup(dim, entities, name=name)
        mesh.generate(2)
        mesh.setOrder(degree)
        for tag in mesh.getNodes()[0]:
            x, y, _ = mesh.getNode(tag)[0]
            mesh.setNode(tag, [x, y, 0.3 * x**2], [])
        tags, positions, _ = mesh.getNodes()
        blocks = []
        for dim, entity in [(2, 1), (2, 2), *((1, end) for end in ends)]:
            for kind, _, nodes in zip(*mesh.getElements(dim, entity), strict=True):
                name, _, _, size, *_ = mesh.getElementProperties(kind)
                blocks.append((np.array(nodes).reshape(-1, size), name.split()[0], entity if dim == 2 else 0))
        gmsh.write(str(folder / "sheet.msh"))
    save_vtu(folder / "sheet.vtu", tags, positions.reshape(-1, 3), blocks, degree)
    save_inp(folder / "sheet.inp", tags, positions.reshape(-1, 3), blocks)


def save_vtu(path: Path, tags: Any, points: np.ndarray, blocks: list[tuple[np.ndarray, str, int]], degree: int) -> None:
    kinds = {"Line": "interval", "Triangle": "triangle", "Quadrilateral": "quadrilateral"}
    order = np.argsort(tags)
    cells = [
        (order[np.searchsorted(tags, nodes, sorter=order)], VTK_TYPES[kinds[k]][degree - 1]) for nodes, k, _ in blocks
    ]
    part = np.concatenate([np.full(len(nodes), entity, dtype=np.int32) for nodes, _, entity in blocks])
    arrays = [Array(f"region:{name}", (part == number).astype(np.int32)) for name, number in NUMBERS.items()]
    wall = [Array("wall", 20 + 5 * points[:, 0])]
    assert write_vtu(path, MPI.COMM_SELF, Grid(points, cells), wall, [*arrays, Array("part", part)]) is None


def save_inp(path: Path, tags: Any, points: np.ndarray, blocks: list[tuple[np.ndarray, str, int]]) -> None:
    lines = ["*NODE", *(f"{tag}, {x!r}, {y!r}, {z!r}" for tag, (x, y, z) in zip(tags, points.tolist(), strict=True))]
    number = 0
    for nodes, _, entity in blocks:
        if not entity:
            lines += ["*NSET, NSET=x0", *map(str, np.unique(nodes))]
            continue
        count = min(nodes.shape[1], 8)  # elements of 8 nodes have no centre
        lines.append(f"*ELEMENT, TYPE=S{count}{'R' if count == 8 else ''}, ELSET={('left', 'right')[entity - 1]}")
        for row in nodes[:, :count]:
            number += 1
            lines.append(", ".join(map(str, (number, *row))))
    path.write_text("\n".join(lines))


def body_of(path: Path, **keys: Any) -> MeshSource:
    given = {"file": str(path), "shell": {"thickness": "20 mm + 5e-3*x"}} | keys
    return read_source(MeshSpec.model_validate(given), path)


def regions(body: MeshSource) -> dict[tuple[str, int], np.ndarray]:
    """Return the sorted middles of the members of each group."""
    entities = {2: body.facets, 3: body.cells}
    middles = {(g.name, g.dim): body.points[entities[g.dim][g.members]].mean(axis=1) for g in body.groups}
    return {key: rows[np.lexsort(np.round(rows, 9).T)] for key, rows in middles.items()}


@pytest.mark.parametrize(("degree", "split"), [(1, "both"), (2, "both"), (2, "quadrilateral")])
def test_the_body_is_the_same_from_each_format(tmp_path: Path, degree: int, split: str) -> None:
    """Triangles and quadrilaterals of both degrees, with regions of cells and edges, by names and by numbers."""
    save_bent_sheets(tmp_path, degree, split)
    expected = regions(body_of(tmp_path / "sheet.msh"))
    assert len(expected[("x0", 2)]) == (4 if split == "both" else 2)
    by_array = {"shell": {"thickness": {"data": "wall", "unit": "mm"}}}
    labels = {"array": "part", "names": {f"{name}-by-number": [number] for name, number in NUMBERS.items()}}
    for other in (
        body_of(tmp_path / "sheet.vtu", **by_array),
        body_of(tmp_path / "sheet.vtu", labels=labels),
        body_of(tmp_path / "sheet.inp"),
    ):
        found = regions(other)
        for key, middles in expected.items():
            assert found[key] == pytest.approx(middles, abs=1e-12), key
    renamed = {(f"{name}-by-number", dim): (name, dim) for name, dim in (("left", 3), ("right", 3), ("x0", 2))}
    found = regions(body_of(tmp_path / "sheet.vtu", labels=labels))
    for key, same in renamed.items():
        assert found[key] == pytest.approx(expected[same], abs=1e-12)


def test_sets_and_surfaces_of_elements_are_regions(tmp_path: Path) -> None:
    """Boundary edges of node sets, cells and edges of surfaces, and edges that ``*BOUNDARY`` holds node by node."""
    sets = "*NSET, NSET=x0\n1, 4\n*NSET, NSET=point\n6\n*SURFACE, NAME=x1\n3, E1\n*SURFACE, NAME=up\nleft, SPOS\n"
    (tmp_path / "sheet.inp").write_text(f"{NODES}{sets}*BOUNDARY\n1, 1, 3\n2, 1, 3\n")
    surface = read_surface(tmp_path / "sheet.inp")
    places = {
        group.name: surface.points[(surface.facets if group.dim == 2 else surface.cells)[group.members]].mean((0, 1))
        for group in surface.groups
    }
    assert places["x0"] == pytest.approx([0, 0.5, 0])
    assert places["x1"] == pytest.approx([2, 0.5, 0])
    assert places["up"] == pytest.approx(places["left"])
    assert places["held-xyz"] == pytest.approx([0.5, 0, 0])
    assert surface.thin_groups == ("point",)


def test_node_arrays_name_edges(tmp_path: Path) -> None:
    """Nodes of an array ``region:NAME`` are the boundary edges between them, as of surfaces without lines."""
    given = sheet(tmp_path / "sheet.vtu", 2, 2, lambda s, t: np.column_stack([s, t, 0 * s]))
    cells = [(given.cells[:, [0, 1, 3, 2]], 9)]
    marked = [Array("region:x0", (given.points[:, 0] == 0).astype(np.int32))]
    assert write_vtu(tmp_path / "sheet.vtu", MPI.COMM_SELF, Grid(given.points, cells), marked, []) is None
    surface = read_surface(tmp_path / "sheet.vtu")
    (edge,) = surface.groups
    assert (edge.name, edge.dim, len(edge.members)) == ("x0", 2, 2)
    assert (surface.points[surface.facets[edge.members], 0] == 0).all()


def test_files_of_triangles_name_their_kinks(tmp_path: Path) -> None:
    (tmp_path / "roof.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0.2\nf 1 2 3\nf 3 2 4\n")
    surface = read_surface(tmp_path / "roof.obj")
    normal = np.cross([-1, 1, 0], [0, 1, 0.2])
    angle = np.degrees(np.arccos(abs(normal[2]) / np.linalg.norm(normal)))
    assert f"meet at angles of up to {angle:.0f}°" in surface.notes[0]
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 3 4 2\n")
    assert not any("kinks" in note for note in read_surface(tmp_path / "flat.obj").notes)


@pytest.mark.parametrize(
    ("cells", "message"),
    [
        ([([0, 1, 2, 3], 10)], "a shell cannot be tied to solid cells, and the file has Tetra"),
        ([([0, 1, 4, 3, 2], 7)], "needs triangles or quadrilaterals of degree 1 or 2, not Polygon"),
        ([([0, 1], 3)], "has no triangles or quadrilaterals"),
        ([([0, 1, 2], 5), ([0, 1, 2, 3, 4, 5], 22)], "triangles of 3 nodes and triangles of 6 nodes"),
        ([([0, 1, 2], 5), ([3, 4], 3)], "1 of 1 lines of region 'all' are not edges of its cells"),
    ],
)
def test_other_cells_of_vtk_are_refused(tmp_path: Path, cells: list[Any], message: str) -> None:
    path, points = tmp_path / "sheet.vtu", np.random.default_rng(1).random((6, 3))
    grid = Grid(points, [(np.array([nodes]), number) for nodes, number in cells])
    everywhere = [Array("region:all", np.ones(len(cells), dtype=np.int32))]
    assert write_vtu(path, MPI.COMM_SELF, grid, [], everywhere) is None
    with pytest.raises(MeshError, match=message):
        read_surface(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("*NODE\n1, 0, 0, 0\n", "has no shell elements"),
        (f"{NODES}*ELEMENT, TYPE=C3D4\n9, 1, 2, 3, 4\n", "a shell cannot be tied to solid elements, such as C3D4"),
        (f"{NODES}*SURFACE, NAME=a\n2, E4\n", "surface 'a': element 2 has no face E4"),
        (f"{NODES}*SURFACE, NAME=a\n2, top\n", "surface 'a': 'top' is not a face of a shell element"),
    ],
)
def test_faults_of_input_files_are_named(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "sheet.inp").write_text(text)
    with pytest.raises(MeshError, match=message):
        read_surface(tmp_path / "sheet.inp")


def test_regions_that_a_file_does_not_have_are_named(tmp_path: Path) -> None:
    path = tmp_path / "sheet.vtu"
    grid = Grid(np.eye(3), [(np.array([[0, 1, 2]]), 5)])
    assert write_vtu(path, MPI.COMM_SELF, grid, [], []) is None
    job = {
        "mesh": {"file": str(path), "shell": {"thickness": "100 mm"}},
        "material": {"law": "neo-hookean", "mu": "1 MPa", "lam": "2 MPa"},
        "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
    }
    with pytest.raises(JobError, match=r"no region 'x0' in sheet\.vtu.*give a condition, such as 'regions: \{x0: x <"):
        load(job)


@pytest.mark.parametrize("middles", [False, True])
def test_an_input_file_of_a_shell_comes_back_with_its_numbers(middles: bool, tmp_path: Path) -> None:
    text = NODES.replace("\n2, 2, 3, 5\n", "\n3, 2, 3, 5\n").replace("\n3, 3, 6, 5", "\n17, 3, 6, 5")
    text += "*NSET, NSET=x0\n1, 4\n*ELSET, ELSET=some\n1, 3\n"
    if middles:
        text = "*NODE\n1,0,0,0\n2,2,0,0\n3,2,2,0\n4,0,2,0\n15,1,0,0\n16,2,1,0\n17,1,2,0\n18,0,1,0\n"
        text += "*ELEMENT, TYPE=S8R, ELSET=left\n17, 1,2,3,4,15,16,17,18\n*NSET, NSET=x0\n1,4,18\n"
    given, written = tmp_path / "given.inp", tmp_path / "written.inp"
    given.write_text(text)
    source = read_surface(given)
    body = thicken(source, Shell.model_validate({"thickness": "0.5 m"}))
    save_body(written, body, body.points * 2)
    first, second = (read_isolated("inp-shells", path, "", "")[1] for path in (given, written))
    thickness = second.pop("values:nodal_thickness")
    np.testing.assert_allclose(thickness, 1.0)
    np.testing.assert_allclose(second.pop("points"), 2 * first.pop("points"), atol=1e-15)
    assert first.keys() == second.keys()
    for name, values in first.items():
        np.testing.assert_array_equal(values, second[name], err_msg=name)
    again = read_surface(written)
    assert {g.name: g.members.tolist() for g in again.groups} == {g.name: g.members.tolist() for g in source.groups}


def test_loose_nodes_of_a_shell_are_counted(tmp_path: Path) -> None:
    (tmp_path / "a.inp").write_text(NODES.replace("3, 3, 6, 5\n", ""))
    assert any("1 of its nodes belong to no element" in note for note in read_surface(tmp_path / "a.inp").notes)
