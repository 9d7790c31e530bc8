"""Springs between a surface and the ground: their stiffness at points of a quadrature."""

from __future__ import annotations

from dataclasses import dataclass

import basix
import numpy as np

from hpcinv.mesh.cells import FACET_KIND, scalar_element
from hpcinv.mesh.refine.degree import centre_weights
from hpcinv.mesh.source import Floats, Group, Ints, MeshSource


@dataclass(frozen=True)
class Foundation:
    """Springs on a region, unstretched in the rest body.

    Attributes:
        normal, tangential: stiffness per area, Pa/m.
        is_current: whether area and normal are of the loaded body.
    """

    place: str
    group: Group
    normal: float
    tangential: float
    is_current: bool

    @property
    def stiffnesses(self) -> list[float]:
        """Stiffnesses per area (Pa/m) along the first axes of its points, as many as there are springs."""
        return [self.normal, self.tangential, self.tangential] if self.tangential else [self.normal]

    def axes(self, points: SpringPoints) -> Floats:
        """Return the axes of the springs (q, 3, 3), as rows; equal springs have the axes of the coordinates."""
        if self.normal == self.tangential:
            return np.tile(np.eye(3), (len(points.points), 1, 1))
        return points.axes


@dataclass(frozen=True)
class SpringPoints:
    """Points that bear the springs of a foundation.

    Attributes:
        points: (q, 3), m.
        nodes: rows of the nodes of the facet of each point (q, k).
        shapes: values of their shape functions (q, k): the displacement of a point is their sum.
        areas: of which each point has the springs (q,), m².
        axes: unit vectors (q, 3, 3), as rows: the normal, and two in the surface.
    """

    points: Floats
    nodes: Ints
    shapes: Floats
    areas: Floats
    axes: Floats


def spring_points(mesh: MeshSource, loaded: Floats, foundation: Foundation, quadrature: int) -> SpringPoints:
    """Return the points of a quadrature of a degree. Facets of hexahedra of degree 2 have 8 nodes.

    Args:
        mesh: of the rest body.
        loaded: places of its nodes (n, 3), m.
    """
    kind, degree = FACET_KIND[mesh.kind], mesh.degree
    facets = mesh.facets[foundation.group.members]
    places, weights = basix.make_quadrature(basix.CellType[kind], quadrature)
    table = scalar_element(kind, degree).tabulate(1, places)[:, :, :, 0]
    tangents = np.einsum("dqk,fki->fqdi", table[1:], (loaded if foundation.is_current else mesh.points)[facets])
    normals = np.cross(tangents[:, :, 0], tangents[:, :, 1])
    sizes = np.linalg.norm(normals, axis=2)
    first = tangents[:, :, 0] / np.linalg.norm(tangents[:, :, 0], axis=2)[..., None]
    normals /= sizes[..., None]
    shapes, kept = table[0].copy(), np.arange(facets.shape[1])
    if mesh.kind == "hexahedron" and degree == 2:
        for node, parts in centre_weights(kind):
            shapes += shapes[:, [node]] * parts
            kept = kept[kept != node]
    points = np.einsum("qk,fki->fqi", table[0], mesh.points[facets])
    return SpringPoints(
        points.reshape(-1, 3),
        np.repeat(facets[:, kept], len(weights), axis=0),
        np.tile(shapes[:, kept], (len(facets), 1)),
        (sizes * weights).ravel(),
        np.stack([normals, first, np.cross(normals, first)], axis=2).reshape(-1, 3, 3),
    )
