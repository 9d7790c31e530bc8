"""Cells in which a fibre field has no limit at some point, as helices have none on the axis of a ventricle.

Cells that hold such a point are found by bisection: in smaller and smaller pieces around it, the direction varies as
much as before, whereas a smooth field varies half as much in a piece half as large. Strains are bounded there
but have no limit either, so that ``u ~ r``, which no degree of elements resolves. Only formulas are examined:
directions of a rule or of a data array are nodal or constant in a cell.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from hpcinv.job.job import Job
from hpcinv.mesh import Body
from hpcinv.mesh.cells import kind_and_degree, scalar_element
from hpcinv.mesh.source import Floats, Ints
from hpcinv.model.fields import formula_values

TURN = 0.03
"""Mean squared sine of the angles between directions in a piece and their main one, above which it is bisected. Larger:
jumps of small angles are missed."""
PIECES = 8
"""Largest number of pieces of a cell that are bisected. Larger: slower. Smaller: the point may be lost."""
BISECTIONS = 8
"""Number of bisections after which a turning field is singular. Larger: steep smooth fields count less often."""
_CORNERS = np.array(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij")).reshape(3, 8).T
_SAMPLES = 0.1 + 0.8 * _CORNERS  # inside of a piece, since a formula may have no value at the point itself


def singular_fibres(job: Job, body: Body, nodes: Mapping[str, Floats]) -> tuple[Ints, Floats]:
    """Return the owned cells in which a family of fibres is singular, and such a point of each, (n, 3) m.

    Args:
        nodes: local geometry nodes (m) of the configurations on which families are given.
    """
    mesh = body.mesh
    kind, degree = kind_and_degree(mesh)
    owned = mesh.topology.index_map(3).size_local
    chosen, points = [np.zeros(0, dtype=np.int64)], [np.zeros((0, 3))]
    for family in job.families.values():
        ((direction, _),) = family.quantities().values()
        if not isinstance(direction, tuple):  # of formulas
            continue
        corners = nodes[family.given_on][mesh.geometry.dofmaps[0][:owned]]

        def positions(cells: Ints, local: Floats, corners: Floats = corners) -> Floats:
            shapes = scalar_element(kind, degree).tabulate(0, _reference_points(kind, local).reshape(-1, 3))[0, :, :, 0]
            return np.asarray(
                np.einsum("cpn,cnd->cpd", shapes.reshape(*local.shape[:2], shapes.shape[-1]), corners[cells])
            )

        def unit(cells: Ints, local: Floats, direction: Any = direction, positions: Any = positions) -> Floats:
            x = positions(cells, local)
            vectors = np.stack([formula_values(part, x) for part in direction], axis=-1)
            return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))

        cells, places = singular_pieces(owned, unit)
        chosen.append(cells)
        points.append(positions(cells, places[:, None, :])[:, 0])
    cells, first = np.unique(np.concatenate(chosen), return_index=True)
    return cells, np.concatenate(points)[first]


def singular_pieces(count: int, unit: Callable[[Ints, Floats], Floats]) -> tuple[Ints, Floats]:
    """Return the cells in which a direction is singular, and the place of that in each, in [0, 1]³.

    Args:
        count: number of cells.
        unit: unit vectors (n, p, 3) in cells (n,) at places (n, p, 3) in [0, 1]³; they may point either way.
    """
    cells, low, size = np.arange(count), np.zeros((count, 3)), 1.0
    chosen = _turning(cells, low, size, unit)
    cells, low = cells[chosen], low[chosen]
    for _ in range(BISECTIONS):
        size /= 2
        cells, low = np.repeat(cells, 8), (low[:, None] + size * _CORNERS).reshape(-1, 3)
        chosen = _turning(cells, low, size, unit)
        cells, low = cells[chosen], low[chosen]
    cells, first = np.unique(cells, return_index=True)
    return cells, low[first] + size / 2


def _turning(cells: Ints, low: Floats, size: float, unit: Callable[[Ints, Floats], Floats]) -> Ints:
    """Return the pieces in which the direction turns, at most `PIECES` of each cell, those with the most turn first."""
    if not len(cells):
        return np.zeros(0, dtype=np.int64)
    directions = np.nan_to_num(unit(cells, low[:, None] + size * _SAMPLES))
    means = np.einsum("cpi,cpj->cij", directions, directions) / len(_SAMPLES)
    turn = np.trace(means, axis1=1, axis2=2) - np.linalg.eigvalsh(means)[:, -1]
    order = np.lexsort((-turn, cells))
    order = order[turn[order] > TURN]
    _, starts, counts = np.unique(cells[order], return_index=True, return_counts=True)
    rank = np.arange(len(order)) - np.repeat(starts, counts)
    return np.asarray(order[rank < PIECES])


def _reference_points(kind: str, places: Floats) -> Floats:
    """Return places in [0, 1]³ in the reference cell; faces or edges of the cube may collapse in it."""
    a, b, c = np.moveaxis(places, -1, 0)
    match kind:
        case "tetrahedron":
            return np.stack([a, b * (1 - a), c * (1 - a) * (1 - b)], axis=-1)
        case "prism":
            return np.stack([a, b * (1 - a), c], axis=-1)
        case "pyramid":
            return np.stack([a * (1 - c), b * (1 - c), c], axis=-1)
        case _:
            return places
