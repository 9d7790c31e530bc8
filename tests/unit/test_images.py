"""Meshes of segmented images: volumes, regions, sizes, and what cannot be meshed."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvista
from helpers.imaging_cases import BALL, ball, grid, inside, meshed, volumes, written
from scipy import ndimage

from hpcinv.__main__ import main
from hpcinv.errors import JobError, MeshError
from hpcinv.geometry.imaging.clean_surfaces import _fill_touching_edges, _parts
from hpcinv.geometry.imaging.curved_cells import curved
from hpcinv.geometry.imaging.wall_sizes import wall_sizes
from hpcinv.mesh.cells import scalar_element
from hpcinv.mesh.checks import determinants
from hpcinv.mesh.crossing_facets import find_overlap
from hpcinv.mesh.source import MeshSource
from hpcinv.mesh.surface import surface_of

pytestmark = pytest.mark.usefixtures("warm_reader")


def area(source: MeshSource, name: str) -> float:
    (facets,) = (source.facets[group.members] for group in source.groups if group.name == name)
    a, b, c = (source.points[facets[:, i]] for i in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


@pytest.mark.release
def test_a_ball_has_its_volume_and_a_smooth_surface(tmp_path: Path) -> None:
    voxels, said = ball(), list[str]()
    source = meshed(written(tmp_path / "ball.nii.gz", voxels), said, size="3 mm")
    assert volumes(source)["ball"] == pytest.approx(voxels.sum() * 1e-9, rel=0.01)
    assert "ball: 4.22 ml" in "".join(said)
    # Steps of voxels would have 1.5 times the area of the sphere.
    assert area(source, "ball|outside") == pytest.approx(4 * np.pi * (BALL * 1e-3) ** 2, rel=0.1)
    (facets,) = (source.facets[g.members] for g in source.groups if g.dim == 2)
    radii = np.linalg.norm(source.points[np.unique(facets)] - 11.5e-3, axis=1)
    distances = abs(radii - BALL * 1e-3) * 1e3
    print(f"nodes are {distances.max():.2f} voxels from the sphere at most, {np.sqrt((distances**2).mean()):.2f} rms")
    assert distances.max() < 1  # voxels of a sphere are as far from it as 0.87 themselves
    assert np.sqrt((distances**2).mean()) < 0.4


@pytest.mark.release
def test_a_folded_surface_does_not_cross_itself(tmp_path: Path) -> None:
    """Five facets of folds like these cross at first; they are meshed again with cells between them."""
    noise = ndimage.gaussian_filter(np.random.default_rng(2).standard_normal((20, 20, 20)), 2.2, mode="constant")
    blobs, _ = ndimage.label(noise > np.quantile(noise, 0.6))
    largest = np.bincount(blobs.ravel())[1:].argmax() + 1
    body = np.pad((blobs == largest).astype(np.uint8), 2).transpose()
    source = meshed(written(tmp_path / "folds.mha", body), size="3.5 mm")
    assert find_overlap(surface_of(source)).pairs == 0
    assert volumes(source)["ball"] == pytest.approx(body.sum() * 1e-9, rel=0.01)


@pytest.mark.release
def test_signals_reach_a_run_after_its_image_was_meshed(tmp_path: Path) -> None:
    received = list[int]()
    before = signal.signal(signal.SIGTERM, lambda number, _frame: received.append(number))
    # A thread that an earlier command left would end this process in the next call of a library.
    thread = signal.set_wakeup_fd(-1)
    try:
        meshed(written(tmp_path / "ball.nii.gz", ball()), size="8 mm")
        os.kill(os.getpid(), signal.SIGTERM)
    finally:
        signal.set_wakeup_fd(thread, warn_on_full_buffer=False)
        signal.signal(signal.SIGTERM, before)
    assert received == [signal.SIGTERM]


def test_small_holes_and_parts_are_reported(tmp_path: Path) -> None:
    voxels, said = ball(), list[str]()
    voxels[8, 8, 8] = 0  # a hole
    voxels[12:17, 12:17, 12:17] = 2  # a nodule, and one that is too small for cells
    voxels[6:8, 12, 12] = 2
    image = written(tmp_path / "nodules.nii.gz", voxels)
    source = meshed(image, said, labels={"ball": 1, "nodule": 2})
    assert volumes(source)["nodule"] == pytest.approx(125e-9, rel=0.02)
    assert "1 hole of 1 mm^3 in all, smaller than a cell, filled" in said
    assert "nodule: 1 part of 2 mm^3 in all, too small for cells" in said
    assert any(line.startswith("scaled Jacobian of cells: 0.") for line in said)


def test_two_cells_in_thin_walls_and_separate_parts(tmp_path: Path) -> None:
    """Cells of more than twice the thickness of plates near to the border of the image."""
    voxels, said = np.zeros((24, 24, 24), dtype=np.uint8), list[str]()
    voxels[2:22, 2:22, 2:5] = voxels[2:22, 2:22, 14:17] = 1
    source = meshed(written(tmp_path / "plates.nii.gz", voxels), said, size="7 mm")
    assert {g.name for g in source.groups if g.dim == 2} == {"ball|outside"}
    on_boundary = np.isin(np.arange(len(source.points)), source.facets)
    assert not on_boundary[source.cells].all(axis=1).any()
    assert "the body has 2 parts that share no facet: each needs supports" in said


def lengths_of_edges(source: MeshSource) -> np.ndarray:
    corners = source.points[source.cells]
    ends = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    return np.concatenate([np.linalg.norm(corners[:, i] - corners[:, j], axis=1) for i, j in ends])


@pytest.mark.release
def test_sizes_are_graded_to_thin_walls(tmp_path: Path) -> None:
    """A hollow ball with a wall of 3 mm in cells of up to 5 mm."""
    radii, said = np.linalg.norm(grid(), axis=-1), list[str]()
    image = written(tmp_path / "shell.nii.gz", ((radii < 10.5) & (radii > 7.5)).astype(np.uint8))
    graded = meshed(image, said, size="5 mm", grade=4)
    assert any(
        re.search(r", graded to walls of down to (2\.[89]|3)\S* mm at 100% of the surface", line) for line in said
    )
    assert not any("too thin for two cells" in line for line in said)
    said.clear()
    uniform = meshed(image, said, size="5 mm", grade=1)
    assert any("100% of the surface is at walls too thin for two cells of 5 mm" in line for line in said)
    for source in (graded, uniform):
        assert volumes(source)["ball"] == pytest.approx(4 / 3 * np.pi * (10.5**3 - 7.5**3) * 1e-9, rel=0.03)
        on_boundary = np.isin(np.arange(len(source.points)), source.facets)
        assert not on_boundary[source.cells].all(axis=1).any()  # two cells through the wall
    assert np.median(lengths_of_edges(graded)) < 0.75 * np.median(lengths_of_edges(uniform))
    with pytest.raises(JobError, match=r"mesh\.grade"):
        meshed(image, grade=0.5)


def test_sizes_are_chosen_without_too_many_cells() -> None:
    radii, voxel = np.linalg.norm(grid(), axis=-1), np.ones(3)
    shell = np.pad((radii < 10.5) & (radii > 7.5), 3).astype(np.int64)
    walls = [wall_sizes(shell, voxel, 1, size, ratio) for size, ratio in ((2.5, None), (8.0, None), (8.0, 10.0))]
    assert walls[0].thinnest == pytest.approx(3, abs=0.3)
    assert walls[0].floor == pytest.approx(2.5 / 4)
    assert 8 / 2.2 < walls[1].floor < 8 / 1.5  # with four times as many cells
    assert walls[2].floor == pytest.approx(0.8)
    assert walls[2].interpolate(np.array([[14.5 + 9, 14.5, 14.5]])) == pytest.approx([1.8], abs=0.4)
    ball = wall_sizes(np.pad((radii < 10.5).astype(np.int64), 3), voxel, 1, 4.0, None)
    assert not ball.is_graded
    assert ball.interpolate(np.zeros((2, 3))).tolist() == [4.0, 4.0]


def test_a_large_image_has_samples_that_stand_for_all(monkeypatch: pytest.MonkeyPatch) -> None:
    shell = np.pad(np.linalg.norm(grid(), axis=-1) < 10.5, 3).astype(np.int64)
    whole = wall_sizes(shell, np.ones(3), 1, 2.5, None)
    monkeypatch.setattr("hpcinv.geometry.imaging.wall_sizes._MOST_SAMPLES", 500)
    some = wall_sizes(shell, np.ones(3), 1, 2.5, None)
    assert len(some.points) == 500 < len(whole.points) / 2
    assert some.floor == pytest.approx(whole.floor, rel=0.1)
    assert np.median(some.thickness) == pytest.approx(np.median(whole.thickness), rel=0.1)


@pytest.mark.release
def test_labels_that_touch_share_their_facets(tmp_path: Path) -> None:
    """A core in a ball, both cut by the image's border."""
    radii = np.linalg.norm(grid(), axis=-1)
    voxels = np.where(radii < 5, 7, np.where(radii < BALL, 2, 0)).astype(np.uint8)[:, :, 12:]
    image = written(tmp_path / "shells.nii.gz", voxels)
    source = meshed(image, labels={"shell": 2, "core": 7}, size="3 mm")
    region_volumes = volumes(source)
    assert region_volumes["core"] == pytest.approx((voxels == 7).sum() * 1e-9, rel=0.01)
    assert region_volumes["shell"] == pytest.approx((voxels == 2).sum() * 1e-9, rel=0.01)
    assert {g.name for g in source.groups if g.dim == 2} == {"shell|outside", "shell|core", "cut"}
    assert area(source, "shell|core") == pytest.approx(2 * np.pi * 25e-6, rel=0.1)
    assert area(source, "cut") == pytest.approx(np.pi * 100e-6, rel=0.1)


