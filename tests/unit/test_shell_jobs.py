"""What a shell refuses: sections of its job, and surfaces that have no director."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import CellType, create_box, locate_entities_boundary
from helpers.sheets import flat, quadrilaterals, save_sheet
from scipy.linalg import eigh
from scipy.sparse.linalg import splu

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.spatial_fields import VaryingQuantity
from hpcinv.errors import JobError, MeshError
from hpcinv.job.job import load
from hpcinv.job.shell_section import Shell
from hpcinv.mesh.cells import LayerDegree, jacobians, quadrature, quadrature_metadata
from hpcinv.mesh.io.gmsh_model import session
from hpcinv.mesh.midsurface import surface_source, thicken
from hpcinv.mesh.readers import read_surface
from hpcinv.mesh.source import DataArray, MeshSource
from hpcinv.model.spaces import Unknowns
from hpcinv.output.surfaces.boundary_surface import Boundary
from hpcinv.pages.pictures import job_picture
from hpcinv.pages.reports.symbols import symbols

THIN = Shell(thickness=0.1)
CELLS = CellType.hexahedron


@pytest.fixture(scope="module")
def sheet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_sheet(tmp_path_factory.mktemp("sheet") / "sheet.msh", 3, 2, flat(3, 2))


def job(path: Path, **data: Any) -> dict[str, Any]:
    base = {
        "mesh": {"file": str(path), "shell": {"thickness": "100 mm"}},
        "material": {"law": "neo-hookean", "mu": "1 MPa", "lam": "2 MPa"},
        "effects": [{"effect": "pressure", "region": "outer", "pressure": "1 Pa"}],
        "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
    }
    return base | data


@pytest.mark.parametrize(
    ("name", "keys", "message"),
    [
        ("sheet.bdf", {}, "mesh.shell: needs a surface in a file of .msh, .py, .geo, .vtu"),
        ("sheet.stl", {}, "mesh.unit: is needed: files of surfaces do not have one"),
        ("sheet.stl", {"unit": "mm", "size": "1 mm"}, "mesh.size: is not valid with a shell"),
        ("sheet.inp", {"labels": {"array": "part"}}, "mesh.labels: of a shell can be in a .vtu or .vtk file only"),
        ("sheet.inp", {"shell": {"director": "data"}}, "mesh.shell.director: can be from data in a .msh or .vtu"),
    ],
)
def test_surfaces_in_other_formats_are_refused_in_one_line(
    tmp_path: Path, name: str, keys: dict[str, Any], message: str
) -> None:
    (tmp_path / name).touch()
    with pytest.raises(JobError) as caught:
        load(job(tmp_path / name, mesh={"file": str(tmp_path / name), "shell": {"thickness": "100 mm"}} | keys))
    assert len(caught.value.problems) == 1
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"discretisation": {"displacement": 3}}, "discretisation.displacement: must be 2 in a shell"),
        ({"discretisation": {"quadrature": 6}}, "discretisation.quadrature: is not valid with a shell"),
        ({"solver": {"linear": "iterative"}}, "together with solver.linear"),
        ({"output": {"mesh": ["bdf"]}}, "output.mesh: must be inp, msh or vtu, which hold a shell: 'hpcinv export'"),
        ({"supports": [{"region": "x9", "fix": ["x", "y", "z"]}]}, "there is no region 'x9'"),
    ],
)
def test_jobs_that_a_shell_does_not_have_are_refused(sheet: Path, data: dict[str, Any], message: str) -> None:
    with pytest.raises(JobError, match=message.replace("'", ".")):
        load(job(sheet, **data))


@pytest.mark.parametrize(
    ("shell", "message"),
    [
        ({}, "mesh.shell.thickness: is needed"),
        ({"thickness": "-1 mm"}, "mesh.shell.thickness"),
        ({"thickness": "1 mm", "director": "data"}, "is not valid with 'director: data'"),
        (
            {"thickness": "1 mm", "kind": "membrane"},
            "mesh.shell.kind: must be 'director': for a membrane, give a small",
        ),
        ({"thickness": "1 mm + 2 kg"}, "mesh.shell.thickness"),
        ({"thickness": {"core": "1 mm"}}, "mesh.shell.thickness: cannot be by region"),
        ({"thickness": "1 mm", "layers": {"outer": 1}}, "mesh.shell.layers.outer: is the name of another region"),
        ({"thickness": "1 mm", "layers": {"a": 0}}, "mesh.shell.layers.a: must be a positive number"),
    ],
)
def test_thickness_is_given_once(sheet: Path, shell: dict[str, Any], message: str) -> None:
    with pytest.raises(JobError, match=message):
        load(job(sheet, mesh={"file": str(sheet), "shell": shell}))


def test_hinges_are_of_shells_only(sheet: Path) -> None:
    supports = [{"region": "boundary", "fix": ["x", "y", "z"], "hinge": True}]
    with pytest.raises(JobError, match=r"supports\[0\]\.hinge: is valid only with"):
        load(job(sheet, mesh={"file": str(sheet)}, effects=[], supports=supports))


def test_hinges_of_faces_are_refused(sheet: Path) -> None:
    """A face has no node of the midsurface, and would be held nowhere."""
    supports = [
        {"region": "x0", "fix": ["x", "y", "z"]},
        {"region": "inner", "fix": ["z"], "hinge": True},
    ]
    with pytest.raises(MeshError, match=r"supports\[1\]\.hinge: 'inner' has no nodes of the midsurface"):
        hpcinv.run(job(sheet, analysis="forward", supports=supports), progress=False)


def test_moments_are_of_edges_of_shells_only(sheet: Path) -> None:
    moment = {"effect": "edge-moment", "moment": [0, "1 N", 0]}
    supports = [{"region": "boundary", "fix": ["x", "y", "z"]}]
    with pytest.raises(JobError, match=r"effects\[0\]\.effect: is valid only with 'mesh: {shell"):
        load(job(sheet, mesh={"file": str(sheet)}, effects=[moment | {"region": "x1"}], supports=supports))
    with pytest.raises(MeshError, match=r"effects\[0\]\.region: .*sheet.*: region 'inner' has parts of a face"):
        hpcinv.run(job(sheet, analysis="forward", effects=[moment | {"region": "inner"}]), progress=False)


def test_edges_and_faces_of_groups_are_regions(sheet: Path) -> None:
    supports = [{"region": "x0", "fix": ["x", "y", "z"]}, {"region": "sheet|inner", "fix": ["z"]}]
    assert load(job(sheet, supports=supports)).mesh.shell == THIN


def body(source: MeshSource) -> np.ndarray:
    """Volumes of the cells of the shell's body."""
    points, weights = quadrature("hexahedron", 4)
    gradients = jacobians("hexahedron", 2, source.points[source.cells], points)
    return np.asarray(np.linalg.det(gradients) @ weights)


