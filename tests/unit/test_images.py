"""Meshes of segmented images and closed surfaces: volumes, frames, regions, and what cannot be meshed."""

from __future__ import annotations

import gzip
import os
import re
import signal
import struct
import tracemalloc
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvista
from scipy import ndimage

from hpcinv.__main__ import main
from hpcinv.errors import JobError, MeshError
from hpcinv.job.job import parse
from hpcinv.mesh.body import read_source
from hpcinv.mesh.cells import scalar_element
from hpcinv.mesh.checks import check, determinants
from hpcinv.mesh.crossing_facets import find_overlap
from hpcinv.mesh.imaging.clean_surfaces import _fill_touching_edges, _parts
from hpcinv.mesh.imaging.curved_cells import curved
from hpcinv.mesh.imaging.label_image import read_labels
from hpcinv.mesh.imaging.mesh_report import report_distance
from hpcinv.mesh.imaging.wall_sizes import wall_sizes
from hpcinv.mesh.io import isolated
from hpcinv.mesh.source import MeshSource
from hpcinv.mesh.surface import surface_of

SimpleITK = pytest.importorskip("SimpleITK")

JOB: Mapping[str, Any] = {"material": {"law": "neo-hookean", "young": "5 kPa", "poisson": 0.4}}
HELD = {"region": "boundary", "fix": ["x", "y", "z"]}
BALL = 10.0  # mm


def grid(count: int = 24) -> np.ndarray:
    """Middles of voxels of 1 mm, with the origin in the middle of the image; last axis x, y, z."""
    axis = np.arange(count) - (count - 1) / 2
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)


def ball() -> np.ndarray:
    return (np.linalg.norm(grid(), axis=-1) < BALL).astype(np.uint8)


def written(path: Path, voxels: np.ndarray, spacing: tuple[float, ...] = (1, 1, 1), **meta: Any) -> Path:
    """An image of voxels (nx, ny, nz)."""
    image = SimpleITK.GetImageFromArray(voxels.transpose())
    image.SetSpacing(spacing)
    if "direction" in meta:
        image.SetDirection(meta["direction"])
    image.SetOrigin(meta.get("origin", (0, 0, 0)))
    SimpleITK.WriteImage(image, str(path))
    return path


def meshed(image: Path, said: list[str] | None = None, **mesh: Any) -> MeshSource:
    spec = {"image": image.name, "labels": {"ball": 1}, "size": "4 mm"} | mesh
    job = parse(
        {**JOB, "mesh": spec, "supports": [{"region": "boundary", "fix": ["x", "y", "z"]}]}, image.parent / "job.yaml"
    )
    source = read_source(job.mesh, image, (said if said is not None else []).append)
    check(source)
    return source


def volumes(source: MeshSource) -> dict[str, float]:
    corners = source.points[source.cells]
    each = abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6
    return {group.name: each[group.members].sum() for group in source.groups if group.dim == 3}


