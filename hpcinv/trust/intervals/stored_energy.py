"""Elastic energy of the given shape by contact tractions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hpcinv.mesh.source import Floats
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.trust.sensitivity.slopes import STEP, Change, change_limit, shifted


@dataclass(frozen=True)
class StoredEnergy:
    """Energy that the bodies store, in scaled units.

    Attributes:
        value: stress × length³.
        slopes: derivatives (n,) by the tractions.
        curvature: second derivatives (n, n), of linear elasticity.
    """

    value: float
    slopes: Floats
    curvature: Floats


def stored_energy(
    equations: Equations, solution: Solution, changes: Sequence[Change], stiffness: Floats
) -> StoredEnergy:
    """Return the energy of a solution, with its slopes by central differences; collective.

    Args:
        changes: by each traction, one in scaled units.
        stiffness: ``Fᵀ K⁻¹ F`` of the forces of the tractions: of a linear body the second derivative of its energy.
    """
    evaluate = equations.weak_form(solution.direction).means
    equations.put(solution)
    value, slopes = evaluate().strain_energy, list[float]()
    for change in changes:
        step = STEP * change_limit(equations, solution, change.displacement)
        ends = list[float]()
        for way in (-step, step):
            fields = (
                shifted(solution.displacement, change.displacement, way),
                shifted(solution.pressure, change.pressure, way),
            )
            equations.put_fields(fields, locates=False)
            ends.append(evaluate().strain_energy)
        slopes.append((ends[1] - ends[0]) / (2 * step))
    return StoredEnergy(value, np.array(slopes), (stiffness + stiffness.T) / 2)
