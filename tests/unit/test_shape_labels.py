"""Label maps of shapes on the grid of an image: moved bodies, larger grids, files and runs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import NO_CERTIFICATE, hpcinv_here, write_job
from helpers.imaging_cases import ball, written

from hpcinv.base.reading.voxels import Numbers, VoxelGrid
from hpcinv.geometry.imaging.image_files import read_voxels
from hpcinv.geometry.imaging.label_image import frame_of
from hpcinv.geometry.imaging.shape_labels import WRITTEN, shape_labels, write_labels
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.mesh.body import read_source
from hpcinv.mesh.source import Floats, Group, MeshSource

pytestmark = pytest.mark.usefixtures("warm_reader")
MESHES = Path(__file__).parents[2] / "meshes"
MM = 1e-3
TURN = np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]])
LOW, HIGH = np.array([3, 4, 2]), np.array([9, 8, 8])  # voxels of the slab, the last ones excluded
NUMBERS = {"left": 2, "right": 5}


def image() -> VoxelGrid:
    """A slab of two labels in a turned image."""
    voxels = np.zeros((20, 12, 10), dtype=np.uint8)
    voxels[3:6, 4:8, 2:8], voxels[6:9, 4:8, 2:8] = NUMBERS["left"], NUMBERS["right"]
    return VoxelGrid(voxels, np.array([1.0, 1.5, 2.0]), np.array([10.0, -20.0, 5.0]), TURN)


def slab(shift: tuple[float, float, float] = (0, 0, 0), orientation: str = "LPS", degree: int = 1) -> MeshSource:
    """The slab as tetrahedra, moved by a number of voxels, in m and in the frame of an orientation."""
    given = {"file": "box.py", "parameters": {"nx": 2, "ny": 1, "nz": 1}, "geometry_degree": degree}
    source = read_source(MeshSpec.model_validate(given, context={"directory": MESHES}), MESHES / "box.py")
    sides = np.ptp(source.points, axis=0)
    places = LOW - 0.5 + source.points / sides * (HIGH - LOW) + np.array(shift)
    is_left = source.points[source.cells][:, :4, 0].mean(axis=1) < sides[0] / 2
    groups = tuple(
        Group(name, 3, tag, np.flatnonzero(is_left == (name == "left"))) for tag, name in enumerate(NUMBERS, 1)
    )
    return replace(source, points=in_metres(places, orientation), groups=groups)


def in_metres(places: Floats, orientation: str) -> Floats:
    grid = image()
    lps = grid.origin + (places * grid.spacing) @ grid.axes.T
    return np.asarray(lps @ frame_of(orientation).T * MM)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("orientation", ["LPS", "RAS"])
def test_a_slab_is_labelled_where_it_was_moved(orientation: str, degree: int) -> None:
    grid = image()
    for shift in ((0, 0, 0), (4, 2, -1)):
        done = shape_labels(slab(shift, orientation, degree), grid, NUMBERS, MM, orientation)
        assert np.array_equal(done.grid.numbers, np.roll(grid.numbers, shift, axis=(0, 1, 2)))
        assert not done.added.any()
        assert done.grid.origin == pytest.approx(grid.origin)
        assert done.grid.numbers.dtype == np.uint8
    assert done.volumes == pytest.approx(dict.fromkeys(NUMBERS, 3 * 4 * 6 * 3e-9))


def test_a_part_of_a_voxel_moves_no_label_further_than_its_middle() -> None:
    grid = image()
    for share in (0.4, -0.4):
        done = shape_labels(slab((share, 0, 0)), grid, NUMBERS, MM, "LPS")
        assert np.array_equal(done.grid.numbers, grid.numbers)


def test_a_body_that_leaves_the_image_makes_the_grid_larger() -> None:
    grid = image()
    done = shape_labels(slab((-5, 0, 4)), grid, NUMBERS, MM, "LPS")
    assert done.added.tolist() == [[2, 0, 0], [0, 0, 2]]
    assert done.grid.numbers.shape == (22, 12, 12)
    assert done.grid.origin == pytest.approx(grid.origin - 2 * TURN[:, 0])
    assert np.array_equal(done.grid.numbers[:6, 4:8, 6:12], grid.numbers[3:9, 4:8, 2:8])
    assert sum(done.volumes.values()) == pytest.approx(6 * 4 * 6 * 3e-9)


@pytest.mark.parametrize("ending", [*WRITTEN, ".seg.nrrd"])
def test_files_have_the_grid_of_the_image(ending: str, tmp_path: Path) -> None:
    grid = replace(image(), names=NUMBERS)
    path = tmp_path / f"rest{ending}"
    write_labels(path, grid)
    again = read_voxels(path)
    assert np.array_equal(again.numbers, grid.numbers)
    assert again.spacing == pytest.approx(grid.spacing, rel=1e-6)
    assert again.origin == pytest.approx(grid.origin, rel=1e-6)
    assert again.axes == pytest.approx(grid.axes, abs=1e-6)
    assert again.names == (NUMBERS if ending == ".seg.nrrd" else {})
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("with_given", [False, pytest.param(True, marks=pytest.mark.release)])
def test_a_run_on_an_image_has_label_maps_of_its_shapes(with_given: bool, tmp_path: Path) -> None:
    """The rest shape of a ball on its foot is higher; the loaded one gives the label map of the image back."""
    voxels = 4 * ball()
    written(tmp_path / "scan.nii.gz", voxels, origin=(5, 6, 7))
    job: dict[str, Any] = {
        "mesh": {"image": "scan.nii.gz", "labels": {"ball": 4}, "size": "8 mm"},
        "regions": {"foot": "z < 12 mm"},
        "material": {"law": "neo-hookean", "young": "2 kPa", "poisson": 0.4},
        "effects": [{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 1000}],
        "supports": [{"region": "foot", "fix": ["x", "y", "z"]}],
        "certificate": NO_CERTIFICATE,
        "output": {"fields": False},
    }
    write_job(tmp_path / "ball.yaml", job)
    ran = hpcinv_here("run", "ball.yaml", "--output", "run", "--quiet", cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr
    given = np.argwhere(voxels)
    rest = np.argwhere(labels_of("undeformed", tmp_path) == 4)
    assert rest[:, 2].mean() > given[:, 2].mean() + 0.2
    if with_given:
        loaded = np.argwhere(labels_of("deformed", tmp_path) == 4)
        shared = set(map(tuple, given.tolist())) & set(map(tuple, loaded.tolist()))
        assert 2 * len(shared) / (len(given) + len(loaded)) > 0.93  # cells of 8 mm in voxels of 1 mm
    refused = hpcinv_here("export", "run", "--to", "a.nrrd", "--scale", "2", cwd=tmp_path)
    assert refused.returncode == 2
    assert "has the whole body in its size" in refused.stderr


def labels_of(shape: str, directory: Path) -> Numbers:
    """Export the label map of a shape; return its numbers."""
    done = hpcinv_here("export", "run", "--shape", shape, "--to", f"{shape}.nrrd", cwd=directory)
    assert done.returncode == 0, done.stderr
    assert "voxels in the frame of scan.nii.gz" in done.stdout
    assert "ball: 4, " in done.stdout
    assert float(done.stdout.rpartition("ratio ")[2]) == pytest.approx(1.0, abs=0.03)
    grid = read_voxels(directory / f"{shape}.nrrd")
    assert grid.origin[:2] == pytest.approx([5, 6])
    return grid.numbers
