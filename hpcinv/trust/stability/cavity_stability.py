"""Stability of a body whose cavities are held by a given volume, a gas or a windkessel.

Where the pressure of a cavity is ``q(V)``, the second variation of the energy is the one at given pressures plus
``-dq/dV (dV)²``. With the tangent K at given pressures, the slopes B of n volumes and C = diag(-dV/dq),

    negative(K + B C⁻¹ Bᵀ) = negative(K) + positive(C + Bᵀ K⁻¹ B) - n,

by Sylvester's law for both eliminations of the bordered matrix. With a given volume C is 0, and only motions that keep
it count: a balloon beyond its largest pressure is stable. A large gas has a large C: it acts as a given pressure.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from petsc4py import PETSc

from hpcinv.base.parallel.petsc_vectors import dot, norm
from hpcinv.results.solution import Solution
from hpcinv.solver.constraints import solved_borders
from hpcinv.solver.constraints.cavity_pressures import CavityPressures
from hpcinv.solver.equations import Equations
from hpcinv.trust.stability.confirmation import assembled
from hpcinv.trust.stability.forward_factors import ForwardFactors
from hpcinv.trust.stability.inertia import SymmetricFactors, factorize_symmetric

_ZERO = 1e-10
"""Eigenvalue of the summed compliances, relative to the body's, that counts as 0; raised, fewer states are stable."""
_WHOLE = 0.01
"""Largest part of a cavity's wall, by the slope of its volume, without its pressure; raised, moving lids without it are
ignored."""


def unstable_with_cavities(
    equations: Equations, forward: ForwardFactors, factors: SymmetricFactors, *, confirms: bool
) -> tuple[int | None, int | None]:
    """Return how many directions are unstable with all cavities held, and how many of them are confirmed; collective.

    Each is ``None`` if it is not known.

    Args:
        factors: of the forward tangent at given pressures.
        confirms: whether to confirm them.
    """
    with _slopes(equations, forward) as slopes:
        if slopes is None:
            return None, None
        found = _unstable(equations, forward.solution, factors, slopes)
        return found, _confirmed(equations, forward.solution, slopes) if found and confirms else None


def _confirmed(equations: Equations, solution: Solution, slopes: Sequence[PETSc.Vec]) -> int | None:
    """Return the number of confirmed unstable directions (`hpcinv.trust.stability.confirmation`); collective."""
    with assembled(equations, solution) as matrix:
        factors = factorize_symmetric(matrix)
    if factors is None:
        return None
    found = _unstable(equations, solution, factors, slopes)
    factors.destroy()
    return found


def _unstable(
    equations: Equations, solution: Solution, factors: SymmetricFactors, slopes: Sequence[PETSc.Vec]
) -> int | None:
    """Return the number of unstable directions with all cavities held; ``None`` if a solve fails; collective."""
    body = np.zeros((len(slopes), len(slopes)))
    for i, slope in enumerate(slopes):
        b, x = slope.copy(), slope.duplicate()
        is_solved = factors.solve(b, x)
        body[:, i] = [dot(other, x) for other in slopes]
        b.destroy()
        x.destroy()
        if not is_solved or not np.isfinite(body[:, i]).all():
            return None
    unit = equations.scales.length**3 / equations.scales.stress
    held = np.diag([cavity.compliance / unit for cavity in solution.cavities])
    eigenvalues = np.linalg.eigvalsh(held + (body + body.T) / 2)
    positive = int(np.count_nonzero(eigenvalues > -_ZERO * np.abs(body).max()))
    inertia = factors.inertia
    return max(inertia.negative + inertia.zero - equations.unknowns.pressure_size + positive - len(slopes), 0)


@contextmanager
def _slopes(equations: Equations, forward: ForwardFactors) -> Iterator[Sequence[PETSc.Vec] | None]:
    """Context with the slopes of the volumes of all held cavities by the state, 0 at supports; collective.

    ``None`` where a pressure does not act on the whole wall of its cavity.
    """
    with forward.tangent() as equilibrium:
        system = equilibrium.system
        solution = forward.solution
        (pressures,) = solved_borders(solution.job, solution.constraints, equations, system)
        assert isinstance(pressures, CavityPressures)
        cavities = pressures.loads
        r, column, is_whole = system.position(), system.position(), True
        slopes = [system.position() for _ in cavities]
        system.residual(r)
        for slope, cavity in zip(slopes, cavities, strict=True):
            cavity.slope(slope)
            equations.supports.free(slope.array)
            border = CavityPressures(system, [cavity])
            border.set_columns([column], r, 1.0)
            border.destroy()
            column.axpy(1.0, slope)
            is_whole = is_whole and norm(column) <= _WHOLE * norm(slope)
    try:
        yield slopes if is_whole else None
    finally:
        pressures.destroy()
        for vector in (r, column, *slopes):
            vector.destroy()