def test_cells_turn_to_one_side(sheet: Path) -> None:
    surface = read_surface(sheet)
    mirrored = surface.cells[:, [0, 2, 1, 3, 5, 4, 7, 6, 8]]
    cells = np.where(np.array([False, True, False, False, True, True])[:, None], mirrored, surface.cells)
    volumes = body(thicken(replace(surface, cells=cells), THIN))
    assert volumes == pytest.approx(0.1)
    assert -body(thicken(replace(surface, cells=mirrored), THIN)) == pytest.approx(-0.1)


def test_closed_surfaces_have_their_outer_face_outside() -> None:
    """A sphere of six patches, far from the origin: the volume of its wall is that between two spheres."""
    surface, centre = _sphere(4), np.array([5.0, 0, 0])
    thick = thicken(replace(surface, points=surface.points + centre), THIN)
    outer = next(group for group in thick.groups if group.name == "outer")
    assert np.linalg.norm(thick.points[thick.facets[outer.members]] - centre, axis=2) == pytest.approx(1.05, abs=3e-3)
    assert body(thick).sum() == pytest.approx(4 / 3 * np.pi * (1.05**3 - 0.95**3), rel=5e-3)


def test_the_surface_comes_back_with_its_faces(sheet: Path) -> None:
    surface = read_surface(sheet)
    thick = thicken(surface, THIN)
    back, points = surface_source(thick, 2 * thick.points)
    assert (points == 2 * surface.points).all()
    assert back.data["thickness"].values == pytest.approx(0.2)
    assert back.data["director"].values == pytest.approx(np.tile([0, 0, 1.0], (len(points), 1)))
    again = thicken(replace(back, points=points), Shell(director="data"))
    assert again.points == pytest.approx(2 * thick.points, abs=1e-15)
    with pytest.raises(MeshError, match="has no array 'inner'"):
        thicken(surface, Shell(director="data"))


