"""Round trip: the solve back from the body that was found."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from hpcinv.certificate.check import Line, Verdict, at_most, skipped
from hpcinv.parallel.runtime import MPI
from hpcinv.solver.load_stepping import follow
from hpcinv.solver.observer import SILENT, Observer

if TYPE_CHECKING:
    from hpcinv.effects import Direction
    from hpcinv.results.solution import Solution
    from hpcinv.solver.problem import Model

ROUND_TRIP = "round trip, relative to the displacement"
STRAIGHT = (
    "the cells' geometry is of lower degree than the displacement, so that only their nodes can move: with"
    " 'mesh: {geometry_degree: 2}' the round trip of quadratic ones closes (for a .msh file, 'gmsh -order 2' also puts"
    " their nodes on the curved surface)"
)


def round_trip(model: Model, solution: Solution, observer: Observer = SILENT) -> Iterator[Line]:
    """Solve back from the body that a solution found, and compare the displacements; collective.

    If the cells' geometry has the degree of the displacement, the two directions are exact discrete inverses.
    """
    back: Direction = "forward" if solution.direction == "inverse" else "inverse"
    start = model.job.certificate.round_trip
    if start == "off":
        yield skipped(ROUND_TRIP, "switched off: certificate.round_trip")
        return
    with model.at(solution.other_nodes, *solution.fields):
        equilibrium = model.equilibrium(model.scene(back), observer)
        tolerance = model.job.solver.tolerance
        solves = [equilibrium.solve(1.0, tolerance)] if start == "near" else []
        if not solves or not solves[-1].outcome.accepted:
            model.unknowns.state.x.array[:] = 0.0
            solves = list(follow(equilibrium, model.steps, tolerance))
        u = model.unknowns.at_nodes(model.solution()[0])
        model.release(equilibrium)
    last = solves[-1]
    if not (last.outcome.accepted and last.load == 1.0):
        note = f"no way back: stopped at load factor {last.load:.4g}: {last.outcome.text}"
        yield Line(ROUND_TRIP, None, "", "the solve back must converge", Verdict.FAIL, note)
        return
    yield closure_error(model, solution, u)


def closure_error(model: Model, solution: Solution, back: np.ndarray) -> Line:
    """Compare a solution's displacements with those (m) of the solve back at the same nodes; collective."""
    largest = float(np.linalg.norm(back - solution.u, axis=1).max(initial=0.0))
    difference, size = model.body.mesh.comm.allreduce(largest, op=MPI.MAX), solution.largest_displacement
    curved = model.body.source.degree >= model.job.discretisation.displacement
    note = f"{difference:.3g} m" if curved else f"{difference:.3g} m; {STRAIGHT}"
    return at_most(ROUND_TRIP, difference / size if size else difference, warn=1e-3, fail=0.1, note=note)
