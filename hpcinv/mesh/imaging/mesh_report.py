"""Report of a mesh that was made from an image or a surface: place, quality, sizes and separate parts."""

from collections.abc import Callable
from itertools import combinations

import numpy as np

from hpcinv.mesh.imaging.lattice import scaled_jacobians
from hpcinv.mesh.imaging.wall_sizes import WallSizes
from hpcinv.mesh.source import MeshSource
from hpcinv.mesh.topology import FacetTable, connected
from hpcinv.quantity.units import readable

_NOTED = 0.05  # share of the surface at thin walls from which on it is reported


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


def _parts(source: MeshSource) -> int:
    """Number of parts of a body that share no facet."""
    table = FacetTable.build(source.kind, source.cells[:, :4])
    return int(connected(table.cell_facets, len(table.vertices)).max()) + 1