@pytest.mark.parametrize("place", ["middle", "outer", "inner"])
def test_layers_and_thickness_follow_the_job(sheet: Path, place: Any) -> None:
    """Volumes of two layers of varying thickness, on either side of the surface, which comes back with its faces."""
    surface = read_surface(sheet)
    given = VaryingQuantity("m").read("0.1 + 0.02*x")
    layers = {"core": 3.0, "coat": 1.0}
    shell = Shell(thickness=given, surface=place, layers=layers)
    thick = thicken(surface, shell)
    volumes, groups = body(thick), {group.name: group.members for group in thick.groups}
    for name, share in layers.items():
        assert volumes[groups[name]].sum() == pytest.approx(share / 4 * 2 * (0.1 * 3 + 0.02 * 9 / 2))
    heights = {name: thick.points[thick.facets[groups[name]]][..., 2] for name in ("inner", "outer")}
    assert (
        np.sign([heights["inner"].min(), heights["outer"].max()]).tolist()
        == {
            "middle": [-1, 1],
            "outer": [-1, 0],
            "inner": [0, 1],
        }[place]
    )
    back, points = surface_source(thick, thick.points * [1, 1, 2])
    assert points == pytest.approx(surface.points, abs=1e-15)
    assert back.data["thickness"].values[:, 0] == pytest.approx(0.2 + 0.04 * points[:, 0])
    if place == "middle":
        return  # the surface is inside of a layer
    again = thicken(replace(back, points=points), Shell(director="data", surface=place, layers=layers))
    assert again.points == pytest.approx(thick.points * [1, 1, 2], abs=1e-15)
    by_data = Shell(thickness=VaryingQuantity("m").read({"data": "thickness", "unit": "mm"}))
    values = 1e3 * back.data["thickness"].values
    measured = replace(back, data={"thickness": replace(back.data["thickness"], values=values)})
    assert body(thicken(measured, by_data)).sum() == pytest.approx(2 * volumes.sum())


@pytest.mark.parametrize(
    "kind",
    [
        "junction",
        "fold",
        "strip with one side",
        "too thin",
        "too thick",
        "too curved",
        "name of a face",
        "cell without area",
    ],
)
def test_surfaces_without_a_director_are_refused(sheet: Path, kind: str) -> None:
    surface, shell = read_surface(sheet), THIN
    message = {
        "junction": r"more than two cells meet at \d+ edges \(first: at \([\d.]+, 0, 0\) m\)",
        "fold": r"has a fold of 90° at \(1, [\d.]+, 0\) m",
        "strip with one side": "only one side",
        "too thin": r"is 3\.61 m long, 36,056 times its thickness of 100 µm",
        "too thick": r"the shell is 10 m thick, and its surface only 3\.61 m long",
        "too curved": r"for a thickness of 2\.2 m at .* 6 cells of the outer face are inside out\n.*Is the unit",
        "name of a face": "has a physical group .outer.",
        "cell without area": r"cells without area \(first of \d+ quadrilaterals: at \([\d.]+, [\d.]+, 0\) m\)",
    }[kind]
    if kind == "junction":
        points = np.concatenate([surface.points, surface.points[:, [0, 2, 1]]])
        same = np.isclose(points[:, 1:], 0).all(axis=1)[len(surface.points) :]
        second = np.arange(len(surface.points)) + len(surface.points)
        second[same] = np.flatnonzero(same)
        third = surface.points * [1, -1, 1]
        rows = np.arange(len(third)) + 2 * len(third)
        rows[same] = np.flatnonzero(same)
        surface = replace(
            surface,
            points=np.concatenate([points, third]),
            node_tags=np.arange(1, 3 * len(third) + 1),
            cells=np.concatenate([surface.cells, second[surface.cells], rows[surface.cells]]),
        )
    elif kind == "fold":
        x, y, _ = surface.points.T
        surface = replace(surface, points=np.column_stack([np.minimum(x, 1), y, np.maximum(x - 1, 0)]))
    elif kind == "strip with one side":
        surface = _moebius()
    elif kind == "cell without area":
        surface.points[surface.cells[0], 0] = 0.0
    elif kind == "too curved":
        angle, y, _ = surface.points.T
        shell = Shell(thickness=2.2)
        surface = replace(surface, points=np.column_stack([np.sin(angle), y, 1 - np.cos(angle)]))
    elif kind == "name of a face":
        surface = replace(surface, groups=tuple(replace(group, name="outer") for group in surface.groups[:1]))
    else:
        shell = Shell(thickness=1e-4 if kind == "too thin" else 10.0)
    with pytest.raises(MeshError, match=message):
        thicken(surface, shell)


