"""Cell kinds: reference nodes, sub-entities and node orders, taken from Basix and never from tables of our own."""

from __future__ import annotations

from functools import cache
from typing import Any

import hpcinv.runtime  # noqa: F401  (import order)

import basix
import basix.ufl
import numpy as np
import numpy.typing as npt

from hpcinv.errors import MeshError
from hpcinv.mesh.source import Floats, Ints

FACET_KIND = {"tetrahedron": "triangle", "hexahedron": "quadrilateral"}
DEGREES = (1, 2)


@cache
def coordinate_element(kind: str, degree: int) -> Any:
    """The vector-valued Lagrange element that carries the coordinates of a mesh."""
    return basix.ufl.element("Lagrange", kind, degree, basix.LagrangeVariant.equispaced, shape=(3,))


@cache
def scalar_element(kind: str, degree: int) -> basix.finite_element.FiniteElement:
    """One component of the coordinate element; its ``points`` are the reference nodes in the order of DOLFINx."""
    return basix.create_element(
        basix.ElementFamily.P, basix.CellType[kind], degree, basix.LagrangeVariant.equispaced
    )


@cache
def sub_entities(kind: str, dim: int) -> Ints:
    """Local vertices of the sub-entities of dimension ``dim``, (number, vertices each)."""
    return np.array(basix.topology(basix.CellType[kind])[dim], dtype=np.int64)


def vertex_count(kind: str) -> int:
    """Number of vertices of a cell."""
    return len(basix.geometry(basix.CellType[kind]))


def node_order(kind: str, degree: int, theirs: npt.ArrayLike) -> Ints:
    """Permutation p with ``dolfinx_cells = their_cells[:, p]``, found by matching the reference nodes of the two.

    ``theirs`` are the other format's reference nodes in its own order, on [0, 1] or [-1, 1].
    """
    ours = scalar_element(kind, degree).points
    other = np.asarray(theirs, dtype=float)
    other = (other - other.min()) / (other.max() - other.min())
    distance = np.abs(ours[:, None, :] - other[None, :, :]).max(axis=2)
    order = distance.argmin(axis=1)
    if len(ours) != len(other) or distance.min(axis=1).max() > 1e-6 or len(set(order)) != len(order):
        raise MeshError(
            f"{len(other)}-node {kind}s of degree {degree} are not supported: a node is needed at every Lagrange point",
            "Use complete elements (gmsh: Mesh.SecondOrderIncomplete = 0).",
        )
    return order.astype(np.int64)


def jacobians(kind: str, degree: int, corners: Floats, at: Floats) -> Floats:
    """Jacobians ∂x/∂ξ (cells, points, 3, 3) of cells with node coordinates ``corners`` (cells, nodes, 3)."""
    gradients = scalar_element(kind, degree).tabulate(1, at)[1:, :, :, 0]
    return np.einsum("cni,dpn->cpid", corners, gradients)
