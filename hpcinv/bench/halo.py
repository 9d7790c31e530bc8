"""What parts of a mesh have in common with each other: how many neighbours, and how many vertices between them.

Of parts that METIS makes of a cube, with as many cells in each, so that only their number matters.
"""

from __future__ import annotations

from dataclasses import dataclass

import hpcinv.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
import numpy as np
import numpy.typing as npt
from scipy import sparse

from hpcinv.mesh.io.gmsh_model import metis

_CELLS = 384  # of a part
# A brick as six tetrahedra around its diagonal: one for each order in which the axes are gone along.
_ORDERS = ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0))


@dataclass(frozen=True)
class Halo:
    """Means over the parts.

    Attributes:
        neighbours: other parts with a vertex in common.
        surface: vertices that other parts have too, over the 2/3 power of all vertices of the part.
    """

    neighbours: float
    surface: float


def halo(parts: int) -> Halo:
    """Of a cube in this many parts."""
    if parts == 1:
        return Halo(0.0, 0.0)
    cells = tetrahedra(round((parts * _CELLS / 6) ** (1 / 3)))
    part = metis(cells, "tetrahedron", parts)
    has = sparse.csr_array(
        (np.ones(cells.size, dtype=np.int32), (np.repeat(part, cells.shape[1]), cells.ravel())),
        shape=(parts, int(cells.max()) + 1),
    )
    has.data[:] = 1
    shared = np.asarray(has.sum(axis=0)).ravel() > 1
    common = (has @ has.T).tocsr()
    neighbours = np.diff(common.indptr) - 1
    surface = (has @ shared.astype(np.int64)) / np.diff(has.indptr) ** (2 / 3)
    return Halo(float(neighbours.mean()), float(surface.mean()))


def tetrahedra(divisions: int) -> npt.NDArray[np.int64]:
    """Vertices of the cells of a cube in n × n × n bricks, (6 n³, 4)."""
    n = divisions + 1
    stride = np.array([1, n, n * n])
    first = np.stack(np.meshgrid(*[np.arange(divisions)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) @ stride
    paths = np.array([np.cumsum([0, *stride[list(order)]]) for order in _ORDERS])
    return np.asarray((first[:, None, None] + paths).reshape(-1, 4), dtype=np.int64)
