"""Surfaces of bodies to compare, of meshes, runs, triangles and segmented images, with regions to align by."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyvista

from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.errors import OutputError
from hpcinv.geometry.imaging.closed_surface import read_closed
from hpcinv.geometry.imaging.image_surface import image_surface
from hpcinv.geometry.workshop.run_shapes import UNDEFORMED, read_shape
from hpcinv.geometry.workshop.solid import solid_of
from hpcinv.job.mesh_file import FORMATS, IMAGES, SURFACES
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.mesh.body import read_source
from hpcinv.mesh.source import MeshSource
from hpcinv.output.run_directory import RunDirectory


@dataclass(frozen=True)
class BodySurface:
    """Closed surface of a body in m.

    Attributes:
        regions: parts of it by name; empty for images and files of triangles.
    """

    path: Path
    surface: pyvista.PolyData
    regions: Mapping[str, pyvista.PolyData] = field(default_factory=dict)

    def part(self, names: Sequence[str]) -> pyvista.PolyData:
        """Return some regions together; all of the surface if the body has no regions, or none is named.

        Raises:
            OutputError: the body has other regions.
        """
        if not names or not self.regions:
            return self.surface
        for name in names:
            if name not in self.regions:
                raise OutputError(
                    f"{self.path}: there is no region of the surface '{name}'", did_you_mean(name, self.regions).strip()
                )
        return pyvista.merge([self.regions[name] for name in names], merge_points=True)


def surface_in(path: Path, unit: float | None, shape: str = UNDEFORMED, labels: Sequence[int] = ()) -> BodySurface:
    """Surface of the body in a mesh, a segmented image, a file of triangles, or the directory of a run.

    Args:
        unit: length unit (m) of a file; by default what a mesh states, mm of an image, and m of other files.
        shape: of a run: `UNDEFORMED`, deformed, or the name of a state.
        labels: numbers of the body's voxels in an image; by default all but 0.

    Raises:
        OutputError, MeshError: there is none.
    """
    if suffix_of(path) in SURFACES:
        surface = read_closed(path)
        surface.points = surface.points.astype(np.float64) * (unit or 1.0)
        return BodySurface(path, surface)
    if suffix_of(path) in IMAGES and path.exists():
        return BodySurface(path, image_surface(path, labels, unit or 1e-3))
    if path.is_dir() and RunDirectory(path).summary() is not None:
        source = read_shape(path, shape)
    elif path.exists() and suffix_of(path) in FORMATS:
        given = {"file": path.name} | ({"unit": unit} if unit else {})
        spec = MeshSpec.model_validate(given, context={"directory": path.parent})
        source = read_source(spec, path)
    else:
        raise OutputError(
            f"{path}: is not a mesh, surface, image or run",
            f"Meshes end in {', '.join(FORMATS)}, surfaces in {', '.join(SURFACES)}, images in {', '.join(IMAGES)};"
            " a run is a directory.",
        )
    solid = solid_of(source, None)
    return BodySurface(path, pyvista.PolyData.from_regular_faces(solid.points, solid.triangles), _regions(source))


def _regions(source: MeshSource) -> dict[str, pyvista.PolyData]:
    surfaces = {}
    for group in source.groups:
        if group.dim == 2 and len(group.members):
            nodes = source.facets[group.members]
            if source.kind == "tetrahedron":
                triangles = nodes[:, :3]
            else:  # 0 and 3 are opposite corners
                triangles = np.concatenate([nodes[:, [0, 1, 3]], nodes[:, [0, 3, 2]]])
            used, rows = np.unique(triangles, return_inverse=True)
            surfaces[group.name] = pyvista.PolyData.from_regular_faces(source.points[used], rows.reshape(-1, 3))
    return surfaces