def test_cavities_and_neighbours_are_regions(tmp_path: Path) -> None:
    """A wall around blood, with a closed cavity next to it and a bone next to the outer surface."""
    radii = np.linalg.norm(grid(30), axis=-1)
    x = grid(30)[..., 0]
    voxels = np.where(radii < 6, 7, np.where(radii < 13, 1, 0)).astype(np.uint8)
    voxels[(radii > 12) & (x > 8)] = 9
    image = written(tmp_path / "heart.nii.gz", voxels)
    spec = {"labels": {"wall": 1}, "neighbours": {"bone": 9}, "size": "4 mm"}
    mesh_read = meshed(image, **spec)
    assert {g.name for g in mesh_read.groups} == {"wall", "wall|outside", "wall|cavity", "wall|bone"}
    assert area(mesh_read, "wall|cavity") == pytest.approx(4 * np.pi * 36e-6, rel=0.15)
    bone = mesh_read.points[mesh_read.facets[next(g.members for g in mesh_read.groups if g.name == "wall|bone")]]
    assert bone[..., 0].min() * 1e3 - 14.5 > 3  # 8 less two and a half voxels, and less half a cell
    mesh_read = meshed(image, **spec | {"neighbours": {"blood": 7, "bone": 9}})
    assert {g.name for g in mesh_read.groups} == {"wall", "wall|outside", "wall|blood", "wall|bone"}
    with pytest.raises(MeshError, match="no voxel has the label 3"):
        meshed(image, **spec | {"neighbours": {"blood": 3}})
    with pytest.raises(JobError, match=r"mesh\.neighbours\.blood: has the number 1, which 'wall' has too"):
        meshed(image, **spec | {"neighbours": {"blood": 1}})
    voxels[0, 0, 0] = 4
    share = r"\(at \d?\d% of"
    message = rf"neighbour 'far' is nowhere within .*\n.*labels next to the body: 7 {share} its surface\), 9 {share}"
    with pytest.raises(MeshError, match=message):
        meshed(written(tmp_path / "far.nii.gz", voxels), **spec | {"neighbours": {"far": 4}})


