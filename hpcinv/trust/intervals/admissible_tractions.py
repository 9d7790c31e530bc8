"""Contact tractions that a given deformed shape admits, and the ends of linear quantities over them.

On a given shape the pressures ``p ≥ 0`` of an interface are not determined, nor are tangential tractions within the
friction cone ``|t| ≤ μ p``. They are admissible if the undeformed bodies do not overlap, and parts that contact alone
holds are in balance. With all these numbers ``z``, and their values ``z₀`` at a solution, gaps are
``g = g₀ + C (z - z₀) ≥ 0`` and forces that nothing balances ``e = e₀ + E (z - z₀) = 0``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.sparse import csr_array, vstack

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh.source import Floats
from hpcinv.trust.intervals.friction_cones import FrictionCones


class UnboundedEnd(Exception):
    """Raised for a quantity that admissible tractions make as large as one likes."""


class NoPressure(Exception):
    """Raised if no tractions are admissible.

    Attributes:
        gap: largest value, below 0, that the smallest gap can have; 0 if only the given bounds exclude all tractions.
        friction: least factor of the friction coefficients that balances all parts; ``None`` if the given ones do.
        excess: least value by which bodies that do not overlap miss a known rest surface; 0 if that is not the reason.
    """

    def __init__(self, gap: float, friction: float | None = None, excess: float = 0.0) -> None:
        super().__init__(gap, friction, excess)
        self.gap, self.friction, self.excess = gap, friction, excess


@dataclass(frozen=True)
class AdmissibleTractions:
    """Numbers of interfaces: pressures, tangential tractions and places of free parts, n in all, in scaled units.

    Attributes:
        values: at a solution, (n,).
        gaps: at that solution, (m,).
        compliance: derivatives of the gaps by the numbers, (m, n).
        greatest: upper bounds of the numbers, (n,); ``inf`` for none.
        widest: bounds of the gaps, (m,); ``inf`` for none.
        forces: areas (n,), whose products with the numbers add up to a force, with the bounds of this force.
        lowest: lower bounds, (n,); by default 0, as of pressures.
        cones: of tangential tractions.
        unbalanced: forces (b,) that nothing balances at the solution, and their derivatives (b, n) by the numbers.
        bands: distances (k,) from a known rest surface, their derivatives (k, n), and the largest admissible distance.
    """

    values: Floats
    gaps: Floats
    compliance: Floats
    greatest: Floats
    widest: Floats
    forces: Sequence[tuple[Floats, float, float]] = ()
    lowest: Floats | None = None
    cones: Sequence[FrictionCones] = ()
    unbalanced: tuple[Floats, Floats] | None = None
    bands: Sequence[tuple[Floats, Floats, float]] = ()

    def end(
        self, slopes: Floats, sign: float, reach: float = np.inf, directions: Sequence[Sequence[Floats]] = ()
    ) -> Floats:
        """Return the admissible numbers (n,) that make ``sign · slopes · z`` largest.

        Args:
            reach: largest change of a number; it is widened where nothing within it is admissible.
            directions: of more planes of each of the cones.

        Raises:
            UnboundedEnd: there is no largest value.
            NoPressure: no tractions are admissible.
        """
        rows, limits = self._rows(directions)
        for near in (reach, 4 * reach, 16 * reach, np.inf) if np.isfinite(reach) else (np.inf,):
            bounds = [(max(low, z - near), min(high, z + near)) for (low, high), z in self._bounds_and_values]
            found = self._program(-sign * slopes, rows, limits, bounds)
            if found.status == 0:
                values: Floats = found.x
                return values
        if (fault := self._fault()) is not None:
            raise fault
        raise UnboundedEnd

    def common_end(
        self,
        comm: MPI.Intracomm,
        slopes: Floats,
        sign: float,
        reach: float = np.inf,
        directions: Sequence[Sequence[Floats]] = (),
    ) -> Floats:
        """Return `end` as rank 0 finds it: others might choose other numbers for the same end; collective."""
        found: Floats | Exception | None = None
        if comm.rank == 0:
            try:
                found = self.end(slopes, sign, reach, directions)
            except Exception as reason:  # raised on all ranks
                found = reason
        found = comm.bcast(found)
        if isinstance(found, Exception):
            raise found
        values: Floats = found
        return values

    @property
    def depth(self) -> float:
        """Largest overlap of the undeformed bodies at the solution, distance beyond a known one, or unbalanced force.

        It is at least 0.
        """
        left = 0.0 if self.unbalanced is None else float(np.abs(self.unbalanced[0]).max(initial=0.0))
        beyond = [float(np.abs(distances).max(initial=0.0)) - within for distances, _, within in self.bands]
        return max([0.0, -float(self.gaps.min(initial=0.0)), left, *beyond])

    def bounding(self, slopes: Floats, sign: float, areas: Sequence[Floats]) -> frozenset[str]:
        """Return which keys of 'known' would bound ``sign · slopes · z``.

        Args:
            areas: whose products with the numbers add up to forces, of each interface.
        """
        is_pressure = (self._lowest == 0) & np.isinf(self.greatest)
        largest = [(a / np.abs(a).max(initial=1e-300), -np.inf, _LARGE) for a in areas]
        tried = {
            "greatest_pressure": replace(self, greatest=np.where(is_pressure, _LARGE, self.greatest)),
            "force": replace(self, forces=[*self.forces, *largest]),
            "greatest_rest_gap": replace(self, widest=np.minimum(self.widest, _LARGE)),
        }
        found = set[str]()
        for key, bounded in tried.items():
            try:
                bounded.end(slopes, sign)
            except (UnboundedEnd, NoPressure):
                continue
            found.add(key)
        return frozenset(found)

    def rows(self, origin: Floats) -> tuple[Floats, Floats]:
        """Return matrix A and bounds b of all inequalities ``A dz ≤ b`` of changes dz from numbers (n,)."""
        rows, limits = self._rows([[cone.directions(self.values)] for cone in self.cones])
        low, high = self._lowest, self.greatest
        unit = np.eye(len(origin))
        is_low, is_high = np.isfinite(low), np.isfinite(high)
        A = np.concatenate([rows.toarray(), -unit[is_low], unit[is_high]])
        b = np.concatenate([limits, -low[is_low], high[is_high]])
        kept = np.isfinite(b)
        return A[kept], (b - A @ origin)[kept]

    @property
    def balance(self) -> tuple[Floats, Floats]:
        """Matrix E and right side e of ``E dz = e``: changes after which all parts are in balance."""
        if self.unbalanced is None:
            return np.zeros((0, len(self.values))), np.zeros(0)
        return self.unbalanced[1], -self.unbalanced[0]

    @property
    def is_locked(self) -> bool:
        """Whether tractions can grow without bound, but pressures without friction cannot."""
        return self._grows(1.0) and not self._grows(0.0)

    def _grows(self, share: float) -> bool:
        """Return whether pressures can grow without bound, for a share of the friction coefficients."""
        bounded = np.isfinite(self.widest)
        parts = [csr_array(-self.compliance), csr_array(self.compliance[bounded])]
        parts += [csr_array(areas[None, :]) for areas, _, _ in self.forces]
        parts += [csr_array(sign * rates) for _, rates, _ in self.bands for sign in (1.0, -1.0)]
        parts += [cone.rows(len(self.values), (), share) for cone in self.cones]
        rows = vstack([part for part in parts if part.shape[0]], format="csr")
        bounds = [
            (0.0 if low == 0 else -1.0, 1.0 if high == np.inf else 0.0)
            for low, high in zip(self._lowest, self.greatest, strict=True)
        ]
        kept = self.unbalanced and (np.zeros_like(self.unbalanced[0]), self.unbalanced[1])
        growing = replace(self, values=np.zeros_like(self.values), unbalanced=kept)
        cost = -(self._lowest == 0).astype(np.float64)
        found = growing._program(cost, rows, np.zeros(rows.shape[0]), bounds)
        return bool(found.status == 0 and -found.fun > _GROWS)

    @property
    def _lowest(self) -> Floats:
        return np.zeros(len(self.values)) if self.lowest is None else self.lowest

    @property
    def _bounds(self) -> list[tuple[float, float]]:
        return list(zip(self._lowest.tolist(), self.greatest.tolist(), strict=True))

    @property
    def _bounds_and_values(self) -> list[tuple[tuple[float, float], float]]:
        return list(zip(self._bounds, self.values.tolist(), strict=True))

    def _program(self, cost: Floats, rows: Any, limits: Floats, bounds: Sequence[tuple[float | None, float]]) -> Any:
        from scipy.optimize import linprog  # slow to import, and rarely needed

        equations: dict[str, Any] = {}
        if self.unbalanced is not None:
            left, rates = self.unbalanced
            sizes = np.abs(rates).max(axis=1, initial=0.0)
            sizes = np.where(sizes > 0, sizes, 1.0)
            more = np.zeros((len(left), len(cost) - len(self.values)))
            equations["A_eq"] = np.hstack([rates / sizes[:, None], more])
            equations["b_eq"] = (rates @ self.values - left) / sizes
        return linprog(cost, A_ub=rows, b_ub=limits, bounds=bounds, method="highs", **equations)

    def _rows(
        self, directions: Sequence[Sequence[Floats]] = (), share: float = 1.0, *, gaps_alone: bool = False
    ) -> tuple[csr_array, Floats]:
        """Return matrix A and bounds b of ``A z ≤ b``; rows of gaps that are not negative are the first."""
        offset = self.gaps - self.compliance @ self.values
        parts: list[tuple[Any, Floats]] = [(-self.compliance, offset)]
        if not gaps_alone:
            bounded = np.isfinite(self.widest)
            parts.append((self.compliance[bounded], (self.widest - offset)[bounded]))
            for areas, least, greatest in self.forces:
                parts += [(-areas[None, :], np.array([-least]))] if np.isfinite(least) else []
                parts.append((areas[None, :], np.array([greatest])))
            for distances, rates, within in self.bands:
                start = distances - rates @ self.values
                parts += [(rates, within - start), (-rates, within + start)]
        for number, cone in enumerate(self.cones):
            rows = cone.rows(len(self.values), directions[number] if directions else (), share)
            parts.append((rows, np.zeros(rows.shape[0])))
        return vstack([csr_array(rows) for rows, _ in parts], format="csr"), np.concatenate([b for _, b in parts])

    def _fault(self) -> NoPressure | None:
        """Return why no tractions are admissible, ``None`` if some are."""
        slack = self._least_slack()
        if slack is None:
            return NoPressure(0.0, self._least_friction())
        if slack == 0:
            return None
        gap = min(0.0, self._least_slack(gaps_alone=True) or 0.0)
        missed = self._least_slack(bands_alone=True) if self.bands and gap == 0 else None
        return NoPressure(gap, excess=-missed if missed is not None else 0.0)

    def _least_slack(self, share: float = 1.0, *, gaps_alone: bool = False, bands_alone: bool = False) -> float | None:
        """Return the largest value, at most 0, that the least slack of ``A z ≤ b`` can have, ``None`` without balance.

        Cones have no slack.

        Args:
            gaps_alone: whether rows of gaps alone are taken.
            bands_alone: whether rows of known rest surfaces alone have slack; ``None`` if others exclude all.
        """
        rows, limits = self._rows(share=share, gaps_alone=gaps_alone)
        coned = sum(cone.rows(len(self.values), ()).shape[0] for cone in self.cones)
        end = rows.shape[0] - coned
        first = end - 2 * sum(len(distances) for distances, _, _ in self.bands) if bands_alone else 0
        numbers = np.arange(rows.shape[0])
        slack = np.where((numbers >= first) & (numbers < end), -1.0, 0.0)
        free = csr_array(vstack([rows.T, csr_array(slack[None, :])]).T)
        cost = np.append(np.zeros(len(self.values)), 1.0)
        found = self._program(cost, free, limits, [*self._bounds, (0, np.inf)])
        return -float(found.fun) if found.status == 0 else None

    def _least_friction(self) -> float:
        """Return the least factor of the friction coefficients that balances all parts; ``inf`` if none does."""
        low, high = 1.0, _MOST_FRICTION
        if self._least_slack(high) is None:
            return np.inf
        while high - low > _FRICTION_STEP * low:
            middle = (low + high) / 2
            low, high = (low, middle) if self._least_slack(middle) is not None else (middle, high)
        return high


def settled_end(
    solve: Callable[[Floats], tuple[float, AdmissibleTractions, Floats]],
    choose: Callable[[AdmissibleTractions, Floats, float], Floats],
    start: Floats,
    tolerance: float,
    depth: float,
) -> tuple[float, Floats, bool]:
    """Return the end of a quantity that is not linear: value, numbers, and whether it has settled.

    It has settled where one more program would gain little, and the bodies do not overlap. Where a solve gives much
    less than its program promised, the next one may change numbers by half the last change only.

    Args:
        solve: returns for numbers the quantity, what is admissible near them, and the slopes of the quantity.
        choose: returns the numbers at the end of what is admissible, for some slopes and a largest change.
        tolerance: change of the quantity that one more program may promise.
        depth: overlap that is tolerated.
    """
    value, near, slopes = solve(start)
    values, reach = start, np.inf
    for count in range(_MOST + 1):
        following = choose(near, slopes, reach)
        step = following - values
        promised, before = float(slopes @ step), value
        if abs(promised) <= tolerance and near.depth <= depth:
            return value, values, True
        if count == _MOST:
            break
        values = following
        value, near, slopes = solve(values)
        kept = (value - before) / promised if promised else 1.0
        if kept < _POOR:
            reach = min(reach, float(np.abs(step).max(initial=0.0))) / 2
        elif kept > _GOOD:
            reach *= 2
    return value, values, False


_MOST = 30
"""Programs in turn for one end; raised, ends that do not settle take longer."""
_POOR, _GOOD = 0.5, 0.9
"""Shares of a promised change below which the next changes are halved, and above which they may double. Raised, ends
take more solves; lowered, programs jump to and fro across an end between corners."""
_LARGE = 1e3
"""Pressure, force and gap (scaled) that are taken as known to find out which of them bound a quantity. Raised, programs
are worse conditioned."""
_GROWS = 1e-6
"""Sum of pressures of at most 1 above which they grow without bound. Raised, weakly locked bodies are not found."""
_MOST_FRICTION, _FRICTION_STEP = 64.0, 1e-3
"""Largest factor of friction coefficients that is tried, and relative error of the least one."""