def test_edges_much_shorter_than_the_thickness_are_named(sheet: Path) -> None:
    surface = read_surface(sheet)
    assert not thicken(surface, THIN).notes
    x, y, z = surface.points.T
    narrow = replace(surface, points=np.column_stack([np.where(x > 2, 2 + 1e-5 * (x - 2), x), y, z]))
    [note] = thicken(narrow, THIN).notes
    assert note.startswith("an edge at (2, ")
    assert "is 10 µm long, 0.0001 of the thickness" in note


def test_arrays_of_both_faces_vary_through_the_thickness(sheet: Path) -> None:
    surface = read_surface(sheet)
    faces = {name: np.full((len(surface.points), 1), value) for name, value in (("p_inner", 1.0), ("p_outer", 3.0))}
    surface = replace(surface, data={name: DataArray(name, "nodes", values) for name, values in faces.items()})
    data = thicken(surface, Shell(thickness=0.1, layers={"core": 3, "coat": 1})).data
    levels = data["p"].values.reshape(5, len(surface.points))
    assert levels[:, 0] == pytest.approx([1, 1.75, 2.5, 2.75, 3])
    assert (levels == levels[:, :1]).all()
    assert (data["p_inner"].values == 1).all()


@pytest.mark.release
def test_angle_of_a_fold_does_not_depend_on_the_cells(tmp_path: Path) -> None:
    """A bent sheet has one triangle on one side of a node and two on the other; the director bisects the fold."""
    path = tmp_path / "bent.msh"
    sheet = np.array([[0, 0, 0], [0, 1, 0], [1, 1, 0], [1, 0, 0], [-1, 0, 0], [-1, 1, 0]], dtype=float)
    for angle in (90, 30):
        turned = np.radians(180 - angle)
        points = sheet.copy()
        points[4:, ::2] = np.cos(turned), np.sin(turned)
        with session("bent") as gmsh:
            entity = gmsh.model.addDiscreteEntity(2)
            gmsh.model.mesh.addNodes(2, entity, np.arange(1, 7), points.ravel())
            gmsh.model.mesh.addElementsByType(entity, 2, [], [1, 3, 2, 1, 4, 3, 1, 2, 5, 2, 6, 5])
            gmsh.model.addPhysicalGroup(2, [entity], name="sheet")
            gmsh.write(str(path))
        surface = read_surface(path)
        if angle > 40:
            with pytest.raises(MeshError, match=f"has a fold of {angle}°"):
                thicken(surface, THIN)
            continue
        body = thicken(surface, THIN)
        columns = (body.points[-len(surface.points) :] - body.points[: len(surface.points)]) / THIN.thickness
        half = np.radians(angle / 2)
        expected = np.array([np.sin(half), 0, np.cos(half)])
        fold_nodes = np.isclose(surface.points[:, [0, 2]], 0).all(axis=1)
        assert np.abs(np.abs(columns[fold_nodes] @ expected) - 1).max() < 1e-12


@pytest.mark.parametrize(
    ("dim", "degree", "message"),
    [
        (2, 3, "triangles or quadrilaterals of degree 1 or 2, not Triangle 10"),
        (3, 1, "a shell cannot be tied to solid cells, and the file has Tetrahedron 4"),
    ],
)
def test_cells_of_other_kinds_are_named(tmp_path: Path, dim: int, degree: int, message: str) -> None:
    path = tmp_path / "box.msh"
    with session("box") as gmsh:
        gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
        gmsh.model.occ.synchronize()
        gmsh.model.mesh.generate(dim)
        gmsh.model.mesh.setOrder(degree)
        gmsh.write(str(path))
    with pytest.raises(MeshError, match=message):
        read_surface(path)


def test_thickness_that_is_not_positive_is_placed(sheet: Path) -> None:
    given = VaryingQuantity("m").read("0.1 - 0.05*x")
    with pytest.raises(MeshError, match=r"has a thickness of 0 m at \(2, 0, 0\) m\n.*must be positive"):
        thicken(read_surface(sheet), Shell(thickness=given))


