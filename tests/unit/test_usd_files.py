"""Bodies of OpenUSD: both shapes, surface, regions, laws and weight, read back by OpenUSD."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.mesh_data_files import block
from helpers.verification import job
from pxr import Usd, UsdGeom, UsdPhysics, UsdShade

import hpcinv
from hpcinv.__main__ import main
from hpcinv.base.parallel.runtime import MPI
from hpcinv.geometry.workshop.run_shapes import read_shape
from hpcinv.geometry.workshop.usd import SCHEMA, Written, write_usd
from hpcinv.mesh.source import Floats, MeshSource

MESHES = Path(__file__).parents[2] / "meshes"
WEIGHT = {"effect": "gravity", "acceleration": [0, -4.0, 3.0], "density": 1000}
BODY: dict[str, Any] = {
    "mesh": {"file": "../meshes/box.py"},
    "material": {"law": "neo-hookean", "young": 3e4, "poisson": 0.4},
    "effects": [WEIGHT],
    "supports": [{"region": "z0", "fix": ["x", "y", "z"]}],
}
MOVED = np.array([[1.1, 0.1, 0.0], [0.0, 0.9, 0.2], [0.0, 0.0, 1.0]])


def written(path: Path, source: MeshSource, unit: float = 1e-3, **changes: Any) -> tuple[Usd.Stage, Written]:
    """Write a body whose rest shape is a linear map of the loaded one."""
    spec = job(**BODY | changes)
    done = write_usd(path, spec, source, replace(source, points=source.points @ MOVED), 2.0, unit)
    return Usd.Stage.Open(str(path)), done


def volumes(points: Floats, cells: Any) -> Floats:
    corners = points[np.array(cells)]
    return np.asarray(np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("hexahedra", [False, True])
def test_cells_fill_both_shapes_without_gaps(hexahedra: bool, degree: int, tmp_path: Path) -> None:
    source = block(MESHES, hexahedra, degree)
    stage, done = written(tmp_path / "a.usda", source)
    body = UsdGeom.TetMesh(stage.GetDefaultPrim().GetChild("Body"))
    points, cells = np.array(body.GetPointsAttr().Get()), body.GetTetVertexIndicesAttr().Get()
    rest = np.array(body.GetPrim().GetAttribute("physics:restShapePoints").Get())
    size = 2000 * np.ptp(source.points, axis=0).prod() ** (1 / 3)
    found = volumes(points.astype(np.float64), cells)
    assert (found > 0).all()
    assert found.sum() == pytest.approx(size**3, rel=1e-5)  # the file has 7 digits
    assert volumes(rest.astype(np.float64), cells).sum() == pytest.approx(size**3 * np.linalg.det(MOVED), rel=1e-5)
    # Without gaps, faces of one cell only are on the box.
    surface = np.array(body.GetSurfaceFaceVertexIndicesAttr().Get())
    sides = points[surface]
    flat = [(np.ptp(sides[:, :, axis], axis=1) == 0) for axis in range(3)]
    assert np.logical_or.reduce(flat).all()
    normals = np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0])
    areas = np.linalg.norm(normals, axis=1) / 2
    lengths = 2000 * np.ptp(source.points, axis=0)
    assert areas.sum() == pytest.approx(2 * (lengths.prod() / lengths).sum(), rel=1e-5)
    outward = np.einsum("ni,ni->n", normals, sides.mean(axis=1) - points.mean(axis=0))
    assert (outward > 0).all()
    assert done.cells == len(cells)


def test_regions_laws_and_weight_are_those_of_the_job(tmp_path: Path) -> None:
    source = block(MESHES, False, 1)
    stage, done = written(tmp_path / "a.usda", source, job="1-body")
    root = stage.GetDefaultPrim()
    body = root.GetChild("Body")
    assert stage.GetRootLayer().customLayerData["deformableSchema"] == SCHEMA
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1e-3
    applied = set(body.GetMetadata("apiSchemas").GetAddedOrExplicitItems())
    assert {"PhysicsDeformableBodyAPI", "PhysicsVolumeDeformableSimAPI"} <= applied
    [top] = [group for group in source.groups if group.name == "z1"]
    subset = UsdGeom.Subset(body.GetChild(done.regions["z1"]))
    assert len(subset.GetIndicesAttr().Get()) == len(top.members)
    points = np.array(UsdGeom.TetMesh(body).GetPointsAttr().Get())
    faces = np.array(UsdGeom.TetMesh(body).GetSurfaceFaceVertexIndicesAttr().Get())
    assert points[faces[np.array(subset.GetIndicesAttr().Get())]][..., 2] == pytest.approx(points[:, 2].max())
    material = UsdShade.MaterialBindingAPI(body).ComputeBoundMaterial("physics")[0].GetPrim()
    assert material.GetAttribute("physics:youngsModulus").Get() == pytest.approx(3e4 * 1e-3)  # kg/(mm s²)
    assert material.GetAttribute("physics:poissonsRatio").Get() == pytest.approx(0.4)
    masses = np.array(body.GetAttribute("physics:masses").Get())
    assert len(masses) == len(points)
    volume = 8 * np.ptp(source.points, axis=0).prod() * np.linalg.det(MOVED)
    assert masses.sum() == pytest.approx(1000 * volume, rel=1e-5)
    scene = UsdPhysics.Scene(root.GetChild("PhysicsScene"))
    assert scene.GetGravityMagnitudeAttr().Get() == pytest.approx(5000.0)  # mm/s²
    assert np.array(scene.GetGravityDirectionAttr().Get()) == pytest.approx([0, -0.8, 0.6])


def test_the_distance_of_curved_edges_is_said(tmp_path: Path) -> None:
    source = block(MESHES, False, 2)
    assert written(tmp_path / "a.usda", source)[1].distance == pytest.approx(0.0, abs=1e-11)
    bent = source.points.copy()
    bent[:, 2] += 3.0 * bent[:, 0] ** 2
    step = np.ptp(source.points[source.cells][:, :4, 0], axis=1).max()
    # The chord of a parabola over half an edge is c (h/2)²/4 away.
    expected = 2 * 3.0 * (step / 2) ** 2 / 4
    assert written(tmp_path / "b.usda", replace(source, points=bent))[1].distance == pytest.approx(expected, rel=0.2)


def test_a_run_is_exported_with_both_shapes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mesh = {"file": str(MESHES / "box.py"), "parameters": {"lx": 0.1, "ly": 0.1, "lz": 0.2, "nx": 1, "ny": 1, "nz": 2}}
    hpcinv.run(job(**BODY | {"mesh": mesh}), MPI.COMM_SELF, directory=tmp_path / "run", progress=False)
    target = tmp_path / "a.usda"
    assert main(["export", str(tmp_path / "run"), "--to", str(target)]) == 0
    assert "tetrahedra in mm, loaded and at rest" in capsys.readouterr().out
    stage = Usd.Stage.Open(str(target))
    body = stage.GetDefaultPrim().GetChild("Body")
    points, rest = (np.array(body.GetAttribute(name).Get()) for name in ("points", "physics:restShapePoints"))
    assert np.ptp(points, axis=0) == pytest.approx([100, 100, 200], rel=1e-6)
    rest_shape = read_shape(tmp_path / "run", "undeformed")
    assert np.sort(rest[:, 2]) == pytest.approx(
        np.sort(1e3 * rest_shape.points[np.unique(rest_shape.cells)][:, 2]), abs=1e-4
    )
    assert np.abs(points - rest).max() > 1.0
    assert main(["export", str(tmp_path / "run"), "--to", str(target), "--region", "a"]) == 2
    assert "has the whole body" in capsys.readouterr().err
    assert main(["export", str(tmp_path / "run"), "--to", str(tmp_path / "no" / "a.usda")]) == 2
    assert "there is not a directory" in capsys.readouterr().err
