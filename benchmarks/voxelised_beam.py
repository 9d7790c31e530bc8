"""What an image costs in accuracy: the sagging silicone beam as voxels, and how straight it comes back.

The beam of jobs/pdms-beam.yaml, straight before its weight bent it, is made into images of several voxel sizes. Each is
meshed, the beam's undeformed shape is found, and compared with the straight beam of 182 mm: the tip, and the distance
of the surface. A line "without" has the same cells with their surface moved to the beam's: its errors come from mesh
and clamp, the others from the surface. The line "mesh" is the given mesh without an image. The last columns are the
largest standard deviation of the undeformed shape by the certificate, its seconds, and the seconds of the run.

    python3 -m uv run python benchmarks/voxelised_beam.py [--voxels 2 1 0.5] [--size 3]
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

import hpcinv  # its import order first

# isort: split
import numpy as np
import pyvista
import SimpleITK

from hpcinv.job.mesh_section import MeshSpec
from hpcinv.mesh import read_source
from hpcinv.mesh.mesh_files import save
from hpcinv.mesh.readers import read_msh
from hpcinv.mesh.surface import surface_of

ROOT = Path(__file__).parents[1]
LENGTH, RADIUS = 182.0, 4.25  # mm


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("--voxels", type=float, nargs="*", default=[2.0, 1.0, 0.5], help="mm")
    options.add_argument("--size", type=float, default=3.0, help="of cells, mm")
    given = options.parse_args()
    print("voxel     cells  volume    tip     |  surface: mean, 95 %, largest (mm) | predicted  seconds")
    mesh = ROOT / "meshes" / "pdms-beam-sagging.msh"
    report("mesh", {"file": str(mesh)})
    for voxel in given.voxels:
        with tempfile.TemporaryDirectory() as place:
            image = Path(place) / "beam.nii.gz"
            voxelise(mesh, voxel, image)
            size = f"{given.size} mm"
            report(f"{voxel:g} mm", {"image": str(image), "labels": {"silicone": 1}, "size": size})
            moved = Path(place) / "moved.msh"
            distance = put_right(image, given.size, mesh, moved)
            report("without", {"file": str(moved)})
            print(f"        its nodes were {distance * 1e3 / voxel:.3f} voxels from the surface, rms", flush=True)


def voxelise(mesh: Path, voxel: float, path: Path) -> None:
    """Write an image of the mesh in mm: a voxel belongs to it if its middle is inside."""
    source = read_msh(mesh).convert_to_metres(1.0)
    cells = source.cells[:, [0, 1, 2, 3, 9, 6, 8, 7, 5, 4]]  # in VTK's order
    grid = pyvista.UnstructuredGrid({pyvista.CellType.QUADRATIC_TETRA: cells}, source.points * 1e3)
    low, high = (np.array(grid.bounds[i::2]) for i in (0, 1))
    # The clamp is where the image begins, as a photograph of the beam would be cut there.
    origin = low - 2.4 * voxel + np.array([2.9, 0, 0]) * voxel
    counts = np.ceil((high + 2 * voxel - origin) / voxel).astype(int)
    axes = [o + voxel * np.arange(n) for o, n in zip(origin, counts, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    inside = grid.find_containing_cell(points.reshape(-1, 3)).reshape(points.shape[:-1]) >= 0
    image = SimpleITK.GetImageFromArray(inside.transpose().astype(np.uint8))
    image.SetSpacing([voxel] * 3)
    image.SetOrigin(origin.tolist())
    SimpleITK.WriteImage(image, str(path))


def put_right(image: Path, size: float, mesh: Path, path: Path) -> float:
    """Write the image's mesh with its surface moved to the beam's, where cells allow; size in mm.

    Returns the distance (m, root mean square) between the nodes of both surfaces.
    """
    spec = {"image": image.name, "labels": {"silicone": 1}, "size": f"{size} mm"}
    voxel_mesh = read_source(MeshSpec.model_validate(spec, context={"directory": image.parent}), image)
    source = read_msh(mesh).convert_to_metres(1.0)
    beam = surface_of(source).cut(4, np.arange(len(surface_of(source).nodes)))
    true = pyvista.PolyData.from_regular_faces(beam.points, beam.corners)
    (side,) = (group.members for group in voxel_mesh.groups if group.name == "silicone|outside")
    nodes, points = np.unique(voxel_mesh.facets[side]), voxel_mesh.points.copy()
    points[nodes] = true.find_closest_cell(points[nodes], return_closest_point=True)[1]
    distance = float(np.sqrt(((points - voxel_mesh.points)[nodes] ** 2).sum(axis=1).mean()))
    share = np.ones((len(points), 1))
    while True:
        moved = voxel_mesh.points + share * (points - voxel_mesh.points)
        corners = moved[voxel_mesh.cells]
        inverted = np.linalg.det(corners[:, 1:] - corners[:, :1]) <= 0
        if not inverted.any():
            break
        share[np.unique(voxel_mesh.cells[inverted])] *= 0.5
    save(path, voxel_mesh, moved)
    return distance


def report(name: str, mesh: dict[str, Any]) -> None:
    job = {
        "mesh": mesh,
        "regions": {"held": "x < 0.6 mm"},
        "material": {"law": "mooney-rivlin", "c1": "101709.668 Pa", "c2": "151065.460 Pa", "d1": "7.965272689e8 Pa"},
        "effects": [
            {
                "effect": "gravity",
                "acceleration": [0, "-9.81 m/s^2", 0],
                "density": "963 kg/m^3",
                "density_in": "reference",
            }
        ],
        "supports": [{"region": "held", "fix": ["x", "y", "z"]}],
        "certificate": {"level": "off", "surface": True},
    }
    begun = time.perf_counter()
    result = hpcinv.run(hpcinv.load(job), progress=False)
    seconds = time.perf_counter() - begun
    spread = result.surface_spread
    predicted = "" if spread is None else f"{1e3 * spread.deviations()['']:.2f} mm  {spread.seconds:.1f}, {seconds:.1f}"
    X = result.shape * 1e3
    cells = result.body.mesh.geometry.dofmaps[0][:, :4]
    surface = pyvista.UnstructuredGrid({pyvista.CellType.TETRA: cells}, X)
    boundary = np.asarray(surface.extract_surface(algorithm=None).points)
    radial = np.abs(np.linalg.norm(boundary[:, 1:], axis=1) - RADIUS)
    side = radial[(boundary[:, 0] > 5) & (boundary[:, 0] < LENGTH - 5)]
    end = boundary[boundary[:, 0] > boundary[:, 0].max() - 2.0]
    tip = np.linalg.norm([boundary[:, 0].max() - LENGTH, *end[:, 1:].mean(axis=0)])
    print(
        f"{name:6} {len(cells):8}  {surface.volume / (np.pi * RADIUS**2 * LENGTH) - 1:+.2%}  {tip:6.2f} mm  |"
        f"  {side.mean():.2f}, {np.quantile(side, 0.95):.2f}, {side.max():.2f} | {predicted}",
        flush=True,
    )


if __name__ == "__main__":
    main()
