"""Area and centre of facets, also of curved ones, and the normal of flat ones."""

import numpy as np

from hpcinv.mesh.cells import FACET_KIND, quadrature, scalar_element, vertex_count
from hpcinv.mesh.source import Floats, Ints, MeshSource
from hpcinv.mesh.topology import FacetTable

_FLAT = 1e-6
"""Difference of unit normals of a flat surface, for files with 7 digits; raised, curved ones are taken for flat."""
_DEGREE = 8
"""Quadrature degree on curved facets, whose area is not a polynomial; raised, areas are more exact"""


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