def area(source: MeshSource, name: str) -> float:
    (facets,) = (source.facets[group.members] for group in source.groups if group.name == name)
    a, b, c = (source.points[facets[:, i]] for i in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


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


@pytest.mark.parametrize("ending", [".nii", ".nrrd", ".mha"])
def test_image_lies_where_the_header_says(ending: str, tmp_path: Path) -> None:
    """Turned by a quarter and mirrored, with an origin; voxels of three lengths."""
    voxels = np.zeros((20, 16, 12), dtype=np.int16)
    voxels[4:16, 4:12, 3:9] = 3
    direction = (0, 1, 0, 1, 0, 0, 0, 0, 1)  # columns: the image's x is y, and y is x
    image = written(tmp_path / f"block{ending}", voxels, (1, 2, 3), direction=direction, origin=(100, -50, 7))
    source = meshed(image, labels={"block": [3]}, size="6 mm")
    low, high = source.points.min(axis=0) * 1e3, source.points.max(axis=0) * 1e3
    # From index 3.5 to 15.5, 3.5 to 11.5 and 2.5 to 8.5.
    assert low == pytest.approx([100 + 7, -50 + 3.5, 7 + 7.5], abs=1)
    assert high == pytest.approx([100 + 23, -50 + 15.5, 7 + 25.5], abs=1)
    assert volumes(source)["block"] == pytest.approx(12 * 16 * 18e-9, rel=0.01)


def test_a_folded_surface_does_not_cross_itself(tmp_path: Path) -> None:
    """Five facets of folds like these cross at first; they are meshed again with cells between them."""
    noise = ndimage.gaussian_filter(np.random.default_rng(2).standard_normal((20, 20, 20)), 2.2, mode="constant")
    blobs, _ = ndimage.label(noise > np.quantile(noise, 0.6))
    largest = np.bincount(blobs.ravel())[1:].argmax() + 1
    body = np.pad((blobs == largest).astype(np.uint8), 2).transpose()
    source = meshed(written(tmp_path / "folds.mha", body), size="3.5 mm")
    assert find_overlap(surface_of(source)).pairs == 0
    assert volumes(source)["ball"] == pytest.approx(body.sum() * 1e-9, rel=0.01)


def as_vti(image: Path, path: Path, on: str) -> Path:
    """The image as VTK image data, with labels of its points or cells."""
    read = SimpleITK.ReadImage(str(image))
    voxels = SimpleITK.GetArrayFromImage(read).transpose()
    axes = np.array(read.GetDirection()).reshape(3, 3)
    origin = np.array(read.GetOrigin()) - (on == "cells") * axes @ np.array(read.GetSpacing()) / 2
    grid = pyvista.ImageData(
        dimensions=np.array(voxels.shape) + (on == "cells"),
        spacing=read.GetSpacing(),
        origin=origin,
        direction_matrix=axes,
    )
    (grid.cell_data if on == "cells" else grid.point_data)["labels"] = voxels.ravel(order="F")
    grid.save(path)
    return path


@pytest.mark.parametrize("ending", [".mhd", ".mha.gz", ".nrrd.gz", ".vti", ".vti.gz"])
def test_all_formats_have_the_same_voxels_in_the_same_places(ending: str, tmp_path: Path) -> None:
    voxels = np.random.default_rng(0).integers(0, 3, (7, 6, 5)).astype(np.int64)
    meta: dict[str, Any] = {"direction": (0, 1, 0, 1, 0, 0, 0, 0, 1), "origin": (100, -50, 7)}
    first = written(tmp_path / "image.mha", voxels, (1, 2, 3), **meta)
    name = ending.removesuffix(".gz")
    other = (
        as_vti(first, tmp_path / "other.vti", "cells" if ".gz" in ending else "points")
        if name == ".vti"
        else written(tmp_path / f"other{name}", voxels, (1, 2, 3), **meta)
    )
    if ending != name:
        other = tmp_path / f"packed{ending}"
        other.write_bytes(gzip.compress((tmp_path / f"other{name}").read_bytes()))
    first_image, two = (read_labels(path, {"a": [2], "b": [1]}, 1e-3) for path in (first, other))
    assert np.array_equal(first_image.voxels, two.voxels)
    assert np.array_equal(first_image.voxels == 1, voxels == 2)
    places = np.indices(voxels.shape).reshape(3, -1).T * first_image.spacing
    assert two.positions(places) == pytest.approx(first_image.positions(places), abs=1e-9)
    other.write_bytes(other.read_bytes()[: len(other.read_bytes()) // 2])
    with pytest.raises(MeshError, match=other.name):
        read_labels(other, {"a": [2]}, 1e-3)


def test_voxels_of_64_bits_take_no_more_memory_than_one_copy(tmp_path: Path) -> None:
    voxels = np.zeros((160, 160, 160), dtype=np.int64)
    voxels[20:90, 20:90, 20:90] = 5_000_000_000
    image = written(tmp_path / "large.mha", voxels)
    tracemalloc.start()
    try:
        labels = read_labels(image, {"a": [5_000_000_000]}, 1e-3, neighbours={"b": [0]})
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert labels.volume(1) == pytest.approx(70**3 * 1e-9)
    assert peak < 1.7 * voxels.nbytes  # the array that was read, labels of 16 bits and a mask


def test_images_that_exceed_the_memory_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    image = written(tmp_path / "image.mha", ball())
    monkeypatch.setattr(isolated, "available", lambda _comm: 1000)
    with pytest.raises(MeshError, match="of memory"):
        read_labels(image, {"a": [1]}, 1e-3)


def test_other_frames(tmp_path: Path) -> None:
    image, said = written(tmp_path / "ball.nii.gz", ball(), origin=(100, 10, 1)), list[str]()
    source = meshed(image, said, orientation="SRA")
    middle = (source.points.min(axis=0) + source.points.max(axis=0)) / 2 * 1e3
    assert middle == pytest.approx([12.5, -111.5, -21.5], abs=0.5)
    assert "in SRA (x, y, z to head, right, front)" in "".join(said)
    with pytest.raises(JobError, match="not a right-handed frame"):
        meshed(image, orientation="LAS")


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
    assert "nodule: 1 parts of 2 mm^3 in all, too small for cells" in said
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


def test_other_units(tmp_path: Path) -> None:
    image = written(tmp_path / "cells.nii.gz", ball())
    assert volumes(meshed(image, unit="um", size="4 um"))["ball"] == pytest.approx(ball().sum() * 1e-18, rel=0.01)


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
    message = (
        r"neighbour 'far' is nowhere within .*\n.*labels next to the body: 7 \(at \d+% of its surface\), 9 \(at \d+% of"
    )
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


def test_smaller_sizes_make_more_cells_of_a_lattice(tmp_path: Path) -> None:
    """Halves that meet along a circle on the outside."""
    points = grid(30) - 0.2
    labels = np.where(points[..., 0] < 0, 1, 2) * (np.linalg.norm(points, axis=-1) < 12)
    image = written(tmp_path / "image.nii.gz", labels.astype(np.uint8), (5, 5, 5))
    counts = [len(meshed(image, labels={"one": 1, "two": 2}, size=f"{size} mm").cells) for size in (40, 30)]
    assert counts == sorted(set(counts))


def with_header(path: Path, *changes: tuple[str, int, tuple[float, ...]]) -> Path:
    """The ball cut in half as a NIfTI file, with values of its header in other places."""
    raw = bytearray(gzip.decompress(written(path, ball()[:, :, 12:]).read_bytes()))
    for kind, place, values in changes:
        struct.pack_into(f"<{len(values)}{kind}", raw, place, *values)
    path.write_bytes(gzip.compress(bytes(raw)))
    return path


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ([("f", 280, (2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0))], r"two places of the voxels \(qform and sform\)"),
        ([("f", 280, (0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0))], r"two places of the voxels \(qform and sform\)"),
        ([("f", 280, (1, 0.5, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0))], "not at right angles"),
        ([("f", 80, (0,))], "voxels of 0 x 1 x 1"),
        ([("f", 80, (float("nan"),))], "voxels of nan x 1 x 1"),
        ([("h", 42, (48,))], "voxels are missing"),
        ([("B", 123, (1,))], "too large for cells of 4 mm"),  # spacing in metres
        ([("B", 123, (3,))], "too small or thin for cells of 4 mm"),  # in micrometres
    ],
)
def test_contradictory_headers_are_reported(changes: list[Any], fault: str, tmp_path: Path) -> None:
    with pytest.raises(MeshError, match=fault):
        meshed(with_header(tmp_path / "image.nii.gz", ("h", 252, (1, 1)), *changes))


def test_sheared_axes_are_reported(tmp_path: Path) -> None:
    head = "type: uint8\ndimension: 3\nspace: left-posterior-superior\nsizes: 24 24 24\nspace origin: (0,0,0)\n"
    axes = "space directions: (1,0,0) (0.5,1,0) (0,0,1)\nencoding: raw\n\n"
    (tmp_path / "image.nrrd").write_bytes(f"NRRD0004\n{head}{axes}".encode() + ball().tobytes())
    with pytest.raises(MeshError, match="not at right angles"):
        meshed(tmp_path / "image.nrrd")


def test_files_that_are_not_images_are_reported(tmp_path: Path) -> None:
    (tmp_path / "image.nii.gz").write_bytes(b"\x1f\x8b no image")
    with pytest.raises(MeshError, match="cannot be read as an image"):
        meshed(tmp_path / "image.nii.gz")


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


def inside(surface: Path, **mesh: Any) -> MeshSource:
    spec = {"surface": surface.name, "unit": "mm", "size": "4 mm"} | mesh
    job = parse({**JOB, "mesh": spec, "supports": [HELD]}, surface.parent / "job.yaml")
    source = read_source(job.mesh, surface)
    check(source)
    return source


@pytest.mark.parametrize("ending", [".stl", ".ply", ".obj", ".vtp", ".vtk"])
def test_a_surface_keeps_its_place_and_volume(ending: str, tmp_path: Path) -> None:
    surface = pyvista.Sphere(radius=10, center=(100, -20, 3), theta_resolution=40, phi_resolution=40)
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


@pytest.mark.parametrize(
    ("surface", "volume"), [(cubes, 2000), (over_an_edge, 2000), (twice, 1000), (inside_each_other, 3600)]
)
def test_surfaces_of_several_shells(surface: Callable[[], pyvista.PolyData], volume: float, tmp_path: Path) -> None:
    surface().save(tmp_path / "body.stl")
    assert volumes(inside(tmp_path / "body.stl"))["body"] == pytest.approx(volume * 1e-9, rel=0.02)


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


def beside_sphere(source: MeshSource, middle: list[float]) -> np.ndarray:
    """Distances (m) of middles of facets and of their edges from the sphere."""
    at = np.array([[1 / 3, 1 / 3], [0.5, 0.5], [0.5, 0], [0, 0.5]])
    shapes = scalar_element("triangle", source.degree).tabulate(0, at)[0, :, :, 0]
    places = shapes @ source.points[source.facets] - np.array(middle) * 1e-3
    return np.asarray(np.linalg.norm(places, axis=2) - BALL * 1e-3)


def test_curved_cells_are_nearer_to_the_true_surface(tmp_path: Path) -> None:
    pyvista.Sphere(radius=BALL, theta_resolution=60, phi_resolution=60).save(tmp_path / "ball.stl")
    voxels, said = (np.linalg.norm(grid(40) * BALL / 18, axis=-1) < BALL).astype(np.uint8), list[str]()
    image, spec = written(tmp_path / "ball.nii.gz", voxels, (BALL / 18,) * 3), {"size": "6.5 mm"}
    middle = [19.5 * BALL / 18] * 3
    # The volume of the voxels differs from the ball's: the mean distance does not count.
    straight, bent = (beside_sphere(meshed(image, said, geometry_degree=d, **spec), middle).std() for d in (1, 2))
    print(f"voxels: {straight:.3g} m, curved {bent:.3g} m")
    assert bent < 0.85 * straight
    text = [line for line in said if line.startswith("cells of second degree: ")]
    assert len(text) == 1
    assert "held back for the shape of cells" in text[0]
    surface = tmp_path / "ball.stl"
    straight, bent = (beside_sphere(inside(surface, geometry_degree=d), [0, 0, 0]).std() for d in (1, 2))
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


def test_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image, mesh = written(tmp_path / "ball.nii.gz", ball()), tmp_path / "ball.vtu"
    assert main(["mesh", "from-image", str(image), str(mesh), "--label", "ball=1", "--size", "4 mm"]) == 0
    assert "ball|outside" in capsys.readouterr().out
    assert mesh.exists()
    assert main(["mesh", "from-image", str(image), str(mesh), "--label", "ball=one", "--size", "4 mm"]) == 2
    assert "--label ball=one: is written NAME=NUMBER" in capsys.readouterr().err
