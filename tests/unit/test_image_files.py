"""Formats and headers of images: the same voxels in the same places, and faults that are named."""

from __future__ import annotations

import gzip
import struct
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvista
from helpers.imaging_cases import SimpleITK, ball, meshed, volumes, written

from hpcinv.errors import JobError, MeshError
from hpcinv.geometry.imaging.label_image import read_labels
from hpcinv.mesh.io import isolated

pytestmark = pytest.mark.usefixtures("warm_reader")


@pytest.mark.everyday(".nrrd")
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


def test_image_orientation_may_be_another_right_handed_frame(tmp_path: Path) -> None:
    image, said = written(tmp_path / "ball.nii.gz", ball(), origin=(100, 10, 1)), list[str]()
    source = meshed(image, said, orientation="SRA")
    middle = (source.points.min(axis=0) + source.points.max(axis=0)) / 2 * 1e3
    assert middle == pytest.approx([12.5, -111.5, -21.5], abs=0.5)
    assert "in SRA (x, y, z to head, right, front)" in "".join(said)
    with pytest.raises(JobError, match="not a right-handed frame"):
        meshed(image, orientation="LAS")


@pytest.mark.release
def test_images_may_have_any_length_unit(tmp_path: Path) -> None:
    image = written(tmp_path / "cells.nii.gz", ball())
    assert volumes(meshed(image, unit="um", size="4 um"))["ball"] == pytest.approx(ball().sum() * 1e-18, rel=0.01)


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
