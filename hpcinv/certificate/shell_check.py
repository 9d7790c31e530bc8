"""A line on the volume ratio at the faces of a shell, beyond the quadrature points of its layer."""

from collections.abc import Iterator

import numpy as np

from hpcinv.certificate.check import Line, lower_bound_line
from hpcinv.mesh.cells import scalar_element
from hpcinv.model.quadrature_values import PointValues
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations

NAME = "smallest volume ratio J at the faces of the shell"


def faces(equations: Equations, solution: Solution) -> Iterator[Line]:
    """Yield the line; collective."""
    equations.put(solution)
    weak_form = equations.weak_form(solution.direction)
    plane = scalar_element("quadrilateral", 2).points
    points = np.concatenate([np.column_stack([plane, np.full(len(plane), side)]) for side in (0.0, 1.0)])
    smallest, _ = PointValues(weak_form.J, weak_form.unknowns.mesh, points).range()
    note = "at the corners, edges and middles of the cells on both faces"
    yield lower_bound_line(NAME, smallest, warn=0.1, fail=0.0, note=note)
