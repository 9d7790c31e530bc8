"""Walls around the lumen of a vessel: volumes against closed forms, flat ends, thickness, branches, refusals, a job."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvista
from helpers.schemas import refusals

import hpcinv as package
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import JobError, MeshError
from hpcinv.geometry.vessels.flat_ends import without_caps
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.job.yaml_reader import read_yaml
from hpcinv.mesh import read_source
from hpcinv.mesh.checks import check
from hpcinv.mesh.source import Floats, MeshSource

pytestmark = pytest.mark.usefixtures("warm_reader")

ROOT = Path(__file__).parents[2]
TUBE = "x, y, z, radius\n0, 0, 0, 10\n0, 0, 50, 10\n"
TOP = {"at": ["0 mm", "0 mm", "50 mm"]}
CUT = {"at": ["0 mm", "0 mm", "6 mm"], "normal": [0, 0, 1]}


@pytest.fixture(scope="module")
def lumens(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Directory with lumens of all kinds."""
    place = tmp_path_factory.mktemp("lumens")
    (place / "tube.csv").write_text(TUBE)
    angles = np.linspace(0, 2.5, 30)
    bend = np.column_stack([12 * np.cos(angles), 12 * np.sin(angles), 0 * angles, 10 + 0 * angles])
    (place / "bend.csv").write_text("\n".join(",".join(map(str, row)) for row in bend))
    pyvista.Cylinder(radius=8, height=60, direction=(0, 0, 1), resolution=40).triangulate().save(place / "capped.stl")
    pipe = pyvista.Cylinder(radius=8, height=60, direction=(0, 0, 1), resolution=40, capping=False).triangulate()
    pipe = pipe.clean()
    pipe.save(place / "open.ply")
    points = np.array(pipe.points)
    points[:, 2] += np.where(points[:, 2] > 20, 4 * np.sin(2 * np.arctan2(points[:, 1], points[:, 0])), 0)
    pyvista.PolyData(points, faces=pipe.faces).save(place / "warped.ply")
    pipe.flip_faces(inplace=True)
    pipe.save(place / "inward.ply")
    pyvista.Sphere(radius=10, theta_resolution=30, phi_resolution=30).save(place / "ball.stl")
    grid = pyvista.ImageData(dimensions=(24, 24, 40), spacing=(1, 1, 1))
    x, _, z = np.meshgrid(*(np.arange(n) - 12.0 for n in grid.dimensions), indexing="ij")
    y = np.arange(24)[None, :, None] - 12.0
    inside = (x**2 + y**2 < 49) & (z > -4)  # from a plane inside the image to its border
    grid.point_data["label"] = inside.astype(np.uint8).ravel(order="F")
    grid.save(place / "scan.vti")
    return place


def read(path: Path, **more: Any) -> MeshSource:
    unit = {} if path.suffix == ".vti" else {"unit": "mm"}
    data = {"lumen": path.name, "wall": "1.5 mm", "size": "4 mm", **unit} | more
    spec = MeshSpec.model_validate(data, context={"directory": path.parent, "untrusted": False})
    source = read_source(spec, path)
    check(source)
    return source


def facets(source: MeshSource, name: str) -> Floats:
    """Corners (n, 3, 3) in mm of the facets of a region."""
    (group,) = (group for group in source.groups if group.name == name and group.dim == 2)
    return source.points[source.facets[group.members, :3]] * 1e3


def area(corners: Floats) -> float:
    a, b, c = corners.transpose(1, 0, 2)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def volume(source: MeshSource) -> float:
    a, b, c, d = (source.points[source.cells[:, i]] * 1e3 for i in range(4))
    return float(np.abs(np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a)).sum() / 6)


def test_a_surface_of_flat_parts_alone_has_no_caps() -> None:
    box, ball = pyvista.Cube().triangulate().clean(), pyvista.Sphere()
    assert without_caps(box).n_cells == box.n_cells == 12
    assert without_caps(ball).n_cells == ball.n_cells
    assert without_caps(pyvista.Cylinder(resolution=40).triangulate().clean()).n_cells == 80


def test_a_tube_has_its_wall_and_flat_ends(lumens: Path) -> None:
    source = read(lumens / "tube.csv", ends={"outlet": TOP}, geometry_degree=2)
    assert {group.name for group in source.groups} == {"wall", "inner", "outer", "outlet", "end-1"}
    assert volume(source) == pytest.approx(pi * (11.5**2 - 10**2) * 50, rel=0.03)
    assert np.allclose(facets(source, "outlet")[..., 2], 50, atol=1e-9)
    assert np.allclose(facets(source, "end-1")[..., 2], 0, atol=1e-9)
    radii = {name: np.linalg.norm(facets(source, name)[..., :2], axis=2) for name in ("inner", "outer")}
    assert radii["inner"] == pytest.approx(10, abs=0.1)
    assert radii["outer"] == pytest.approx(11.5, abs=0.1)


def test_a_wall_follows_a_table_from_its_first_end(lumens: Path) -> None:
    wall = {"distance": ["0 mm", "50 mm"], "thickness": ["2 mm", "1 mm"]}
    outer = facets(read(lumens / "tube.csv", wall=wall, ends={"outlet": TOP}, layers=1), "outer")
    thickness = np.linalg.norm(outer[..., :2], axis=2) - 10
    assert thickness == pytest.approx(2 - (50 - outer[..., 2]) / 50, abs=0.1)