@pytest.mark.release
@pytest.mark.parametrize("degree", [1, 2])
def test_triangles_become_quadrilaterals_on_the_same_surface(tmp_path: Path, degree: int) -> None:
    """Triangles and quadrilaterals next to them: the given nodes, edges, groups and data, on a surface without gaps."""
    path = tmp_path / "mixed.msh"
    with session("mixed") as gmsh:
        left, right = (gmsh.model.occ.addRectangle(corner, 0, 0, 1, 1) for corner in (0, 1))
        gmsh.model.occ.fragment([(2, left)], [(2, right)])
        gmsh.model.occ.synchronize()
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
        gmsh.model.mesh.setTransfiniteSurface(1)
        gmsh.model.mesh.setRecombine(2, 1)
        for tag, name in ((1, "left"), (2, "right")):
            gmsh.model.addPhysicalGroup(2, [tag], name=name)
        ends = [t for _, t in gmsh.model.getEntities(1) if gmsh.model.getBoundingBox(1, t)[3] < 1e-3]
        gmsh.model.addPhysicalGroup(1, ends, name="x0")
        gmsh.model.mesh.generate(2)
        gmsh.option.setNumber("Mesh.SecondOrderIncomplete", 0)
        gmsh.model.mesh.setOrder(degree)
        tags, coordinates, _ = gmsh.model.mesh.getNodes()
        points = coordinates.reshape(-1, 3)
        points[:, 2] = 0.1 * points[:, 0] ** 2 + 0.05 * points[:, 0] * points[:, 1]
        for tag, point in zip(tags, points, strict=True):
            gmsh.model.mesh.setNode(tag, point, [])
        gmsh.write(str(path))
    surface = read_surface(path)
    given = points[np.argsort(tags)]
    assert (surface.kind, surface.degree) == ("quadrilateral", 2)
    assert surface.points[: len(given)] == pytest.approx(given)
    assert "triangles of degree" in surface.notes[-1]
    x, y, z = surface.points.T
    if degree == 2:  # the elements hold this surface
        assert z == pytest.approx(0.1 * x**2 + 0.05 * x * y, abs=1e-12)
    groups = {group.name: group.members for group in surface.groups}
    assert len(groups["left"]) + len(groups["right"]) == len(surface.cells)
    assert surface.points[surface.cells[groups["left"]]][..., 0].max() == pytest.approx(1)
    edge = surface.points[surface.facets[groups["x0"]]]
    assert np.ptp(edge[:, :2, 1], axis=1).sum() == pytest.approx(1)
    thick = thicken(surface, THIN)
    assert thick.notes == surface.notes
    assert body(thick).min() > 0
    assert len(np.unique(np.round(surface.points, 9), axis=0)) == len(surface.points)


def test_quadrature_of_layers() -> None:
    """It is exact for degree 3 in the plane and 5 through the layer, has positive weights, and full rank."""
    for slenderness in (0.1, 5.0, 300.0):
        points, weights = quadrature("hexahedron", LayerDegree(4, slenderness))
        x, y, z = points.T
        assert (weights > 0).all()
        for a, b, c in [(3, 0, 0), (3, 3, 0), (1, 2, 5), (2, 2, 4)]:
            exact = 1 / ((a + 1) * (b + 1) * (c + 1))
            assert (weights * x**a * y**b * z**c).sum() == pytest.approx(exact, rel=1e-12)
    assert LayerDegree(4, 12.0).share == LayerDegree(4, 20.0).share > LayerDegree(4, 100.0).share


