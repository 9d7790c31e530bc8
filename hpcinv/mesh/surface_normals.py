"""Normals at the nodes of a surface of quadrilaterals of degree 2, with derivatives by these nodes; areas of facets."""

from __future__ import annotations

from pathlib import Path
from typing import NoReturn

import numpy as np

from hpcinv.errors import MeshError
from hpcinv.mesh.cells import FACET_KIND, quadrature, scalar_element, vertex_count
from hpcinv.mesh.source import Floats, Ints, MeshSource
from hpcinv.mesh.topology import FacetTable

KIND, DEGREE = "quadrilateral", 2

_SHARPEST = 40.0
"""degrees between normals of cells at a common node; raised, a fold becomes a shell of changing thickness"""

_FLAT = 1e-6
"""Difference of unit normals of a flat surface, for files with 7 digits; raised, curved ones are taken for flat."""
_DEGREE = 8
"""Quadrature degree on curved facets, whose area is not a polynomial; raised, areas are more exact"""


def surface_tangents(cells: Ints, points: Floats) -> Floats:
    """Return the derivatives (2, c, p, 3) of the places of cells by their coordinates, at their nodes."""
    return np.asarray(np.einsum("dpn,cni->dcpi", _gradients(), points[cells]))


def nodal_normals(surface: MeshSource) -> Floats:
    """Unit normals (n, 3) at the nodes: means over the cells around each, weighted by their angles there.

    So they do not depend on how many cells a side of an edge has.

    Raises:
        MeshError: cells of no area, or a fold.

    Source: Thürmer & Wüthrich, J. Graph. Tools 3, 43–46, 1998, doi:10.1080/10867651.1998.10487487.
    """
    tangents = surface_tangents(surface.cells, surface.points)
    normals = np.cross(tangents[0], tangents[1])
    lengths = np.linalg.norm(normals, axis=2, keepdims=True)
    sizes = np.linalg.norm(tangents, axis=3).prod(axis=0)[..., None]
    if (is_flat := ~(lengths > 1e-12 * sizes).all(axis=(1, 2))).any():
        first = place_text(surface.points[surface.cells[np.argmax(is_flat)]].mean(axis=0))
        text = f"has cells without area (first of {np.count_nonzero(is_flat)} quadrilaterals: at {first})"
        refuse(surface.path, text, "Merge nodes at the same place and remove such cells, or mesh it again.")
    normals = normals / lengths
    signs = _signs_at_corners()
    angles = _angles(lengths, (tangents[0] * tangents[1]).sum(axis=2, keepdims=True) * signs, signs)
    sums = _summed(surface.cells, angles * normals, len(surface.points))
    means = sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-300)
    cosines = (normals * means[surface.cells]).sum(axis=2)
    # Two normals differ by at most twice the largest difference from the mean.
    suspicious = np.unique(surface.cells[cosines < np.cos(np.radians(_SHARPEST / 2))])
    if len(suspicious):
        angle, node = _sharpest(surface.cells, normals, suspicious)
        if angle > _SHARPEST:
            place = place_text(surface.points[node])
            text = f"has a fold of {angle:.0f}° at {place}, where a shell has no normal (at most {_SHARPEST:.0f}°)"
            refuse(surface.path, text, "Round it off with cells of degree 2 and a finer mesh, or mesh a solid.")
    return np.asarray(means)


def _sharpest(cells: Ints, normals: Floats, nodes: Ints) -> tuple[float, int]:
    """Return the largest angle (degrees) between normals (c, p, 3) of cells (c, p) at one of some nodes, and the node.

    Args:
        nodes: ascending.
    """
    is_there = np.isin(cells, nodes)
    entries, vectors = cells[is_there], normals[is_there]
    order = np.argsort(entries, kind="stable")
    starts = np.searchsorted(entries[order], nodes)
    around = np.split(vectors[order], starts[1:])
    cosines = np.array([(part @ part.T).min() for part in around])
    sharpest = int(cosines.argmin())
    return float(np.degrees(np.arccos(np.clip(cosines[sharpest], -1, 1)))), int(nodes[sharpest])


class NormalRates:
    """The linear map from rates of the nodes of a surface to rates of its `nodal_normals`, and its transpose.

    Args:
        surface: whose normals exist.
    """

    def __init__(self, surface: MeshSource) -> None:
        self._cells, tangents = surface.cells, surface_tangents(surface.cells, surface.points)
        self._gradients = _gradients()
        weighted, self._by_tangents = _weighted_normals(tangents)
        sums = _summed(self._cells, weighted, len(surface.points))
        self._lengths = np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-300)
        self._normals = sums / self._lengths

    def along(self, rates: Floats) -> Floats:
        """Return rates (n, 3) of the normals along rates (n, 3) of the nodes."""
        tangents = np.einsum("dpn,cni->dcpi", self._gradients, rates[self._cells])
        sums = _summed(self._cells, np.einsum("dcpoi,dcpi->cpo", self._by_tangents, tangents), len(rates))
        return self._projected(sums)

    def transposed(self, by_normals: Floats) -> Floats:
        """Return derivatives (n, 3) by the nodes, from derivatives (n, 3) by the normals."""
        at_cells = self._projected(by_normals)[self._cells]
        by_tangents = np.einsum("dcpoi,cpo->dcpi", self._by_tangents, at_cells)
        return _summed(self._cells, np.einsum("dpn,dcpi->cni", self._gradients, by_tangents), len(by_normals))

    def _projected(self, vectors: Floats) -> Floats:
        """Return the derivative of the unit vectors along vectors (n, 3), which is symmetric."""
        along = (self._normals * vectors).sum(axis=1, keepdims=True)
        return np.asarray((vectors - along * self._normals) / self._lengths)


