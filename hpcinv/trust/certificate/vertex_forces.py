"""Forces of supports on single vertices, which should only keep a body in place whose loads balance.

In a solid, the displacement under a force at a point grows without limit as cells become smaller.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.trust.certificate.certify import Check, CheckedRun
from hpcinv.trust.certificate.check import Line, topic, upper_bound_line

VERTEX_FORCES = topic(
    "force on supports at vertices, relative to the load",
    "A solid has no finite displacement under a force at a point.",
    "Let the loads balance, or hold a spot of facets (how-to/supports.md).",
    computed="reactions at [vertices](../how-to/supports.md#points-and-lines) over loads or reactions",
    thresholds="above 1e-3; never",
)
_WARN = 1e-3  # of the load: its error of the displacement is far below what the discretisation error may be


class VertexForceCheck(Check):
    """Compare the sizes of reactions at vertices with the nodal loads and reactions, each summed."""

    name, order = "forces at vertices", 20

    def lines(self, run: CheckedRun) -> Iterator[Line]:
        equations, solution = run.equations, run.solution
        held = {name for name, region in equations.body.regions.items() if region.vertices is not None}
        held &= {support.region for support in solution.job.supports}
        if not held:
            return
        comm, dofs = equations.body.mesh.comm, equations.unknowns.owned_displacement_dofs

        def total(forces: np.ndarray) -> float:
            sizes = np.linalg.norm(forces[dofs].reshape(-1, 3), axis=1)
            return float(comm.allreduce(float(sizes.sum()), op=MPI.SUM))

        equations.put(solution)
        equilibrium = equations.equilibrium(equations.weak_form(solution.direction))
        none, full = equilibrium.system.forces(0.0), equilibrium.system.forces(1.0)
        load = max(total(full - none), total(full))
        facets = {support.region for support in solution.job.supports} - held
        elsewhere = equations.supports.held_part(full, facets)  # a vertex may also be on a facet that is held
        share = total(equations.supports.held_part(full - elsewhere, held)) / load if load else 0.0
        equations.release(equilibrium)
        yield upper_bound_line(VERTEX_FORCES, share, _WARN, math.inf, note=f"on {', '.join(sorted(held))}")
