"""Bodies that closed surfaces bound, and surfaces that bound none."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvista
from helpers.imaging_cases import HELD, JOB, inside, volumes

from hpcinv.errors import JobError, MeshError
from hpcinv.geometry.imaging.mesh_report import report_distance
from hpcinv.job.job import parse
from hpcinv.mesh.body import read_source
from hpcinv.mesh.checks import check
from hpcinv.mesh.source import MeshSource

pytestmark = pytest.mark.usefixtures("warm_reader")


@pytest.mark.everyday(".stl", ".obj")  # that each format is read: test_damaged_scans.py
@pytest.mark.parametrize("ending", [".stl", ".ply", ".obj", ".vtp", ".vtk"])
def test_a_surface_keeps_its_place_and_volume(ending: str, tmp_path: Path) -> None:
    surface = pyvista.Sphere(radius=10, center=(100, -20, 3), theta_resolution=30, phi_resolution=30)
    if ending == ".stl":
        surface = surface.flip_faces()  # inside out
    surface.save(tmp_path / f"ball{ending}")
    source = inside(tmp_path / f"ball{ending}")
    assert volumes(source)["body"] == pytest.approx(abs(surface.volume) * 1e-9, rel=0.01)
    assert [g.name for g in source.groups] == ["body", "body|outside"]
    radii = np.linalg.norm(source.points - np.array([100, -20, 3]) * 1e-3, axis=1)
    assert radii.max() == pytest.approx(10e-3, rel=0.05)


def test_the_distance_from_given_triangles_is_reported() -> None:
    """A regular tetrahedron that is 10 % larger than its triangles: 0.1 of its circumradius √3 m."""
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=float)
    facets = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    triangles = pyvista.PolyData.from_regular_faces(corners, facets)
    cells, one = np.arange(4)[None], np.ones(1, dtype=np.int64)
    mesh = MeshSource(Path("body.stl"), "tetrahedron", 1, 1.1 * corners, np.arange(4), cells, one, facets, ())
    said: list[str] = []
    report_distance(mesh, triangles, said.append)
    assert said[0].startswith("facets are up to 173 mm from the triangles of the file")
    assert "a smaller mesh.size is closer" in said[0]
    report_distance(replace(mesh, points=corners), triangles, said.append)
    assert "smaller" not in said[1]


def cubes() -> pyvista.PolyData:
    """Two that touch, with their walls between them."""
    return cube(0).append_polydata(cube(10))


def cube(left: float) -> pyvista.PolyData:
    return pyvista.Cube(bounds=(left, left + 10, 0, 10, 0, 10)).triangulate()


def over_an_edge() -> pyvista.PolyData:
    """Two that touch in an edge, which has four triangles."""
    return cube(0).append_polydata(cube(10).translate((0, 10, 0)))


def twice() -> pyvista.PolyData:
    return cube(0).append_polydata(cube(0))


def inside_each_other() -> pyvista.PolyData:
    return pyvista.Sphere(radius=10).append_polydata(pyvista.Sphere(radius=5))


@pytest.mark.everyday("cubes-2000")
@pytest.mark.parametrize(
    ("surface", "volume"), [(cubes, 2000), (over_an_edge, 2000), (twice, 1000), (inside_each_other, 3600)]
)
def test_surfaces_of_several_shells(surface: Callable[[], pyvista.PolyData], volume: float, tmp_path: Path) -> None:
    surface().save(tmp_path / "body.stl")
    assert volumes(inside(tmp_path / "body.stl"))["body"] == pytest.approx(volume * 1e-9, rel=0.02)


@pytest.mark.release
def test_thin_walls_between_surfaces_are_meshed_in_large_cells(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """A wall of 0.3 mm in cells of up to 1.5 mm."""
    pyvista.Sphere(radius=2, theta_resolution=40, phi_resolution=40).save(tmp_path / "outer.stl")
    pyvista.Sphere(radius=1.7, theta_resolution=40, phi_resolution=40).save(tmp_path / "inner.stl")
    mesh = {"surfaces": {"wall": ["outer.stl", "inner.stl"]}, "unit": "mm", "size": "1.5 mm"}
    job = parse({**JOB, "mesh": mesh, "supports": [HELD]}, tmp_path / "job.yaml")
    source = read_source(job.mesh, tmp_path / job.mesh.file)
    check(source)
    assert volumes(source)["wall"] == pytest.approx(4 / 3 * np.pi * (2**3 - 1.7**3) * 1e-9, rel=0.03)
    assert {g.name for g in source.groups} == {"wall", "wall|outside", "wall|cavity"}
    assert capfd.readouterr() == ("", "")


def test_several_surfaces(tmp_path: Path) -> None:
    """A wall between two spheres, and a core of another material in it next to a cavity."""
    for name, radius in (("outer", 10), ("inner", 6), ("core", 3)):
        pyvista.Sphere(radius=radius, theta_resolution=40, phi_resolution=40).save(tmp_path / f"{name}.stl")

    def volume(radius: float) -> float:
        return 4 / 3 * np.pi * radius**3 * 1e-9

    def of(surfaces: dict[str, Any]) -> MeshSource:
        mesh = {"surfaces": surfaces, "unit": "mm", "size": "4 mm"}
        job = parse({**JOB, "mesh": mesh, "supports": [HELD]}, tmp_path / "job.yaml")
        assert job.mesh.files == tuple(file for files in surfaces.values() for file in np.atleast_1d(files))
        source = read_source(job.mesh, tmp_path / job.mesh.file)
        check(source)
        return source

    shell = of({"wall": ["outer.stl", "inner.stl"]})
    assert volumes(shell)["wall"] == pytest.approx(volume(10) - volume(6), rel=0.02)
    assert {g.name for g in shell.groups} == {"wall", "wall|outside", "wall|cavity"}
    filled = of({"core": "inner.stl", "wall": "outer.stl"})
    assert volumes(filled)["core"] == pytest.approx(volume(6), rel=0.02)
    assert volumes(filled)["wall"] == pytest.approx(volume(10) - volume(6), rel=0.02)
    assert {g.name for g in filled.groups} == {"core", "wall", "wall|outside", "core|wall"}
    pyvista.Sphere(radius=6, center=(9, 0, 0)).save(tmp_path / "beside.stl")
    with pytest.raises(MeshError, match="'wall' and 'other' cut each other"):
        of({"wall": "outer.stl", "other": "beside.stl"})
    with pytest.raises(JobError, match=r"mesh\.surfaces\.wall: there is no file"):
        of({"core": "core.stl", "wall": "nowhere.stl"})
    with pytest.raises(JobError, match=r"mesh\.surfaces\.wall: there is no file") as refused:
        of({"wall": "nowhere.stl"})
    assert str(refused.value).count("there is no file") == 1


def half() -> pyvista.PolyData:
    return pyvista.Sphere(radius=10).clip("z")


def crossing() -> pyvista.PolyData:
    return pyvista.merge([pyvista.Sphere(radius=10), pyvista.Sphere(radius=10, center=(8, 0, 0))], merge_points=False)


@pytest.mark.parametrize(
    ("surface", "mesh", "fault"),
    [
        (half, {}, "the surface is open: "),
        (crossing, {}, "Mend the surface where it cuts itself"),
        (pyvista.Sphere, {"size": "1 um", "unit": "m"}, "is too large for cells of 1 µm"),
        (pyvista.Sphere, {"unit": None}, "mesh.unit"),
        (pyvista.Sphere, {"labels": {"body": 1}}, "mesh.labels: is for segmented images only"),
    ],
)
def test_surfaces_that_cannot_be_meshed_are_reported(
    surface: Callable[[], pyvista.PolyData], mesh: dict[str, Any], fault: str, tmp_path: Path
) -> None:
    made = surface()
    (made if isinstance(made, pyvista.PolyData) else made.extract_surface(algorithm=None)).save(tmp_path / "body.stl")
    with pytest.raises((JobError, MeshError)) as text:
        inside(tmp_path / "body.stl", **mesh)
    assert fault in str(text.value)


def test_an_open_surface_is_refused_with_a_place_of_its_hole(tmp_path: Path) -> None:
    """A tetrahedron without the side x + y + z = 1."""
    points = np.vstack([np.zeros(3), np.eye(3)])
    pyvista.PolyData.from_regular_faces(points, [[0, 2, 1], [0, 1, 3], [0, 3, 2]]).save(tmp_path / "body.stl")
    with pytest.raises(MeshError) as text:
        inside(tmp_path / "body.stl")
    middles = r"(0, 0\.5, 0\.5|0\.5, 0, 0\.5|0\.5, 0\.5, 0)"
    assert re.search(rf"is open: 3 edges .* first at \({middles}\)", str(text.value))


def test_labels_of_a_mesh_file_are_refused(tmp_path: Path) -> None:
    mesh = {"file": str(Path(__file__).parents[2] / "meshes" / "box.py"), "labels": {"box": 1}}
    with pytest.raises(JobError, match=r"mesh\.labels: is for segmented images only"):
        parse(
            {**JOB, "mesh": mesh, "supports": [{"region": "boundary", "fix": ["x", "y", "z"]}]}, tmp_path / "job.yaml"
        )
