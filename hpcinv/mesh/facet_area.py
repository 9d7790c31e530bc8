"""Area and centre of facets, also of curved ones."""

import numpy as np

from hpcinv.mesh.cells import FACET_KIND, quadrature, scalar_element
from hpcinv.mesh.source import Floats, Ints, MeshSource

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
