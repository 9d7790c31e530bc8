"""Cell quality of a moved body: the worst cell, and its position.

===================  ============================================================================
tetrahedra           mean ratio ``12 (3V)^(2/3) / Σ lᵢⱼ²``: 1 of the regular one, 0 of a flat one
hexahedra            scaled Jacobian: the least ``det(e₁ e₂ e₃) / |e₁||e₂||e₃|`` of the edges at
                     the corners, and of the axes through the middle: 1 of a brick, 0 of a flat one
curved cells, also   ``min det ∂x/∂ξ / max det ∂x/∂ξ`` in the cell: 1 where nothing is curved
===================  ============================================================================

Each is negative in a cell that is inside out. The first two measure the straight cells between the corners.

Source: Liu & Joe, "Relationship between tetrahedron shape measures" (1994), doi:10.1007/BF01955874; Knupp, "Achieving
finite element mesh quality …, part II" (2000), doi:10.1002/(SICI)1097-0207(20000720)48:8<1165::AID-NME940>3.0.CO;2-Y;
Johnen, Remacle & Geuzaine, "Geometrical validity of curvilinear finite elements" (2013), doi:10.1016/j.jcp.2012.08.051.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from hpcinv.mesh import Body
from hpcinv.mesh.cells import jacobians, quadrature, scalar_element
from hpcinv.mesh.checks import CHUNK, det
from hpcinv.mesh.source import Floats

CURVATURE = "curvature"


@dataclass(frozen=True)
class Worst:
    """Least quality of a cell of the moved body, the centre (m) of that cell, and the least of the given body."""

    measure: str
    value: float
    point: tuple[float, float, float]
    given_value: float


def worst_cells(body: Body, mesh_nodes: Floats, other_nodes: Floats, quadrature_degree: int) -> tuple[Worst, ...]:
    """Find the worst cell by shape and, where cells are curved, by curvature, which decides; collective.

    Args:
        mesh_nodes: local geometry nodes (n, 3) m of the body that the mesh was made for.
        other_nodes: of the body to judge.
        quadrature_degree: of the rule at whose points, and at the nodes, Jacobians are sampled.
    """
    kind, degree = body.source.kind, body.degree
    tetrahedra = kind == "tetrahedron"
    name, shape = ("mean ratio", mean_ratio) if tetrahedra else ("scaled Jacobian", scaled_jacobian)
    cells = [_worst(name, shape, body, mesh_nodes, other_nodes)]
    if degree > 1:
        points, _ = quadrature(kind, quadrature_degree)
        samples = np.concatenate([points, scalar_element(kind, degree).points])
        cells.append(
            _worst(CURVATURE, lambda nodes: curvature(kind, degree, nodes, samples), body, mesh_nodes, other_nodes)
        )
    return tuple(cells)


def mean_ratio(nodes: Floats) -> Floats:
    """Return the quality of tetrahedra with nodes (cells, nodes, 3), corners first."""
    v = nodes[:, :4]
    six_volumes = det(v[:, 1:] - v[:, :1])
    squares = sum(((v[:, i] - v[:, j]) ** 2).sum(axis=1) for i, j in combinations(range(4), 2))
    return np.asarray(12 * np.sign(six_volumes) * (np.abs(six_volumes) / 2) ** (2 / 3) / squares)


def scaled_jacobian(nodes: Floats) -> Floats:
    """Return the quality of hexahedra with nodes (cells, nodes, 3), corners first."""
    corners: Floats = scalar_element("hexahedron", 1).points
    reference_points = np.concatenate([corners, corners.mean(axis=0, keepdims=True)])
    gradients = jacobians("hexahedron", 1, nodes[:, : len(corners)], reference_points)
    lengths = np.linalg.norm(gradients, axis=2).prod(axis=2)
    determinants = det(gradients)
    shapes: Floats = np.divide(determinants, lengths, out=np.zeros_like(lengths), where=lengths > 0)
    return np.asarray(shapes.min(axis=1))


def curvature(kind: str, degree: int, nodes: Floats, reference_points: Floats) -> Floats:
    """Return least over largest Jacobian determinant of cells (cells, nodes, 3) at reference points (n, 3)."""
    determinants = det(jacobians(kind, degree, nodes, reference_points))
    least, largest = determinants.min(axis=1), np.abs(determinants).max(axis=1)
    ratios: Floats = np.divide(least, largest, out=np.zeros_like(least), where=largest > 0)
    return ratios


def _worst(
    measure: str, measured: Callable[[Floats], Floats], body: Body, mesh_nodes: Floats, other_nodes: Floats
) -> Worst:
    mesh, kind = body.mesh, body.source.kind
    dofmap = mesh.geometry.dofmaps[0][: mesh.topology.index_map(3).size_local]
    corners: Floats = scalar_element(kind, 1).points
    given_least, here = (np.inf,), (np.inf, (np.nan,) * 3)
    for start in range(0, len(dofmap), CHUNK):
        cells = dofmap[start : start + CHUNK]
        # In a mesh that is left-handed throughout, the mirror images of the cells are judged.
        middle = jacobians(kind, body.degree, mesh_nodes[cells], corners.mean(axis=0, keepdims=True))
        mirror = np.where(det(middle[:, 0]) < 0, -1.0, 1.0)[:, None, None] ** np.array([1, 0, 0])
        values = measured(other_nodes[cells] * mirror)
        worst = int(values.argmin())
        middle = other_nodes[cells[worst, : len(corners)]].mean(axis=0)
        here = min(here, (float(values[worst]), tuple(middle.tolist())))
        given_least = min(given_least, (float(measured(mesh_nodes[cells] * mirror).min()),))
    value, point = min(mesh.comm.allgather(here))
    return Worst(measure, value, point, min(mesh.comm.allgather(given_least))[0])
