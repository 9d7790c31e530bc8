"""Loads on parts of the boundary that supports hold completely, where they have no effect."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from dolfinx import fem

from hpcinv.base.parallel.runtime import MPI
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.trust.certificate.certify import Check, CheckedRun
from hpcinv.trust.certificate.check import Line, Verdict, topic

INEFFECTIVE = topic(
    "loads on parts that are held altogether",
    "Loads without effect, since supports hold all of their region.",
    "Remove the load or the support.",
    computed="their number",
    thresholds="any; never",
)


class IneffectiveLoadCheck(Check):
    """Look for loads that cannot change the shape."""

    name, order = "ineffective loads", 150

    def lines(self, run: CheckedRun) -> Iterator[Line]:
        return ineffective_loads(run.equations, run.solution)


def ineffective_loads(equations: Equations, solution: Solution) -> Iterator[Line]:
    """Yield a warning if some load acts only where supports prescribe every displacement; collective."""
    loads = [
        f"{where} {getattr(effect, 'effect', '')} on '{region}'"
        for where, effect in solution.job.named_effects
        if not effect.holds
        for region in effect.surfaces
        if _is_held(equations, region)
    ]
    if loads:
        rule = "number; warning above 0"
        note = f"{', '.join(loads)}: the shape does not depend on it"
        yield Line(INEFFECTIVE, float(len(loads)), "", rule, Verdict.WARN, note)


def _is_held(equations: Equations, region: str) -> bool:
    """Return whether every displacement on a region of the boundary is prescribed."""
    facets = equations.body.boundary_facets(region)
    held = np.concatenate([np.zeros(0, dtype=np.int32), *(support.dofs for support in equations.supports.prescribed)])
    free = 0
    for axis in range(3):
        component = equations.unknowns.displacement_component(axis)
        free += len(np.setdiff1d(fem.locate_dofs_topological(component, 2, facets), held))
    return bool(equations.body.mesh.comm.allreduce(free, op=MPI.SUM) == 0)
