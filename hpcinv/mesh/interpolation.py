"""Interpolation between Lagrange spaces on the same cells, whose geometry may differ."""

import numpy as np
from dolfinx import fem

from hpcinv.mesh.checks import CHUNK


def interpolate(source: fem.Function, target: fem.Function) -> None:
    """Interpolate a scalar or vector in the space of ``target``, by reference coordinates of the cells.

    The meshes may be two of `hpcinv.mesh.body.replace_geometry`. The matrix is the same in all cells, so that this
    takes a fraction of the time of DOLFINx's ``interpolate``, which needs a space on the other mesh besides.
    """
    here, there = target.function_space, source.function_space
    matrix = there.element.basix_element.tabulate(0, here.element.basix_element.points)[0, :, :, 0]
    values, results = (f.x.array.reshape(-1, here.dofmap.bs) for f in (source, target))
    cells = np.arange(len(here.dofmap.list))
    with np.errstate(invalid="ignore", over="ignore"):  # values of a solve that failed may not be finite
        for part in np.array_split(cells, 1 + len(cells) // CHUNK):
            results[here.dofmap.list[part]] = matrix @ values[there.dofmap.list[part]]