def test_all_labels_are_listed_with_their_volumes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    voxels = np.zeros((41, 10, 10), dtype=np.uint8)
    for label in range(1, 42):
        voxels[label - 1].flat[: label * 2] = label
    image = written(tmp_path / "many.nii.gz", voxels, (2, 1, 1))
    with pytest.raises(MeshError) as refused:
        meshed(image, labels={"ball": 99})
    every = ", ".join(f"{label} ({4 * label} mm^3)" for label in range(1, 42))
    assert f"the labels in it are {every}" in str(refused.value)
    for arguments in ([], ["--label", ""], ["--label", "ball=1"], [str(tmp_path / "b.msh"), "--size", "4 mm"]):
        assert main(["mesh", "from-image", str(image), *arguments]) == 2
        text = capsys.readouterr().err
        assert every in text
        assert "such as: hpcinv mesh from-image" in text.lower()


@pytest.mark.release
def test_a_neighbour_behind_a_thin_wall_is_not_next_to_its_other_side(tmp_path: Path) -> None:
    radii = np.linalg.norm(grid(30), axis=-1)
    voxels = np.where(radii < 9.5, 7, np.where(radii < 12, 1, 0)).astype(np.uint8)
    image = written(tmp_path / "vessel.nii.gz", voxels)
    mesh_read = meshed(image, labels={"wall": 1}, neighbours={"blood": 7}, size="5 mm")
    assert area(mesh_read, "wall|blood") == pytest.approx(4 * np.pi * 9.5e-3**2, rel=0.15)
    assert area(mesh_read, "wall|outside") == pytest.approx(4 * np.pi * 12e-3**2, rel=0.15)


