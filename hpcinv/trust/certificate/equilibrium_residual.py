"""Equilibrium residual of a solution, relative to the load."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh.extent import extent
from hpcinv.results.displacement_scale import FLOOR, nominal_sizes
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.trust.certificate.certify import Check, CheckedRun
from hpcinv.trust.certificate.check import Line, Verdict, topic, upper_bound_line

EQUILIBRIUM = topic(
    "equilibrium residual, relative to the load",
    "Unbalanced forces in the loaded body, relative to the load.",
    "Remove slivers of the mesh, or lower solver.tolerance unless a law is near its limit.",
    computed="free nodal forces over loads or reactions",
    thresholds="above 1e-7; above 1e-3",
)
WARN = 1e-7
_GROWTH = 1e-6
"""Growth of displacements, whose forces are compared; lowered, these are rounding errors."""
_RIGID = 1e-10
"""Share of the tangent times the displacements below which forces are errors of a rigid motion; raised, they may be
loads of a thin body"""
_ROUNDED = 1e-11
"""Share of the same below which a residual may be rounding errors, which prove nothing; raised, fewer lines fail"""
_FAIL = 1e-3


class EquilibriumCheck(Check):
    """Check that the solution satisfies the discrete equations."""

    name, order = "equilibrium", 10

    def lines(self, run: CheckedRun) -> Iterator[Line]:
        return equilibrium_residual(run.equations, run.solution)


def equilibrium_residual(equations: Equations, solution: Solution) -> Iterator[Line]:
    """Compare ``‖R‖`` at the free displacements with the nodal loads and reactions; collective.

    The load is the difference that the load factor makes to ``R``, or the reactions of the supports where those are
    larger (prescribed motion is not a force). It has a floor relative to the forces that balance each other, and in a
    rigid motion of the body, or of each of its parts, it is the tangent times displacements of the same size. A failure
    that rounding errors may cause, as in a body that is hardly loaded, is not decided.
    """
    comm = equations.body.mesh.comm
    dofs = equations.unknowns.owned_displacement_dofs

    def norm(forces: np.ndarray) -> float:
        return float(np.sqrt(comm.allreduce(float(np.sum(forces[dofs] ** 2)), op=MPI.SUM)))

    equations.put(solution)
    equilibrium = equations.equilibrium(equations.weak_form(solution.direction))
    none, full = equilibrium.system.forces(0.0), equilibrium.system.forces(1.0)
    load = max(norm(full - none), norm(full))
    left, balanced, is_rounded = norm(full - equations.supports.held_part(full)), "", False
    if left > WARN * load:  # a rigid motion needs no forces
        equations.put(_strained(solution, comm))
        stiff = norm(equilibrium.system.forces(1.0) - full) / _GROWTH
        equations.put(solution)
        is_rounded = left < _ROUNDED * stiff
        if load < _RIGID * stiff:
            load, balanced = stiff, "all parts move rigidly: this is relative to forces of strains of this size"
    equations.release(equilibrium)
    if left > WARN * load:  # loads may balance each other at each point
        _, nominal = nominal_sizes(equations, solution)
        if FLOOR * nominal > load:
            load, text = FLOOR * nominal, "loads and inelastic strains balance at each point: this is relative to"
            balanced = f"{text} {FLOOR:g} of the sum of their forces, without regard to direction"
    if load == 0.0:
        yield Line(EQUILIBRIUM, 0.0, "", "", Verdict.PASS, "nothing loads the body")
        return
    line = upper_bound_line(EQUILIBRIUM, left / load, warn=WARN, fail=_FAIL, note=balanced)
    if line.verdict is Verdict.FAIL and is_rounded:
        note = "the load is so small for this stiffness that rounding errors of the forces may be as large"
        line = replace(line, verdict=Verdict.UNDECIDED, note=note)
    yield line


def _strained(solution: Solution, comm: MPI.Intracomm) -> Solution:
    """Return a state whose displacements grow along the body by up to three times `_GROWTH`.

    No rigid motion stays one.
    """
    u = solution.displacement.copy()
    points = u.function_space.tabulate_dof_coordinates()
    low, high = extent(comm, points)
    growth = _GROWTH * ((points - low) / (high - low).max()).sum(axis=1)
    u.x.array.reshape(-1, 3)[:] *= 1.0 + growth[:, None]
    return replace(solution, displacement=u)