@pytest.mark.slow
@pytest.mark.parametrize("slenderness", [1, 10, 100])
def test_pressures_are_stable_in_thin_layers(slenderness: int) -> None:
    """The inf-sup constant of displacement and pressure against strains depends on neither width nor thickness."""
    layer = create_box(MPI.COMM_SELF, [np.zeros(3), np.array([1, 1, 1 / (4 * slenderness)])], [4, 4, 1], CELLS)
    unknowns = Unknowns(layer, 2, 1)
    u, p = ufl.split(ufl.TrialFunction(unknowns.space))
    v, q = unknowns.v, unknowns.q
    dx = ufl.dx(metadata=quadrature_metadata("hexahedron", LayerDegree(4, 1.4 * slenderness)))
    strains = ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v)))
    matrix = fem.assemble_matrix(fem.form((strains - q * ufl.div(u) + p * q) * dx)).to_scipy().tocsr()
    facets = locate_entities_boundary(layer, 2, lambda x: np.isclose(x[0], 0))
    held = [fem.locate_dofs_topological(unknowns.displacement_component(i), 2, facets) for i in range(3)]
    free, pressures = np.setdiff1d(unknowns.owned_displacement_dofs, np.concatenate(held)), unknowns.owned_pressure_dofs
    B, mass = matrix[pressures][:, free], matrix[pressures][:, pressures]
    schur = B @ splu(matrix[free][:, free].tocsc()).solve(B.T.toarray())
    assert eigh(schur, mass.toarray(), eigvals_only=True)[0] > 0.9**2


def _sphere(divisions: int) -> MeshSource:
    """Return a sphere of six patches of quadrilaterals, by projection of a cube."""
    from hpcinv.mesh.cells import scalar_element

    steps = np.linspace(-1, 1, 2 * divisions + 1)
    points: list[np.ndarray] = []
    cells: list[np.ndarray] = []
    local = np.rint(2 * scalar_element("quadrilateral", 2).points).astype(int)
    for axis in range(3):
        for side in (-1.0, 1.0):
            for i in range(0, 2 * divisions, 2):
                for j in range(0, 2 * divisions, 2):
                    corner = np.empty((9, 3))
                    corner[:, axis] = side
                    corner[:, (axis + 1) % 3] = steps[i + local[:, 0]]
                    corner[:, (axis + 2) % 3] = steps[j + local[:, 1]]
                    cells.append(len(points) * 9 + np.arange(9))
                    points.append(corner)
    every = np.concatenate(points)
    distinct, place = np.unique(np.round(every, 9), axis=0, return_inverse=True)
    place = place.ravel()
    angles = np.tan(np.pi / 4 * distinct)  # cells of similar size
    sphere = angles / np.linalg.norm(angles, axis=1, keepdims=True)
    return quadrilaterals(Path("sphere.msh"), sphere, place[np.array(cells)], {})


def _moebius() -> MeshSource:
    count = 12
    angles = np.pi * np.arange(2 * count) / count
    columns = np.linspace(-0.2, 0.2, 3)
    radius = 1 + columns[None] * np.cos(angles / 2)[:, None]
    points = np.stack(
        [
            radius * np.cos(angles)[:, None],
            radius * np.sin(angles)[:, None],
            columns[None] * np.sin(angles / 2)[:, None],
        ],
        axis=2,
    ).reshape(-1, 3)

    def node(i: int, j: int) -> int:
        return 3 * i + j if i < 2 * count else 2 - j

    order = [(0, 0), (2, 0), (0, 2), (2, 2), (1, 0), (0, 1), (2, 1), (1, 2), (1, 1)]
    cells = np.array([[node(2 * c + i, j) for i, j in order] for c in range(count)])
    return quadrilaterals(Path("strip.msh"), points, cells, {})


def test_pictures_show_faces_and_unknown_pressures(sheet: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    legends: list[Sequence[tuple[str, str]]] = []
    monkeypatch.setattr(job_picture, "figure", lambda *_, legend, **__: legends.append(legend))
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    faces = {name: np.arange(2) == number for number, name in enumerate(("outer", "inner"))}
    boundary = Boundary(corners, np.array([[0, 1, 2], [0, 2, 1]]), faces, body_kind="shell")
    room = {"surface": "inner", "lid": {"apex": [1, 1, -1]}, "volume": "2 m^3"}
    heat = {
        "effect": "thermal-expansion",
        "coefficient": 1e-4,
        "temperature": "37 °C",
        "reference_temperature": "20 °C",
    }
    read = load(job(sheet, analysis="forward", effects=[heat], cavities={"room": room}))
    job_picture.draw_job(read, boundary)
    texts = [text for text, _ in legends[0]]
    assert "temperature: 37 °C" in texts[1]
    assert texts[2:] == ["pressure, region: inner, pressure: unknown (cavity room)", "outer face"]

    pressure = {"effect": "pressure", "region": "inner", "pressure": 0.0}
    data = {"effects": [pressure], "cavities": {"room": room}}
    assert symbols(data, {}, boundary)[0]["label"] == "pressure on inner: found, in cavity room"