def _weighted_normals(tangents: Floats) -> tuple[Floats, Floats]:
    """Return normals (c, p, 3) of cells at their nodes times their angles, and derivatives (2, c, p, 3, 3) by tangents.

    The last axis of the derivatives is the component of the tangent.
    """
    cross = np.cross(tangents[0], tangents[1])
    lengths = np.linalg.norm(cross, axis=2, keepdims=True)
    normals, signs = cross / lengths, _signs_at_corners()
    products = (tangents[0] * tangents[1]).sum(axis=2, keepdims=True) * signs
    angles = _angles(lengths, products, signs)
    derivatives = np.empty((*tangents.shape, 3))
    for number, other in enumerate((tangents[1], tangents[0])):
        for axis, e in enumerate(np.eye(3)):
            by_cross = np.cross(e, other) if number == 0 else np.cross(other, e)
            by_length = (normals * by_cross).sum(axis=2, keepdims=True)
            by_product = other[..., axis, None] * signs
            by_angle = (products * by_length - lengths * by_product) / (lengths**2 + products**2)
            by_normal = (by_cross - by_length * normals) / lengths
            derivatives[number, ..., axis] = np.where(signs != 0, by_angle, 0.0) * normals + angles * by_normal
    return angles * normals, derivatives


def _gradients() -> Floats:
    """Return the gradients (2, nodes, functions) of the shape functions at the nodes of a cell."""
    element = scalar_element(KIND, DEGREE)
    return np.asarray(element.tabulate(1, element.points)[1:, :, :, 0])


def _signs_at_corners() -> Floats:
    """Return by node (p, 1) the sign that makes edges of its tangents point into the cell; 0 away from corners."""
    return np.asarray((1 - 2 * scalar_element(KIND, DEGREE).points).prod(axis=1))[:, None]


def _angles(lengths: Floats, products: Floats, signs: Floats) -> Floats:
    """Return the angle of a cell between its edges at a vertex, and 180° at other nodes."""
    return np.where(signs == 0, np.pi, np.arctan2(lengths, products))


def _summed(cells: Ints, values: Floats, count: int) -> Floats:
    """Return sums (count, 3) at nodes of values (c, p, 3) at the nodes of cells."""
    sums = np.zeros((count, 3))
    np.add.at(sums, cells, values)
    return sums


def place_text(point: Floats) -> str:
    """Text of a point (3,), in m."""
    return f"({', '.join(f'{value:.4g}' for value in point)}) m"


def refuse(path: Path, text: str, advice: str) -> NoReturn:
    raise MeshError(f"{path}: the surface {text}", advice)


def area_and_centre(source: MeshSource, rows: Ints, points: Floats) -> tuple[float, Floats]:
    """Return the area and the centre (3,) of some facets of a mesh whose nodes are at ``points`` (n, 3)."""
    kind = FACET_KIND[source.kind]
    element = scalar_element(kind, source.degree)
    places, weights = quadrature(kind, _DEGREE)
    values, *slopes = element.tabulate(1, places)[:, :, :, 0]
    nodes = points[source.facets[rows]]
    tangents = [np.einsum("pn,fni->fpi", slope, nodes) for slope in slopes]
    areas = np.linalg.norm(np.cross(*tangents), axis=2) * weights
    centre = np.einsum("fp,pn,fni->i", areas, values, nodes) / areas.sum()
    return float(areas.sum()), centre


def flat_normal(source: MeshSource, rows: Ints) -> Floats | None:
    """Return the outward unit normal (3,) of some facets of a mesh; ``None`` if their nodes are not on one plane."""
    cells = source.cells[:, : vertex_count(source.kind)]
    table = FacetTable.build(source.kind, cells)
    vertices = source.facets[rows][:, : vertex_count(FACET_KIND[source.kind])]
    numbers, first = np.unique(table.find(vertices), return_index=True)
    corners = source.points[vertices[first]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inner = source.points[cells[table.owners(numbers)[:, 0]]].mean(axis=1)
    normals *= np.where(np.einsum("fi,fi->f", normals, corners[:, 0] - inner) > 0, 1.0, -1.0)[:, None]
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    nodes = source.points[source.facets[rows]].reshape(-1, 3)
    size = float(np.linalg.norm(np.ptp(nodes, axis=0)))
    is_flat = np.abs(normals - normals[0]).max() <= _FLAT
    is_plane = np.abs((nodes - nodes[0]) @ normals[0]).max() <= _FLAT * size
    return np.asarray(normals[0]) if is_flat and is_plane else None
