"""Shapes and label maps of a run on an image in 3D Slicer, whose libraries uv installs: they lie on the scan in RAS."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import NO_CERTIFICATE, hpcinv_here, write_job
from helpers.imaging_cases import grid, written
from helpers.other_packages import run_alone

SLICER = "slicer-core==5.13.31053.0"
TURN = (0.8, -0.6, 0.0, 0.6, 0.8, 0.0, 0.0, 0.0, 1.0)
FILES = ("scan.nii.gz", "loaded.nrrd", "rest.nrrd", "rest.nii.gz")

LOOK = """
import json
import slicer
from vtkmodules.vtkCommonMath import vtkMatrix4x4
from vtkmodules.util.numpy_support import vtk_to_numpy
import numpy as np

scene, found = slicer.vtkMRMLScene(), {}


def read(name, node, storage):
    scene.AddNode(node)
    scene.AddNode(storage)
    storage.SetFileName(name)
    assert storage.ReadData(node), name
    return node


for name in %s:
    node = read(name, slicer.vtkMRMLLabelMapVolumeNode(), slicer.vtkMRMLVolumeArchetypeStorageNode())
    matrix = vtkMatrix4x4()
    node.GetIJKToRASMatrix(matrix)
    to_ras = np.array([[matrix.GetElement(i, j) for j in range(4)] for i in range(4)])
    image = node.GetImageData()
    numbers = vtk_to_numpy(image.GetPointData().GetScalars()).reshape(image.GetDimensions()[::-1])
    places = np.argwhere(numbers.transpose() > 0)
    ras = places @ to_ras[:3, :3].T + to_ras[:3, 3]
    found[name] = {
        "matrix": to_ras.tolist(), "low": ras.min(0).tolist(), "high": ras.max(0).tolist(), "voxels": len(places)
    }
for name in ("loaded.stl", "rest.stl"):
    node = read(name, slicer.vtkMRMLModelNode(), slicer.vtkMRMLModelStorageNode())
    bounds = [0.0] * 6
    node.GetRASBounds(bounds)
    found[name] = {"low": bounds[::2], "high": bounds[1::2]}
node = read("rest.seg.nrrd", slicer.vtkMRMLSegmentationNode(), slicer.vtkMRMLSegmentationStorageNode())
segments = [node.GetSegmentation().GetNthSegment(i) for i in range(node.GetSegmentation().GetNumberOfSegments())]
found["segments"] = {segment.GetName(): segment.GetLabelValue() for segment in segments}
json.dump(found, open("found.json", "w"))
"""


@pytest.mark.release
def test_slicer_shows_shapes_and_label_maps_on_the_scan(tmp_path: Path) -> None:
    """A ball with a core, in a turned image."""
    radii = np.linalg.norm(grid(), axis=-1)
    voxels = np.select([radii < 5, radii < 10], [7, 4]).astype(np.uint8)
    written(tmp_path / "scan.nii.gz", voxels, direction=TURN, origin=(30, -20, 10))
    job: dict[str, Any] = {
        "mesh": {"image": "scan.nii.gz", "labels": {"ball": 4, "core": 7}, "size": "5 mm"},
        "regions": {"foot": "z < 17 mm"},
        "material": {"law": "neo-hookean", "young": "3 kPa", "poisson": 0.4},
        "effects": [{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 1000}],
        "supports": [{"region": "foot", "fix": ["x", "y", "z"]}],
        "certificate": NO_CERTIFICATE,
        "output": {"fields": False},
    }
    write_job(tmp_path / "ball.yaml", job)
    ran = hpcinv_here("run", "ball.yaml", "--output", "run", "--quiet", cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr
    for shape, endings in (("deformed", (".nrrd", ".stl")), ("undeformed", (".nrrd", ".nii.gz", ".seg.nrrd", ".stl"))):
        for ending in endings:
            name = f"{'loaded' if shape == 'deformed' else 'rest'}{ending}"
            done = hpcinv_here("export", "run", "--shape", shape, "--to", name, cwd=tmp_path)
            assert done.returncode == 0, done.stderr
    found = seen_by_slicer(tmp_path)
    scan, matrix = found["scan.nii.gz"], np.array(found["scan.nii.gz"]["matrix"])
    for name in FILES:
        theirs = np.array(found[name]["matrix"])
        assert theirs[:3, :3] == pytest.approx(matrix[:3, :3], abs=1e-5)
        steps = np.linalg.solve(matrix[:3, :3], theirs[:3, 3] - matrix[:3, 3])  # whole voxels if the grid is larger
        assert steps == pytest.approx(np.rint(steps), abs=1e-4)
    assert np.array(found["loaded.nrrd"]["matrix"]) == pytest.approx(matrix, abs=1e-5)
    assert found["loaded.nrrd"]["voxels"] == pytest.approx(scan["voxels"], rel=0.03)
    assert found["rest.nii.gz"]["voxels"] == found["rest.nrrd"]["voxels"]
    for name, other in (("loaded.stl", "scan.nii.gz"), ("loaded.stl", "loaded.nrrd"), ("rest.stl", "rest.nrrd")):
        for end in ("low", "high"):
            apart = np.abs(np.array(found[name][end]) - found[other][end])
            assert apart.max() < 1.5, (name, other)  # mm: middles of voxels of 1 mm, and a smooth surface
    assert found["rest.stl"]["high"][2] > found["loaded.stl"]["high"][2] + 0.2  # to the head
    assert found["segments"] == {"ball": 4, "core": 7}


def seen_by_slicer(directory: Path) -> dict[str, Any]:
    (directory / "look.py").write_text(LOOK % (FILES,))
    run_alone([SLICER], directory / "look.py")
    return dict(json.loads((directory / "found.json").read_text()))
