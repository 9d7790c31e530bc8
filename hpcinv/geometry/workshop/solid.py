"""Closed triangulated surface of a body or a part of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.sparse
import scipy.sparse.csgraph

from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.base.quantity.units import readable
from hpcinv.errors import MeshError, OutputError
from hpcinv.mesh.cells import jacobians, quadrature
from hpcinv.mesh.source import Floats, Ints, MeshSource
from hpcinv.mesh.surface import Surface, surface_of

NEAR = 1e-4  # default tolerance, of the diagonal
SAME_VOLUME = 1e-5  # relative error of the volume, unless a tolerance is given
_MOST_TRIANGLES = 20_000_000
_QUADRATURE = 8  # degree, exact for the volume of curved cells
_CELLS_AT_ONCE = 20_000


@dataclass(frozen=True)
class Solid:
    """A body bounded by triangles, whose normals point outwards.

    Attributes:
        points: corners, (n, 3), in any unit of length.
        triangles: rows of ``points``, (m, 3).
    """

    points: Floats
    triangles: Ints

    @property
    def volume(self) -> float:
        """Volume in the cube of the unit; negative if the normals point inwards."""
        a, b, c = (self.points[self.triangles[:, i]] - self.points.mean(axis=0) for i in range(3))
        return float(np.einsum("ni,ni->", a, np.cross(b, c)) / 6)

    @property
    def size(self) -> Floats:
        """Extent along the axes, (3,)."""
        return np.asarray(np.ptp(self.points, axis=0))

    @property
    def is_closed(self) -> bool:
        """True if each side of a triangle is also a side of another one, in the opposite direction."""
        forth = np.concatenate([self.triangles[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
        count = len(self.points)
        there, back = (np.sort(forth[:, i] * count + forth[:, 1 - i]) for i in (0, 1))
        return bool((there == back).all() and (np.diff(there) > 0).all() and (forth[:, 0] != forth[:, 1]).all())

    def shells(self) -> list[Solid]:
        """Return the connected surfaces; those with a negative volume bound chambers."""
        count = len(self.points)
        edges = np.concatenate([self.triangles[:, [0, 1]], self.triangles[:, [1, 2]]])
        joined = scipy.sparse.coo_array((np.ones(len(edges)), edges.T), (count, count))
        pieces = scipy.sparse.csgraph.connected_components(joined, directed=False)[1][self.triangles[:, 0]]
        parts = [Solid(self.points, self.triangles[pieces == piece]) for piece in np.unique(pieces)]
        return [part.without_loose_points() for part in parts]

    def without_loose_points(self) -> Solid:
        used, rows = np.unique(self.triangles, return_inverse=True)
        return Solid(self.points[used], rows.reshape(self.triangles.shape))

    def reversed(self) -> Solid:
        """Return the solid that a chamber holds, or the other way round."""
        return Solid(self.points, self.triangles[:, ::-1])

    def scaled(self, factor: float) -> Solid:
        return Solid(self.points * factor, self.triangles)

    def round_to_single(self) -> Solid:
        """Return the solid as formats with numbers of 4 bytes hold it; close points may coincide in them.

        Raises:
            OutputError: it would not be closed.
        """
        rounded, place = np.unique(self.points.astype(np.float32), axis=0, return_inverse=True)
        triangles = place.reshape(-1)[self.triangles]
        a, b, c = triangles.T
        solid = Solid(rounded.astype(np.float64), triangles[(a != b) & (b != c) & (c != a)])
        if not solid.is_closed:
            raise OutputError(
                "is not closed in the numbers of 4 bytes of this format: points of the surface coincide in them",
                "Take a larger --tolerance.",
            )
        return solid


def region_cells(source: MeshSource, name: str) -> Ints:
    """Return the cells of a group; ``MeshError`` if there is none of that name."""
    groups = {group.name: group.members for group in source.groups if group.dim == 3}
    if name not in groups:
        raise MeshError(f"{source.path}: has no region of cells '{name}'", did_you_mean(name, groups).strip())
    return groups[name]


def solid_of(source: MeshSource, cells: Ints | None, tolerance: float | None = None) -> Solid:
    """Return the boundary of a mesh, or of some of its cells, in m.

    Of curved cells the corners of the triangles lie on both sides of the surface, so that the volume is kept.

    Args:
        tolerance: largest distance (m) of the triangles from curved facets; by default it is 1e-4 of the diagonal, or
            what it takes for the volume of the body to 1e-5.

    Raises:
        MeshError: the boundary is not one closed surface without edges at which it touches itself.
        OutputError: there would be too many triangles.
    """
    surface = surface_of(source, cells)
    largest_distance = tolerance or NEAR * float(np.linalg.norm(np.ptp(surface.nodes.reshape(-1, 3), axis=0)))
    divisions, volume = _divisions(surface, largest_distance), volume_of(source, cells)
    solid = _cut(surface, divisions)
    if not solid.is_closed or not solid.volume > 0:
        raise MeshError(
            f"{source.path}: the boundary is not a closed surface that separates inside from outside",
            "Parts of the body may touch each other at edges only, or the cells of --region may do so.",
        )
    while tolerance is None and abs(solid.volume / volume - 1) > SAME_VOLUME:
        divisions = math.ceil(1.25 * divisions)
        _check_count(surface, divisions)
        solid = _cut(surface, divisions)
    return solid


def _cut(surface: Surface, divisions: int) -> Solid:
    """Return the facets as triangles, whose corners are moved so that they are as far outside as inside.

    A quadratic function that vanishes in the corners of a triangle has a mean of 3/4 of its value in the middle.
    """
    cut = surface.cut(divisions, np.arange(len(surface.nodes)), middles_on_facets=True)
    rises = surface.rises(divisions)
    # Weighted by their lengths, so that the rim of a flat facet is moved as the curved facets at it.
    weights = np.linalg.norm(rises, axis=1)
    sums, total = np.zeros_like(cut.points), np.full(len(cut.points), np.finfo(float).tiny)
    np.add.at(sums, cut.corners, (weights[:, None] * rises)[:, None])
    np.add.at(total, cut.corners, weights[:, None])
    return Solid(cut.points + 0.75 * sums / total[:, None], cut.corners)


def _divisions(surface: Surface, tolerance: float) -> int:
    """Return into how many parts the sides of facets are cut, so that triangles are within a tolerance (m) of them."""
    # The error of quadratic facets falls with the square of the divisions.
    divisions = max(1, math.ceil(math.sqrt(surface.chord_error(1) / tolerance)))
    _check_count(surface, divisions)
    while surface.chord_error(divisions) > tolerance:
        divisions += 1
    return divisions


def _check_count(surface: Surface, divisions: int) -> None:
    triangles = len(surface.nodes) * divisions**2 * (1 if surface.kind == "triangle" else 4)
    if triangles > _MOST_TRIANGLES:
        raise OutputError(
            f"the curved surface would take {triangles:,} triangles, and {_MOST_TRIANGLES:,} are the most",
            f"Give a larger --tolerance: one triangle for each facet keeps to {readable(surface.chord_error(1), 'm')}.",
        )


def volume_of(source: MeshSource, cells: Ints | None) -> float:
    """Return the volume (m³) of a mesh, or of some of its cells, by quadrature over the curved cells."""
    nodes = source.cells if cells is None else source.cells[cells]
    points, weights = quadrature(source.kind, _QUADRATURE)
    return math.fsum(
        float(np.abs(np.linalg.det(jacobians(source.kind, source.degree, source.points[some], points)) @ weights).sum())
        for begin in range(0, len(nodes), _CELLS_AT_ONCE)
        for some in [nodes[begin : begin + _CELLS_AT_ONCE]]
    )
