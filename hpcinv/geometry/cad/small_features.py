"""Small rounded faces of CAD files that make a mesh large: their radius, and the `grade` that leaves them coarser."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from hpcinv.base.quantity.units import readable
from hpcinv.mesh.cell_count import rounded

_MANY = 5000
"""Cells from which features are looked for; smaller meshes are solved in seconds."""
_TIMES = 10.0
"""Cells relative to a mesh of equal cells from which features are named; thin walls alone make 3 to 8."""
_REGULAR = 6 * math.sqrt(2)
"""Regular tetrahedra in the cube of their edge."""


def report_small_features(gmsh: Any, size: float, grade: float, unit: float, report: Callable[[str], None]) -> None:
    """Report the smallest rounded face of a meshed model, if such faces make most of its cells.

    Args:
        size: largest edge, in the unit of the file.
        grade: ``size`` over the smallest edge.
        unit: of the file, in m.
    """
    cells = sum(len(tags) for tags in gmsh.model.mesh.getElements(3)[1])
    volume = sum(gmsh.model.occ.getMass(3, tag) for _, tag in gmsh.model.getEntities(3))
    times = cells / max(volume / size**3 * _REGULAR, 1.0)
    if cells < _MANY or times < _TIMES or grade <= 1:
        return
    radii = {tag: _radius(gmsh, tag) for _, tag in gmsh.model.getEntities(2)}
    face = min(radii, key=lambda tag: radii[tag])
    if not radii[face] < size:
        return
    names = [gmsh.model.getPhysicalName(2, group) for group in gmsh.model.getPhysicalGroupsForEntity(2, face)]
    coarser = max(grade / 2, 1.0)
    report(
        f"{rounded(cells)} cells, {times:.0f} times as many as equal cells of mesh.size: rounded faces such as "
        f"{next(iter(names), f'face {face}')} (radius {readable(radii[face] * unit, 'm')}) have edges down to "
        f"{readable(size / grade * unit, 'm')}. Where they do not matter, take mesh.grade {coarser:.3g}: edges of "
        f"{readable(size / coarser * unit, 'm')} and more"
    )


def _radius(gmsh: Any, face: int) -> float:
    """Return the smallest radius of curvature in the middle of a face; infinite if it is plane."""
    if gmsh.model.getType(2, face) == "Plane":
        return math.inf
    low, high = (np.array(ends) for ends in gmsh.model.getParametrizationBounds(2, face))
    largest, smallest, _, _ = gmsh.model.getPrincipalCurvatures(face, list((low + high) / 2))
    curvature = max(abs(float(largest[0])), abs(float(smallest[0])))
    return 1 / curvature if curvature > 0 else math.inf
