"""Checks of the computed body: cells and planes of symmetry."""

from __future__ import annotations

import math
from collections.abc import Iterator

from hpcinv.base.quantity.units import readable
from hpcinv.mesh.quality import CURVATURE, worst_cells
from hpcinv.mesh.symmetry import symmetry_planes
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.trust.certificate.certify import Check, CheckedRun
from hpcinv.trust.certificate.check import Line, lower_bound_line, topic, upper_bound_line

_STRAIGHT = "the straight cell between its corners is inside out, the curved one is not"
CURVED_CELLS = topic(
    f"worst cell, by its {CURVATURE}",
    "Least over largest Jacobian within a curved element; below zero it is folded.",
    "Refine the mesh at this place; corners of supports and loads are singular.",
    computed="spread of the Jacobian in curved cells",
    thresholds="below 0.1 of the given mesh's; ≤ 0",
)
CELLS = topic(
    "worst cell, by its …",
    "Quality of the worst element of the computed body; near zero it is flat or folded.",
    "Mesh this place again or finer; 'mesh: {geometry_degree: 2}' writes curved cells of solids.",
    computed="mean ratio or scaled Jacobian",
    thresholds="below 0.1 of the given mesh's; ≤ 0, unless curved cells are valid",
)
SYMMETRY = topic(
    "depth beyond the plane of symmetry '…', relative to the body",
    "How far the body reaches through a support that may be its plane of symmetry.",
    "If this is a plane of symmetry, check load and stiffness.",
    computed="how far facets are beyond the plane, over the size of the body",
    thresholds="above 1e-9; never",
)


class CellCheck(Check):
    """Check the cells of the computed body, and its planes of symmetry."""

    name, order = "cells", 80

    def lines(self, run: CheckedRun) -> Iterator[Line]:
        return cells(run.equations, run.solution)


def cells(equations: Equations, solution: Solution) -> Iterator[Line]:
    """Check the cells of the body that a solution found, and its planes of symmetry; collective."""
    body, mesh_nodes, other_nodes = equations.body, solution.mesh_nodes, solution.other_nodes
    given_name = "given mesh" if solution.is_on_given_mesh else "rest shape"
    measures = worst_cells(body, mesh_nodes, other_nodes, equations.quadrature_degree)
    for worst in measures:
        # The moved mesh need not be better than the given one.
        enough = 0.1 * min(max(worst.given_value, 0.0), 1.0)
        note = f"{worst.given_value:.3g} in the {given_name}; at ({point_text(worst.point)}) m of the computed body"
        decides = worst is measures[-1]  # curved cells can be valid where straight ones between their corners are not
        if worst.value <= 0 < measures[-1].value:
            note += f"; {_STRAIGHT}"
        fail = 0.0 if decides else -math.inf
        about = CURVED_CELLS if worst.measure == CURVATURE else CELLS.placed(worst.measure)
        yield lower_bound_line(about, worst.value, warn=enough, fail=fail, note=note)
    for plane in symmetry_planes(solution.job, body, mesh_nodes, other_nodes):
        note = (
            f"{readable(plane.crossed, 'm')} inside of its mirror image, unless this is a wall that the body may pass"
        )
        # A rest that is not larger than the region is held in the same way.
        depth = plane.crossed / body.length_scale
        about = SYMMETRY.placed(plane.region)
        yield upper_bound_line(about, depth, warn=1e-9, fail=math.inf, note=note if plane.crossed else "")


def point_text(point: tuple[float, float, float]) -> str:
    """Return a point for a note."""
    return ", ".join(f"{c:.4g}" for c in point)