def test_islands_are_left_out_and_reported(tmp_path: Path) -> None:
    voxels, said = ball(), list[str]()
    voxels[0:2, 0, 0] = 1
    assert volumes(meshed(written(tmp_path / "islands.nii.gz", voxels), said))["ball"] > 0
    assert said[0] == "1 island of 2 mm^3 in all left out"


def one_voxel() -> np.ndarray:
    voxels = ball() * 0
    voxels[12, 12, 12] = 1
    return voxels


def thin_wall() -> np.ndarray:
    voxels = ball() * 0
    voxels[4:20, 4:20, 12] = 1
    return voxels


def many_islands() -> np.ndarray:
    """A block of 1000 voxels and eight ones of 8."""
    voxels = ball() * 0
    voxels[:10, :10, :10] = 1
    for i, j, k in np.ndindex(2, 2, 2):
        voxels[14 + 4 * i : 16 + 4 * i, 14 + 4 * j : 16 + 4 * j, 14 + 4 * k : 16 + 4 * k] = 1
    return voxels


@pytest.mark.parametrize(
    ("voxels", "fault"),
    [
        (lambda: ball() * 2, "no voxel has the label 1 ('ball'); the labels in it are 2"),
        (one_voxel, "too small or thin for cells of 4 mm"),
        (thin_wall, "100% of the label 'ball' is in walls of less than two voxels"),
        (lambda: ball() * (np.indices((24, 24, 24)).sum(axis=0) % 2), "in walls of less than two voxels"),
        (many_islands, "of the label 'ball' is in 8 islands"),
        (lambda: ball() * np.float32(0.5), "its values are not whole numbers"),
        (
            lambda: np.arange(3000).reshape(10, 15, 20) - 99,
            "has 3,000 different values, from -99 to 2,900, as a scan has",
        ),
    ],
)
def test_unmeshable_images_are_reported(voxels: Callable[[], np.ndarray], fault: str, tmp_path: Path) -> None:
    with pytest.raises(MeshError) as text:
        meshed(written(tmp_path / "image.nii.gz", voxels()))
    assert fault in str(text.value)


def test_labels_that_touch_in_edges_only_are_joined_before_they_are_filled() -> None:
    """Cubes of one label side by side, over an edge, and in a corner; two labels in turn stay."""
    labels = np.zeros((6, 6, 6), dtype=np.int64)
    labels[1, 1, 1] = labels[2, 2, 1] = labels[4, 4, 3] = labels[4, 4, 4] = 1
    joined = _fill_touching_edges(labels)
    assert joined.sum() == labels.sum() + 1
    assert joined[1, 2, 1] + joined[2, 1, 1] == 1
    assert np.array_equal(_fill_touching_edges(joined), joined)
    parts, label_of = _parts(np.where(np.indices((4, 4, 4)).sum(axis=0) % 2, 1, 2))
    assert len(label_of) == 65
    assert np.array_equal(np.unique(parts), np.arange(1, 65))


@pytest.mark.everyday("apart")
@pytest.mark.parametrize("voxels", ["touching", "apart", "nested"])
def test_only_clean_surfaces_are_filled(voxels: str, tmp_path: Path) -> None:
    """The rest is meshed from a lattice, and the log says why."""
    x, radii, said = grid()[..., 0], np.linalg.norm(grid(), axis=-1), list[str]()
    labels = {
        "touching": np.where(x < 0, 1, 2),  # which meet along a circle on the outside
        "apart": np.where(x < -2, 1, np.where(x > 2, 2, 0)),
        "nested": np.where(radii < 6, 2, 1),
    }[voxels]
    image = written(tmp_path / "image.nii.gz", (labels * (radii < BALL)).astype(np.uint8))
    source = meshed(image, said, labels={"one": 1, "two": 2})
    region_volumes = volumes(source)
    assert region_volumes["one"] == pytest.approx(((labels == 1) & (radii < BALL)).sum() * 1e-9, rel=0.01)
    assert region_volumes["two"] == pytest.approx(((labels == 2) & (radii < BALL)).sum() * 1e-9, rel=0.01)
    is_told = any("labels meet along curves or in points: meshed from a lattice" in line for line in said)
    assert is_told == (voxels == "touching")


