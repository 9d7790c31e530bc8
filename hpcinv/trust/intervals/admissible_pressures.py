"""Contact pressures that a given deformed shape admits, and the ends of linear quantities over them.

On a given shape the pressures ``p ≥ 0`` of an interface are not determined. They are admissible if the undeformed
bodies do not overlap: their gaps ``g = g₀ + C (p - p₀)`` are not negative. ``C`` is the compliance at a solution with
the pressures ``p₀``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from hpcinv.mesh.source import Floats


class UnboundedEnd(Exception):
    """Raised for a quantity that admissible pressures make as large as one likes."""


class NoPressure(Exception):
    """Raised if no pressure is admissible.

    Attributes:
        gap: largest value, below 0, that the smallest gap can have; 0 if only the given bounds exclude all pressures.
    """

    def __init__(self, gap: float) -> None:
        super().__init__(gap)
        self.gap = gap


@dataclass(frozen=True)
class AdmissiblePressures:
    """Pressures of the n functions of interfaces, in scaled units.

    Attributes:
        pressures: at a solution, (n,).
        gaps: at that solution, (m,).
        compliance: derivatives of the gaps by the pressures, (m, n).
        greatest: bounds of the pressures, (n,); ``inf`` for none.
        widest: bounds of the gaps, (m,); ``inf`` for none.
        forces: areas (n,), whose products with the pressures add up to a force, with the bounds of this force.
    """

    pressures: Floats
    gaps: Floats
    compliance: Floats
    greatest: Floats
    widest: Floats
    forces: Sequence[tuple[Floats, float, float]] = ()

    def end(self, slopes: Floats, sign: float, reach: float = np.inf) -> Floats:
        """Return the admissible pressures (n,) that make ``sign · slopes · p`` largest.

        Args:
            reach: largest change of a pressure; it is widened where no pressures within it are admissible.

        Raises:
            UnboundedEnd: there is no largest value.
            NoPressure: no pressures are admissible.
        """
        from scipy.optimize import linprog  # slow to import, and rarely needed

        rows, limits = self._rows()
        for near in (reach, 4 * reach, 16 * reach, np.inf) if np.isfinite(reach) else (np.inf,):
            bounds = [(max(low, p - near), min(high, p + near)) for (low, high), p in self._bounds_and_pressures]
            found = linprog(-sign * slopes, A_ub=rows, b_ub=limits, bounds=bounds, method="highs")
            if found.status == 0:
                pressures: Floats = found.x
                return pressures
        if self._least_slack(rows, limits) < 0:
            count = len(self.gaps)  # rows of gaps that are not negative come first
            raise NoPressure(self._least_slack(rows[:count], limits[:count]))
        raise UnboundedEnd

    @property
    def depth(self) -> float:
        """Largest overlap of the undeformed bodies at the solution, at least 0."""
        return max(0.0, -float(self.gaps.min(initial=0.0)))

    @property
    def _bounds(self) -> list[tuple[float, float]]:
        return [(0.0, greatest) for greatest in self.greatest]

    @property
    def _bounds_and_pressures(self) -> list[tuple[tuple[float, float], float]]:
        return list(zip(self._bounds, self.pressures.tolist(), strict=True))

    def _rows(self) -> tuple[Floats, Floats]:
        """Return matrix A and bounds b of ``A p ≤ b``."""
        offset = self.gaps - self.compliance @ self.pressures
        bounded = np.isfinite(self.widest)
        parts = [(-self.compliance, offset), (self.compliance[bounded], (self.widest - offset)[bounded])]
        for areas, least, greatest in self.forces:
            parts += [(-areas[None, :], np.array([-least])), (areas[None, :], np.array([greatest]))]
        rows, limits = (np.concatenate(part) for part in zip(*parts, strict=True))
        return rows, limits

    def _least_slack(self, rows: Floats, limits: Floats) -> float:
        """Return the largest value, at most 0, that the least slack of ``A p ≤ b`` can have for some pressures."""
        from scipy.optimize import linprog

        free = np.hstack([rows, np.full((len(rows), 1), -1.0)])
        cost = np.append(np.zeros(len(self.pressures)), 1.0)
        found = linprog(cost, A_ub=free, b_ub=limits, bounds=[*self._bounds, (0, None)], method="highs")
        return -float(found.fun) if found.status == 0 else 0.0


def settled_end(
    solve: Callable[[Floats], tuple[float, AdmissiblePressures, Floats]],
    choose: Callable[[AdmissiblePressures, Floats, float], Floats],
    start: Floats,
    tolerance: float,
    depth: float,
) -> tuple[float, Floats, bool]:
    """Return the end of a quantity that is not linear: value, pressures, and whether it has settled.

    It has settled where one more program would gain little, and the bodies do not overlap. Where a solve gives much
    less than its program promised, the next one may change pressures by half the last change only.

    Args:
        solve: returns for pressures the quantity, what is admissible near them, and the slopes of the quantity.
        choose: returns the pressures at the end of what is admissible, for some slopes and a largest change.
        tolerance: change of the quantity that one more program may promise.
        depth: overlap that is tolerated.
    """
    value, near, slopes = solve(start)
    pressures, reach = start, np.inf
    for count in range(_MOST + 1):
        following = choose(near, slopes, reach)
        step = following - pressures
        promised, before = float(slopes @ step), value
        if abs(promised) <= tolerance and near.depth <= depth:
            return value, pressures, True
        if count == _MOST:
            break
        pressures = following
        value, near, slopes = solve(pressures)
        kept = (value - before) / promised if promised else 1.0
        if kept < _POOR:
            reach = min(reach, float(np.abs(step).max(initial=0.0))) / 2
        elif kept > _GOOD:
            reach *= 2
    return value, pressures, False


_MOST = 30
"""Programs in turn for one end; raised, ends that do not settle take longer."""
_POOR, _GOOD = 0.5, 0.9
"""Shares of a promised change below which the next changes are halved, and above which they may double. Raised, ends
take more solves; lowered, programs jump to and fro across an end between corners."""
