"""Cell kinds: reference nodes, sub-entities and node orders, all taken from Basix."""

import math
from functools import cache
from pathlib import Path
from typing import Any, Self

import basix
import basix.ufl
import dolfinx
import numpy as np

from hpcinv.errors import MeshError
from hpcinv.mesh.source import Floats, Ints
from hpcinv.mesh.tetrahedron_rules import has_rule, tetrahedron_rule

FACET_KIND = {"tetrahedron": "triangle", "hexahedron": "quadrilateral"}
EDGE_KIND = {"quadrilateral": "interval", "triangle": "interval"}
"""facets of the cells of a shell's surface"""
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


class LayerDegree(int):
    """Quadrature degree ``2 k`` of one layer of hexahedra, whose third reference axis goes through the layer.

    Integrals over facets have the degree itself. Integrals over cells have k × k Gauss points in the plane and k + 1
    through the layer. Thin cells then bend without strain of their midsurface (they do not lock). Displacements such as
    (3ξ² - 1)(3η² - 1), for k = 2, have no gradient at the k × k points: (k + 1)² points with a share of all weights
    hold them. A share of (thickness / diameter)² does so, by about the stiffness in bending, without locking.

    Source: Arnold & Brezzi, Math. Comp. 66 (217), 1–14, 1997 (partial selective reduced integration).

    Args:
        slenderness: diameter of the cells by their thickness.
    """

    largest = 1 / 16
    """share of cells as thick as wide; raised, thick cells are stiffer"""

    def __new__(cls, degree: int, slenderness: float) -> Self:
        """Return the degree, with a share rounded to a power of 4: similar meshes have the same kernels."""
        self = super().__new__(cls, degree)
        self.share = min(cls.largest, 4.0 ** -round(math.log(max(slenderness, 1.0), 2)))
        return self

    share: float


@cache
def _layer_rule(degree: int, share: float) -> tuple[Floats, Floats]:
    """Points (n, 3) and weights (n,) on hexahedra of a layer."""
    line, line_weights = basix.make_quadrature(basix.CellType.interval, degree + 1)
    points, weights = list[Floats](), list[Floats]()
    for plane_degree, part in ((degree - 1, 1 - share), (degree + 1, share)):
        plane, plane_weights = basix.make_quadrature(basix.CellType.quadrilateral, plane_degree)
        points.append(np.column_stack([np.repeat(plane, len(line), axis=0), np.tile(line[:, 0], len(plane))]))
        weights.append(part * np.outer(plane_weights, line_weights).ravel())
    return np.concatenate(points), np.concatenate(weights)


def layer_interpolation(degree: int, places: Floats) -> tuple[Floats, Floats]:
    """Return the k × k × (k + 1) points of a layer of `LayerDegree` 2 k, and the weights of values there at places.

    These are the first points of its quadrature. At others a shell's stress has parts that they do not see, which may
    be larger than the stress.

    Returns:
        Points (m, 3), and weights (n, m) for places (n, 3) on the reference cell.
    """
    lines = [basix.make_quadrature(basix.CellType.interval, degree + extra)[0][:, 0] for extra in (-1, -1, 1)]
    points = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)
    shares = []
    for line, at in zip(lines, places.T, strict=True):
        powers = np.arange(len(line))
        shares.append(np.linalg.solve((line[:, None] ** powers).T, (at[:, None] ** powers).T))
    return points, np.einsum("in,jn,kn->nijk", *shares).reshape(len(places), len(points))


def quadrature(kind: str, degree: int) -> tuple[Floats, Floats]:
    """Quadrature points (n, 3) and weights (n,) of integrals over reference cells.

    Up to degree 20 all weights are positive, and the points do not depend on the order in which a file lists the
    vertices of a cell. The rules of Basix on tetrahedra lack the first at degrees 3, 7 and 8: with them a stable body
    may lose its stability, and the second from degree 9 on.
    """
    if isinstance(degree, LayerDegree):
        return _layer_rule(int(degree), degree.share)
    if kind == "tetrahedron" and has_rule(degree):
        return tetrahedron_rule(degree)
    points, weights = basix.make_quadrature(basix.CellType[kind], degree)
    return points, weights


def quadrature_metadata(kind: str, degree: int) -> dict[str, Any]:
    """Metadata of a UFL measure over cells that give it the points and weights of `quadrature`."""
    if not isinstance(degree, LayerDegree) and (kind != "tetrahedron" or not has_rule(degree)):
        return {"quadrature_degree": degree, "quadrature_rule": "default"}
    points, weights = _nested(kind, degree, getattr(degree, "share", 0.0))
    custom = {"quadrature_points": points, "quadrature_weights": weights}
    return {"quadrature_degree": degree, "quadrature_rule": "custom"} | custom


@cache
def _nested(kind: str, degree: int, _share: float) -> tuple[tuple[tuple[float, ...], ...], tuple[float, ...]]:
    """A rule as tuples, which UFL writes into signatures with all their digits."""
    points, weights = quadrature(kind, degree)
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
        remedy = "Save the mesh with degree 2 (gmsh: model.mesh.setOrder(2))."
        if kind == "hexahedron" and nodes == 20:
            remedy = "Save 27 (gmsh: Mesh.SecondOrderIncomplete = 0), or another format: 20 are read from .inp or .unv."
        raise MeshError(
            f"{path}: {kind}s of {nodes} nodes are not supported",
            f"Supported are {' and '.join(map(str, degrees))} nodes. {remedy}",
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


def mirrored(kind: str, degree: int, cells: Ints) -> Ints:
    """Cells whose first two axes are exchanged, so that they have the opposite orientation."""
    points = scalar_element(kind, degree).points
    return np.asarray(cells[:, node_order(kind, degree, points[:, [1, 0, *range(2, points.shape[1])]])])


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
