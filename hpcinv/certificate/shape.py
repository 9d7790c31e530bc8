"""Checks of the computed body: cells, planes of symmetry, self-overlap."""

from __future__ import annotations

import math
from collections.abc import Iterator

from hpcinv.certificate.check import Line, Verdict, lower_bound_line, skipped, upper_bound_line
from hpcinv.certificate.overlap import MOST_FACETS, overlap
from hpcinv.certificate.quality import worst_cells
from hpcinv.certificate.symmetry import symmetry_planes
from hpcinv.mesh.regions import BOUNDARY
from hpcinv.quantity.units import readable
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations

_STRAIGHT = "the straight cell between its corners is inside out, the curved one is not"
OVERLAP = "boundary facets that cross each other"


def cells(equations: Equations, solution: Solution) -> Iterator[Line]:
    """Check the cells of the body that a solution found, and its planes of symmetry; collective."""
    body, mesh_nodes, other_nodes = equations.body, solution.mesh_nodes, solution.other_nodes
    given_name = "given mesh" if solution.is_on_given_mesh else "rest shape"
    measures = worst_cells(body, mesh_nodes, other_nodes, equations.quadrature_degree)
    for worst in measures:
        # The moved mesh need not be better than the given one.
        enough = 0.1 * min(max(worst.given_value, 0.0), 1.0)
        note = f"{worst.given_value:.3g} in the {given_name}; at ({_point(worst.point)}) m of the computed body"
        decides = worst is measures[-1]  # curved cells can be valid where straight ones between their corners are not
        if worst.value <= 0 < measures[-1].value:
            note += f"; {_STRAIGHT}"
        fail = 0.0 if decides else -math.inf
        yield lower_bound_line(f"worst cell, by its {worst.measure}", worst.value, warn=enough, fail=fail, note=note)
    for plane in symmetry_planes(solution.job, body, mesh_nodes, other_nodes):
        name = f"depth beyond the plane of symmetry '{plane.region}', relative to the body"
        note = (
            f"{readable(plane.crossed, 'm')} inside of its mirror image, unless this is a wall that the body may pass"
        )
        # A rest that is not larger than the region is held in the same way.
        depth = plane.crossed / body.length_scale
        yield upper_bound_line(name, depth, warn=1e-9, fail=math.inf, note=note if plane.crossed else "")


def self_overlap(equations: Equations, solution: Solution) -> Iterator[Line]:
    """Check that the body that a solution found does not pass through itself; collective."""
    body = equations.body
    if not solution.job.certificate.overlap:
        yield skipped(OVERLAP, "switched off: certificate.overlap")
        return
    if (facets := body.regions[BOUNDARY].facet_count) > MOST_FACETS:
        yield skipped(OVERLAP, f"there are {facets} of them, and one rank searches no more than {MOST_FACETS}")
        return
    crossings = overlap(body, solution.other_nodes)
    rule = "number of pairs; fail above 0"
    if crossings.point is None:
        yield Line(OVERLAP, 0.0, "", rule, Verdict.PASS, "the body does not pass through itself")
    else:
        note = f"the body passes through itself, such as at ({_point(crossings.point)}) m"
        yield Line(OVERLAP, float(crossings.pairs), "", rule, Verdict.FAIL, note)


def _point(point: tuple[float, float, float]) -> str:
    return ", ".join(f"{c:.4g}" for c in point)