@pytest.mark.release
def test_smaller_sizes_make_more_cells_of_a_lattice(tmp_path: Path) -> None:
    """Halves that meet along a circle on the outside."""
    points = grid(16) - 0.2
    labels = np.where(points[..., 0] < 0, 1, 2) * (np.linalg.norm(points, axis=-1) < 6.4)
    image = written(tmp_path / "image.nii.gz", labels.astype(np.uint8), (5, 5, 5))
    counts = [len(meshed(image, labels={"one": 1, "two": 2}, size=f"{size} mm").cells) for size in (36, 28)]
    assert counts == sorted(set(counts))


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({"labels": {}}, "mesh.labels: is needed"),
        ({"size": None}, "mesh.size: is needed"),
        ({"labels": {"ball": 0}}, "mesh.labels"),
        ({"file": "ball.msh"}, "mesh.image: is given together with 'file'"),
        ({"maximum_cells": 10}, "more than 10"),
        ({"labels": {"cut": 1}}, "mesh.labels.cut: is the name of another region"),
        ({"labels": {"ball": 1, "core": [2, 1]}}, "mesh.labels.core: has the number 1, which 'ball' has too"),
    ],
)
def test_bad_sections_are_reported(changes: dict[str, Any], fault: str, tmp_path: Path) -> None:
    with pytest.raises((JobError, MeshError)) as text:
        meshed(written(tmp_path / "ball.nii.gz", ball()), **changes)
    assert fault in str(text.value)


def beside_sphere(source: MeshSource, middle: list[float], degree: int) -> np.ndarray:
    """Distances (m) of middles of facets and of their edges from the sphere; of degree 1, straight ones."""
    at = np.array([[1 / 3, 1 / 3], [0.5, 0.5], [0.5, 0], [0, 0.5]])
    shapes = scalar_element("triangle", degree).tabulate(0, at)[0, :, :, 0]
    places = shapes @ source.points[source.facets[:, : shapes.shape[1]]] - np.array(middle) * 1e-3
    return np.asarray(np.linalg.norm(places, axis=2) - BALL * 1e-3)


def test_curved_cells_are_nearer_to_the_true_surface(tmp_path: Path) -> None:
    pyvista.Sphere(radius=BALL, theta_resolution=60, phi_resolution=60).save(tmp_path / "ball.stl")
    voxels, said = (np.linalg.norm(grid(30) * BALL / 13.5, axis=-1) < BALL).astype(np.uint8), list[str]()
    image, spec = written(tmp_path / "ball.nii.gz", voxels, (BALL / 13.5,) * 3), {"size": "6.5 mm"}
    middle = [14.5 * BALL / 13.5] * 3
    # The volume of the voxels differs from the ball's: the mean distance does not count.
    source = meshed(image, said, geometry_degree=2, **spec)
    straight, bent = (beside_sphere(source, middle, degree).std() for degree in (1, 2))
    print(f"voxels: {straight:.3g} m, curved {bent:.3g} m")
    assert bent < 0.85 * straight
    text = [line for line in said if line.startswith("cells of second degree: ")]
    assert len(text) == 1
    assert "held back for the shape of cells" in text[0]
    source = inside(tmp_path / "ball.stl", geometry_degree=2)
    straight, bent = (beside_sphere(source, [0, 0, 0], degree).std() for degree in (1, 2))
    print(f"triangles: {straight:.3g} m, curved {bent:.3g} m")
    assert bent < 0.2 * straight


def test_nodes_are_held_back_where_cells_would_be_inverted() -> None:
    """A boundary that is a cell's size away from the middles of edges."""
    source = MeshSource(
        path=Path("cell"),
        kind="tetrahedron",
        degree=1,
        points=np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        node_tags=np.arange(1, 5),
        cells=np.array([[0, 1, 2, 3]]),
        cell_tags=np.array([1]),
        facets=np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]),
    )

    class Inside:
        def nearest(self, points: np.ndarray, inner: Any, outer: Any, reach: float) -> tuple[np.ndarray, np.ndarray]:
            is_corner = (np.sort(points, axis=1)[:, :2] == 0).all(axis=1) & (points.max(axis=1) != 0.5)
            return np.where(is_corner[:, None], points, 0.3), np.zeros_like(points)

    said = list[str]()
    pairs = np.tile([0, 1], (4, 1))
    mesh, _ = curved(source, np.ones(1, dtype=np.int64), pairs, Inside(), 1.0, [1 / 6], 0.1, said.append)
    assert determinants(mesh)[0].min() > 0
    assert "6 nodes between vertices" in said[0]
    assert "; 6 held back" in said[0]


def test_jobs_on_images_run_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image, mesh = written(tmp_path / "ball.nii.gz", ball()), tmp_path / "ball.vtu"
    assert main(["mesh", "from-image", str(image), str(mesh), "--label", "ball=1", "--size", "4 mm"]) == 0
    assert "ball|outside" in capsys.readouterr().out
    assert mesh.exists()
    assert main(["mesh", "from-image", str(image), str(mesh), "--label", "ball=one", "--size", "4 mm"]) == 2
    assert "--label ball=one: is written NAME=NUMBER" in capsys.readouterr().err
