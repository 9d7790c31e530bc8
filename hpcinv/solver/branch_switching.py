"""Start of the other path at a simple bifurcation, which the end of a power series locates.

The coefficients end in a geometric progression along the direction ``φ`` of the other path (`power_series`). Without
this progression, their sum is the state ``x_c`` at the bifurcation. Newton's method with the load as an unknown finds
the equilibrium in the plane through ``x_c + η φ`` that is normal to ``φ`` (`bordering`); the first path passes
that plane at ``x_c`` only.

Source: Cochelin & Médale, J. Comput. Phys. 236, 594–607, 2013, doi:10.1016/j.jcp.2012.11.016.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc

from hpcinv.base.parallel.petsc_vectors import norm
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.arrays import Floats, LocalIndices
from hpcinv.solver.bordering import Bordering, Corrected
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.solver.power_series import PowerSeries

_STEP = 0.1
"""Largest rotation (rad) or strain of the first step along the other path. A smaller one begins where the tangent is
nearly singular; after a larger one Newton's method may find another equilibrium."""


@dataclass(frozen=True)
class Bifurcation:
    """A bifurcation of the path of a series.

    Attributes:
        load: load factor.
        parameter: parameter of the series.
        mode: direction of the other path, in the owned unknowns.
        displacement: unit vector of its largest displacement, whose largest component is positive.
    """

    load: float
    parameter: float
    mode: Floats
    displacement: tuple[float, ...]


def bifurcation_of(
    series: PowerSeries, owned_displacement_dofs: LocalIndices, comm: MPI.Intracomm
) -> Bifurcation | None:
    """Return the bifurcation that the end of a series shows, ``None`` without one; collective."""
    found = series.bifurcation()
    if found is None:
        return None
    mode = series.states[-1]
    nodes = mode[owned_displacement_dofs].reshape(-1, 3)
    largest = nodes[np.linalg.norm(nodes, axis=1).argmax()] if len(nodes) else np.zeros(3)
    vector = np.array(max(comm.allgather(tuple(largest.tolist())), key=lambda v: float(np.linalg.norm(v))))
    sign = np.sign(vector[np.abs(vector).argmax()]) or 1.0
    vector *= sign / (np.linalg.norm(vector) or 1.0)
    return Bifurcation(found[1], found[0], sign * mode, tuple(vector.tolist()))


def switched(
    equilibrium: Equilibrium,
    series: PowerSeries,
    origin: PETSc.Vec,
    bifurcation: Bifurcation,
    side: int,
    *,
    tolerance: float,
    cases: int,
) -> Corrected | None:
    """Return the first equilibrium on the other path, which is the present state then; ``None`` without one.

    Loads that fall along the other path count as none, since it does not lead to the full load.

    Args:
        origin: state at which the series begins.
        side: 1 to go along the mode, -1 to go the other way.
        cases: number of load cases.
    """
    system, a, count = equilibrium.system, bifurcation.parameter, len(series.loads)
    weights = series.weights(a, pade=False)
    weights[-1] -= count * a**count  # the sum of the progression
    x, mode = origin.copy(), origin.duplicate()
    x.array[:] += weights @ series.states
    mode.array[:] = bifurcation.mode
    system.set_state(x)
    increment = equilibrium.predictor.increments(mode)
    x.axpy(side * _STEP / max(increment.rotation, increment.strain), mode)
    mode.scale(1 / norm(mode))
    bordering = Bordering(equilibrium, cases)
    corrected = bordering.correct(x, bifurcation.load, mode, tolerance, direction=1, scale=bifurcation.load)
    bordering.destroy()
    is_found = corrected.solve.outcome.accepted and corrected.solve.load > bifurcation.load
    system.set_state(corrected.x if is_found else origin)
    system.set_load(corrected.solve.load)
    return corrected if is_found else None
