"""Cell kinds: reference nodes, sub-entities and node orders, all taken from Basix."""

from functools import cache
from pathlib import Path
from typing import Any

import basix
import basix.ufl
import dolfinx
import numpy as np

from hpcinv.errors import MeshError
from hpcinv.mesh.source import Floats, Ints
from hpcinv.mesh.tetrahedron_rules import has_rule, tetrahedron_rule

FACET_KIND = {"tetrahedron": "triangle", "hexahedron": "quadrilateral"}
DEGREES = (1, 2)
"""Geometry degrees that a job may choose."""


@cache
def coordinate_element(kind: str, degree: int) -> Any:
    """Vector-valued Lagrange element of the coordinates of a mesh."""
    return basix.ufl.element("Lagrange", kind, degree, basix.LagrangeVariant.equispaced, shape=(3,))


@cache
def scalar_element(kind: str, degree: int) -> Any:
    """One component of the coordinate element; its ``points`` are the reference nodes in the order of DOLFINx."""
    return basix.create_element(basix.ElementFamily.P, basix.CellType[kind], degree, basix.LagrangeVariant.equispaced)


def quadrature(kind: str, degree: int) -> tuple[Floats, Floats]:
    """Quadrature points (n, 3) and weights (n,) of integrals over reference cells.

    Up to degree 20 all weights are positive, and the points do not depend on the order in which a file lists the
    vertices of a cell. The rules of Basix on tetrahedra lack the first at degrees 3, 7 and 8: with them a stable body
    may lose its stability, and the second from degree 9 on.
    """
    if kind == "tetrahedron" and has_rule(degree):
        return tetrahedron_rule(degree)
    points, weights = basix.make_quadrature(basix.CellType[kind], degree)
    return points, weights


def quadrature_metadata(kind: str, degree: int) -> dict[str, Any]:
    """Metadata of a UFL measure over cells that give it the points and weights of `quadrature`."""
    if kind != "tetrahedron" or not has_rule(degree):
        return {"quadrature_degree": degree, "quadrature_rule": "default"}
    points, weights = _nested(degree)
    custom = {"quadrature_points": points, "quadrature_weights": weights}
    return {"quadrature_degree": degree, "quadrature_rule": "custom"} | custom


@cache
def _nested(degree: int) -> tuple[tuple[tuple[float, ...], ...], tuple[float, ...]]:
    """A rule on tetrahedra as tuples, which UFL writes into signatures with all their digits."""
    points, weights = tetrahedron_rule(degree)
    return tuple(map(tuple, points.tolist())), tuple(weights.tolist())


@cache
def sub_entities(kind: str, dim: int) -> Ints:
    """Local vertices of the sub-entities of dimension ``dim``: (sub-entities, vertices of each)."""
    return np.array(basix.topology(basix.CellType[kind])[dim], dtype=np.int64)


def vertex_count(kind: str) -> int:
    return len(basix.geometry(basix.CellType[kind]))


def degree_of(path: Path, kind: str, nodes: int) -> int:
    """Geometry degree of a cell with this number of nodes; raises ``MeshError`` if it is not supported."""
    degrees = {scalar_element(kind, degree).dim: degree for degree in DEGREES}
    if nodes not in degrees:
        raise MeshError(
            f"{path}: {kind}s of {nodes} nodes are not supported",
            f"Supported are {' and '.join(map(str, degrees))} nodes: geometry of degree 1 (flat) and 2 (curved).",
        )
    return degrees[nodes]


def no_cells(kind: str, degree: int) -> Ints:
    """Empty node array of cells or facets."""
    return np.zeros((0, scalar_element(kind, degree).dim), dtype=np.int64)


def node_order(kind: str, degree: int, theirs: Floats) -> Ints:
    """Permutation p with ``dolfinx_cells = other_cells[:, p]``, found by matching reference nodes.

    ``theirs`` are the reference nodes of the other format in its order, on [0, 1] or [-1, 1].
    """
    ours: Floats = scalar_element(kind, degree).points
    other = (theirs - theirs.min()) / (theirs.max() - theirs.min())
    distance = np.abs(ours[:, None, :] - other[None, :, :]).max(axis=2)
    return np.asarray(distance.argmin(axis=1), dtype=np.int64)


@cache
def vtk_order(kind: str, degree: int) -> Ints:
    """Permutation p with ``dolfinx_cells = vtk_cells[:, p]``; XDMF has the same order."""
    nodes = scalar_element(kind, degree).dim
    perm_vtk = dolfinx.cpp.io.perm_vtk
    return np.array(perm_vtk(dolfinx.mesh.to_type(kind), nodes), dtype=np.int64)


def kind_and_degree(mesh: dolfinx.mesh.Mesh) -> tuple[str, int]:
    """Kind and geometry degree of the cells of a mesh."""
    return mesh.basix_cell().name, mesh.ufl_domain().ufl_coordinate_element().degree


def jacobians(kind: str, degree: int, nodes: Floats, reference_points: Floats) -> Floats:
    """Jacobians ∂x/∂ξ (cells, points, 3, 3) at reference points of cells with node coordinates ``nodes`` (c, n, 3)."""
    gradients: Floats = scalar_element(kind, degree).tabulate(1, reference_points)[1:, :, :, 0]
    # Much faster than einsum without a path, or than a product for each cell: (3·c, n) × (3·p, n)ᵀ.
    flat = nodes.transpose(0, 2, 1).reshape(-1, nodes.shape[1]) @ gradients.reshape(-1, gradients.shape[2]).T
    return np.asarray(flat.reshape(len(nodes), 3, 3, len(reference_points)).transpose(0, 3, 1, 2))