@pytest.mark.everyday("capped.stl", "inward.ply")
@pytest.mark.parametrize("file", ["capped.stl", "open.ply", "inward.ply"])
def test_surfaces_with_caps_or_openings_give_the_same_wall(file: str, lumens: Path) -> None:
    source = read(lumens / file)
    assert {group.name for group in source.groups} == {"wall", "inner", "outer", "end-1", "end-2"}
    assert volume(source) == pytest.approx(pi * (9.5**2 - 8**2) * 60, rel=0.03)
    assert area(facets(source, "end-1")) == pytest.approx(pi * (9.5**2 - 8**2), rel=0.03)


def test_an_image_ends_at_its_border_and_where_voxels_do(lumens: Path) -> None:
    source = read(lumens / "scan.vti", labels={"blood": 1})
    planes = sorted(float(facets(source, name)[..., 2].mean()) for name in ("end-1", "end-2"))
    assert planes == pytest.approx([8.5, 39.5], abs=1e-6)
    assert volume(source) == pytest.approx(pi * (8.5**2 - 7**2) * 31, rel=0.06)


@pytest.mark.parametrize(
    ("file", "more", "text"),
    [
        ("bend.csv", {"wall": "4 mm"}, "thicker than the radius of curvature"),
        ("warped.ply", {}, "is not flat: it is up to 4 mm from a plane"),
        ("ball.stl", {}, "has no flat end"),
        ("ball.stl", {"ends": {"top": CUT | {"at": ["0 mm", "0 mm", "16 mm"]}}}, "does not cut the lumen"),
        ("tube.csv", {"ends": {"low": TOP, "top": TOP}}, "are the same end"),
        ("tube.csv", {"ends": {"low": {"at": ["0 mm", "90 mm", "0 mm"]}}}, "no flat end near the point of 'low'"),
        ("tube.csv", {"maximum_cells": 100}, "mesh.maximum_cells"),
    ],
)
def test_faulty_vessels_are_refused(file: str, more: Mapping[str, Any], text: str, lumens: Path) -> None:
    with pytest.raises(MeshError, match=text):
        read(lumens / file, **more)


@pytest.mark.everyday("ball.stl")
@pytest.mark.parametrize("file", ["ball.stl", "warped.ply"])
def test_a_plane_makes_an_end(file: str, lumens: Path) -> None:
    assert np.allclose(facets(read(lumens / file, ends={"top": CUT}), "top")[..., 2], 6, atol=1e-9)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("", "has no points"),
        ("0,0,0,1\n0,0,1,-1\n", "line 2: the radius must be above 0"),
        ("0,0,0,1\n0,0,1\n", "line 2: has 3 entries"),
        ("0,0,0,1\n0,0,0,1\n", "fewer than two distinct points"),
        ("x,y,z,r\n0,0,0,1\n0,0,1e9,1\n", "is long for its radius"),
        ("x,y,z,r\n0,0,0,1\n0,zero,1,1\n", "line 3: 'zero' is not a number"),
        ("\1\2\3", "is not a text file"),
    ],
)
def test_damaged_centrelines_are_refused(text: str, fault: str, tmp_path: Path) -> None:
    (tmp_path / "line.csv").write_text(text)
    with pytest.raises(MeshError, match=fault):
        read(tmp_path / "line.csv")


@pytest.mark.parametrize(
    ("mesh", "key", "text"),
    [
        ({"wall": None}, "wall", "is needed"),
        ({"wall": {"distance": [0, 1], "thickness": [1]}}, "wall.thickness", "one at each distance"),
        ({"wall": {"distance": [1, 0], "thickness": [1, 1]}}, "wall.distance", "must increase"),
        ({"wall": "-1 mm"}, "wall.thickness[0]", "above 0"),
        ({"ends": "closed"}, "ends", "must be 'open'"),
        ({"ends": {"inner": TOP}}, "ends.inner", "another region"),
        ({"ends": {"top": TOP | {"normal": [0, 0, 0]}}}, "ends.top.normal", "must not be zero"),
        ({"unit": None}, "unit", "is needed"),
        ({"labels": {"blood": 1}}, "labels", "for segmented images only"),
        ({"lumen": str(ROOT / "meshes/block.geo")}, "lumen", "must be an image"),
    ],
)
def test_contradictions_are_reported(mesh: Mapping[str, Any], key: str, text: str, tmp_path: Path) -> None:
    (tmp_path / "tube.csv").write_text(TUBE)
    whole = {"lumen": str(tmp_path / "tube.csv"), "wall": "1 mm", "size": "4 mm", "unit": "mm"} | mesh
    given = {name: value for name, value in whole.items() if value is not None}
    with pytest.raises(JobError) as refused:
        package.load({"mesh": given, "material": {"law": "neo-hookean", "young": 1, "poisson": 0.3}})
    assert f"mesh.{key}: " in str(refused.value)
    assert text in str(refused.value)


def test_a_bifurcation_with_fibres_is_unloaded(comm: MPI.Intracomm) -> None:
    data = dict(read_yaml(ROOT / "jobs" / "carotid.yaml"))
    data["mesh"] |= {"lumen": str(ROOT / "meshes" / "carotid.csv"), "size": "6 mm", "layers": 1}
    assert not refusals(data)
    result = package.run(package.load(data | {"certificate": "quick"}), comm)
    assert result.quantities["widening"] == pytest.approx(1.03e-3, rel=0.2)
    assert result.certificate.verdict.value == "pass"
