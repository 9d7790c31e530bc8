"""Report of a mesh that was made from an image or a surface: place, quality, sizes and separate parts."""

from collections.abc import Callable
from itertools import combinations

import numpy as np
import pyvista

from hpcinv.base.quantity.units import readable
from hpcinv.geometry.imaging.lattice import scaled_jacobians
from hpcinv.geometry.imaging.wall_sizes import WallSizes
from hpcinv.mesh.source import MeshSource
from hpcinv.mesh.topology import FacetTable, connected

_NOTED = 0.05  # share of the surface at thin walls from which on it is reported
_FAR = 0.01  # largest distance from given triangles, relative to the smallest extent, without a remedy in the log


def report_mesh(source: MeshSource, frame: str, report: Callable[[str], None]) -> None:
    """Report place, quality, labels with less than two cells through their walls, and separate parts.

    Args:
        source: a mesh of tetrahedra.
        frame: of the positions.
    """
    low, high = source.points.min(axis=0), source.points.max(axis=0)
    size = " x ".join(readable(float(length), "m") for length in high - low)
    corner = ", ".join(readable(float(value), "m") for value in low)
    report(f"the body is {size}, from ({corner}){frame}")
    shape = scaled_jacobians(source.points[source.cells])
    report(
        f"scaled Jacobian of cells: {shape.min():.2f} at worst, {np.percentile(shape, 1):.2f} at the first percentile"
    )
    if (parts := _parts(source)) > 1:
        report(f"the body has {parts} parts that share no facet: each needs supports")
    if any(group.name == "cut" for group in source.groups):
        report("the body is cut by the border of the image (region 'cut')")


def report_sizes(source: MeshSource, sizes: WallSizes, report: Callable[[str], None]) -> None:
    """Report the lengths of edges, the walls that they are graded to, and walls too thin for two of them."""
    corners = source.points[source.cells]
    edges = np.concatenate(
        [np.linalg.norm(corners[:, i] - corners[:, j], axis=1) for i, j in combinations(range(4), 2)]
    )
    low, high = (readable(float(length), "m") for length in np.percentile(edges, (2, 98)))
    share = sizes.share_of_walls
    graded = f", graded to walls of down to {readable(sizes.thinnest, 'm')} at {share:.0%} of the surface"
    report(
        f"edges from {low} to {high} (without 2 % at each end){graded if share > _NOTED and sizes.is_graded else ''}"
    )
    if (share := sizes.share_too_thin) > _NOTED:
        report(
            f"{share:.0%} of the surface is at walls too thin for two cells of {readable(sizes.floor, 'm')};"
            " take a larger mesh.grade or a smaller mesh.size"
        )


def report_distance(source: MeshSource, triangles: pyvista.PolyData, report: Callable[[str], None]) -> None:
    """Report how far the facets of a mesh are from the triangles (m) of the file that it was made from.

    All nodes count, and the middles of the facets' corners.
    """
    corners = source.points[source.facets[:, :3]]
    places = np.concatenate([source.points[np.unique(source.facets)], corners.mean(axis=1)])
    _, closest = triangles.find_closest_cell(places, return_closest_point=True)
    distances = np.linalg.norm(places - np.reshape(closest, (-1, 3)), axis=1)
    usual, largest = np.percentile(distances, 95), distances.max()
    is_far = largest > _FAR * np.ptp(source.points, axis=0).min()
    remedy = "; a smaller mesh.size is closer, and a CAD file keeps sharp edges" if is_far else ""
    report(
        f"facets are up to {readable(float(largest), 'm')} from the triangles of the file,"
        f" 95 % of them within {readable(float(usual), 'm')}{remedy}"
    )


def _parts(source: MeshSource) -> int:
    """Number of parts of a body that share no facet."""
    table = FacetTable.build(source.kind, source.cells[:, :4])
    return int(connected(table.cell_facets, len(table.vertices)).max()) + 1
