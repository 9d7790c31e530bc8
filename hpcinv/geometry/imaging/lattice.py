"""Tetrahedra in the labelled cells of a grid, and the facets between different labels."""

from dataclasses import dataclass
from itertools import permutations

import numpy as np
import numpy.typing as npt

from hpcinv.mesh.source import Floats, Ints


@dataclass(frozen=True)
class Lattice:
    """Tetrahedra with labels; 0 is outside, where there may be cells, too.

    Attributes:
        points: (n, 3).
        cells: (m, 4), of positive volume.
        labels: of cells, (m,).
    """

    points: Floats
    cells: Ints
    labels: Ints

    def volumes(self, points: Floats | None = None) -> Floats:
        """Volumes of the cells, also with their nodes at other ``points``."""
        corners = (self.points if points is None else points)[self.cells]
        a, b, c = (corners[:, i] - corners[:, 0] for i in (1, 2, 3))
        return np.asarray(np.einsum("ij,ij->i", a, np.cross(b, c)) / 6)


def scaled_jacobians(corners: Floats) -> Floats:
    """Scaled Jacobian of tetrahedra (n, 4, 3): 1 for regular ones, 0 for flat ones, negative for inverted ones.

    Source: Knupp et al., "The Verdict geometric quality library" (2006), SAND2007-1751.
    """
    a, b, c = (corners[:, i] - corners[:, 0] for i in (1, 2, 3))
    edges = (a, b, c, b - a, c - a, c - b)
    la, lb, lc, ab, ac, bc = (np.sqrt(np.einsum("ij,ij->i", edge, edge)) for edge in edges)
    largest = np.maximum(np.maximum(la * lb * lc, la * ab * ac), np.maximum(lb * ab * bc, lc * ac * bc))
    return np.asarray(np.sqrt(2) * np.einsum("ij,ij->i", a, np.cross(b, c)) / np.maximum(largest, 1e-300))


def lattice_of(labels: Ints, spacing: float, chosen: npt.NDArray[np.bool_]) -> Lattice:
    """Divide each chosen grid cell into six tetrahedra, whose facets fit its neighbours' facets.

    Source: Kuhn, "Some combinatorial lemmas in topology" (1960), doi:10.1147/rd.45.0518.
    """
    shape = np.array(labels.shape) + 1
    number = np.arange(shape.prod()).reshape(shape)
    corners, cell_labels = np.argwhere(chosen), labels[chosen]
    cells = []
    for order in permutations(range(3)):
        here, chain = corners.copy(), [number[tuple(corners.T)]]
        for axis in order:
            here[:, axis] += 1
            chain.append(number[tuple(here.T)])
        is_even = np.linalg.det(np.eye(3)[list(order)]) > 0
        cells.append(np.stack([chain[i] for i in ((0, 1, 2, 3) if is_even else (0, 2, 1, 3))], axis=1))
    used, compact = np.unique(np.concatenate(cells), return_inverse=True)
    points: Floats = spacing * np.stack(np.unravel_index(used, tuple(shape)), axis=1).astype(np.float64)
    return Lattice(points, compact.reshape(-1, 4).astype(np.int64), np.tile(cell_labels, 6))


def drop_outside(lattice: Lattice, points: Floats) -> tuple[Lattice, Floats]:
    """Return the cells with a label and their nodes, also at other ``points``."""
    is_labelled = lattice.labels > 0
    used, rows = np.unique(lattice.cells[is_labelled], return_inverse=True)
    kept = Lattice(lattice.points[used], rows.reshape(-1, 4).astype(np.int64), lattice.labels[is_labelled])
    return kept, points[used]


OUTWARD = ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))
"""nodes of the facets of a tetrahedron"""


def interfaces(cells: Ints, labels: Ints) -> tuple[Ints, Ints]:
    """Facets (n, 3) between different labels, and the two labels of each (n, 2), the smaller one first."""
    facets = np.concatenate([cells[:, side] for side in OUTWARD])
    facet_labels = np.tile(labels, 4)
    key = np.sort(facets, axis=1)
    order = np.lexsort(key.T[::-1])
    key = key[order]
    first = np.flatnonzero(np.concatenate([[True], (key[1:] != key[:-1]).any(axis=1)]))
    count = np.diff(np.append(first, len(key)))
    label, last = facet_labels[order][first], facet_labels[order][np.minimum(first + 1, len(key) - 1)]
    other = np.where(count == 2, last, 0)
    differ = label != other
    pairs = np.stack([np.minimum(label, other), np.maximum(label, other)], axis=1)[differ]
    return facets[order][first][differ], pairs
