"""Nearest points of gmsh's current model to the facets of its mesh.

``setOrder`` and ``getClosestPoint`` of gmsh search for the parameters of each point from scratch, which can take a
millisecond. Here they are interpolated from the nodes', and corrected by the Gauss–Newton method.
"""

from typing import Any

import numpy as np

from hpcinv.mesh.cells import FACET_KIND, scalar_element
from hpcinv.mesh.io.gmsh_model import ElementType
from hpcinv.mesh.source import CadSurface, Floats, Ints
from hpcinv.mesh.topology import find_rows

_STEPS = 8
_NEAR = 0.1  # distance from the first guess, relative to the facet, beyond which another one is tried
_SMALL = 1e-4  # size of the last step, relative to the facet: the distance depends on its square


def cad_surface(gmsh: Any, kind: str, degree: int) -> CadSurface | None:
    """Facets of gmsh's current mesh, with the points of the CAD surfaces next to the nodes of twice the ``degree``.

    ``None`` if surfaces of the model have no geometry of their own, or the generator wants their facets straight.

    The mesh is left with its vertices only.

    Args:
        kind: of the cells.
        degree: of the cells.
    """
    surfaces = gmsh.model.getEntities(2)
    wants_straight = gmsh.option.getNumber("Mesh.SecondOrderLinear") != 0
    if not surfaces or wants_straight or any(gmsh.model.getType(*s).startswith("Discrete") for s in surfaces):
        return None
    mesh, facet = gmsh.model.mesh, FACET_KIND[kind]
    reference_nodes = scalar_element(facet, 2 * degree).points
    shapes, straight = (scalar_element(facet, d).tabulate(0, reference_nodes)[0, :, :, 0] for d in (degree, 1))
    given = [_facets(gmsh, tag, ElementType.query(gmsh, facet, degree)) for _, tag in surfaces]
    mesh.setOrder(1)  # numbers the nodes again; nodes of degree 2 may have no parameters
    vertices, nodes = [np.zeros((0, straight.shape[1]), np.int64)], [np.zeros((0, len(reference_nodes), 3))]
    for (_, tag), (facet_nodes, points) in zip(surfaces, given, strict=True):
        if not len(facet_nodes):
            continue
        corners, places = _facets(gmsh, tag, ElementType.query(gmsh, facet, 1))
        try:
            tags, _, parameters = mesh.getNodes(2, tag, True, True)
        except Exception:  # gmsh raises nothing narrower
            return None
        if not np.array_equal(places, points[:, : corners.shape[1]]) or len(parameters) != 2 * len(tags):
            return None
        vertices.append(facet_nodes[:, : corners.shape[1]])
        nodes.append(_closest(gmsh, tag, shapes, straight, points, parameters.reshape(-1, 2)[_rows(tags, corners)]))
    return CadSurface(2 * degree, np.concatenate(vertices), np.concatenate(nodes))


def _facets(gmsh: Any, entity: int, element: ElementType) -> tuple[Ints, Floats]:
    """Tags (f, n) and coordinates (f, n, 3) of the nodes of all facets of a surface, in the node order of DOLFINx."""
    node_tags = gmsh.model.mesh.getElementsByType(element.code, entity)[1].astype(np.int64)
    facet_nodes = node_tags.reshape(-1, element.size)[:, element.order]
    tags, coordinates, _ = gmsh.model.mesh.getNodes(2, entity, True, False)
    return facet_nodes, coordinates.reshape(-1, 3)[_rows(tags, facet_nodes)] if len(facet_nodes) else np.zeros(
        (0, element.size, 3)
    )


def _rows(tags: Any, wanted: Ints) -> Ints:
    """Row of each of the ``wanted`` tags in ``tags``."""
    return find_rows(wanted.reshape(-1, 1), tags.astype(np.int64)[:, None]).reshape(wanted.shape)


def _closest(gmsh: Any, entity: int, shapes: Floats, straight: Floats, given: Floats, parameters: Floats) -> Floats:
    """Points (f, l, 3) of a CAD surface next to the nodes of facets with a geometry of a higher degree.

    Args:
        shapes: shape functions (l, n) of the given nodes at these nodes.
        straight: the same of the vertices (l, v) on straight facets.
        given: nodes (f, n, 3) of the facets, vertices first.
        parameters: of the vertices (f, v, 2); they may jump by a period within a facet.
    """

    def surface(uv: Floats) -> Floats:
        return np.asarray(gmsh.model.getValue(2, entity, uv.ravel())).reshape(-1, 3)

    new = np.abs(shapes).max(axis=1) < 1 - 1e-9
    wanted, uv = (shapes[new] @ given).reshape(-1, 3), (straight[new] @ parameters).reshape(-1, 2)
    size = np.repeat(np.linalg.norm(np.ptp(given, axis=1), axis=1), new.sum())
    closest = surface(uv)
    far = np.linalg.norm(wanted - closest, axis=1) > _NEAR * size
    facet = np.flatnonzero(far) // new.sum()
    nearest = np.linalg.norm(given[facet, : parameters.shape[1]] - wanted[far, None], axis=2).argmin(axis=1)
    uv[far] = parameters[facet, nearest]
    closest[far] = surface(uv[far])
    left = np.arange(len(uv))
    for _ in range(_STEPS):
        if not len(left):
            break
        tangents = np.reshape(gmsh.model.getDerivative(2, entity, uv[left].ravel()), (-1, 2, 3)).swapaxes(1, 2)
        step = np.linalg.pinv(tangents) @ (wanted - closest)[left, :, None]
        uv[left] += step[..., 0]
        closest[left] = surface(uv[left])
        left = left[~(np.linalg.norm((tangents @ step)[..., 0], axis=1) <= _SMALL * size[left])]
    lost = np.union1d(left, np.flatnonzero(~(np.linalg.norm(wanted - closest, axis=1) <= size)))
    if len(lost):
        closest[lost] = np.reshape(gmsh.model.getClosestPoint(2, entity, wanted[lost].ravel())[0], (-1, 3))
    nodes = shapes @ given
    nodes[:, new] = closest.reshape(len(given), -1, 3)
    return nodes
