"""What the next discretisation will reach and what it will cost, learnt from those that have been solved.

The error falls as ``h^k``. A factorization of ``N`` unknowns takes ``N^q`` and the assembly before it a time for each
cell that grows with the cube of its nodes. The exponents are fitted to the run's own steps as soon as two of them can
be compared; until then ``k`` is one more than the degree.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

AIM = 0.7  # share of what is allowed that a step aims at, so that it need not be repeated for a small miss
GAIN, POOR_GAIN = 0.2, 0.5  # what a degree more leaves of the error, where the solution is smooth, and where it is not
CAREFUL, BOLD = 2.0, 4.0  # by which cells are made smaller at once, at most: before and after the order was seen
WORTHWHILE = 0.8  # of the error that must be left at most, for a step that does not meet the demand to be taken
HIGHEST_DEGREE = 3  # that is chosen: its estimate is made with one more
COMPILATION = 10.0  # seconds that are presumed, at least, for kernels of a degree that the run has not used
POWER, SHORTEST = 1.5, 0.01  # ``q`` as long as no factorization has taken so many seconds
SHAMANSKII = 1.5  # factorizations of a solve that begins at the solution of a coarser mesh

type Kind = Literal["everywhere", "in places"]


@dataclass(frozen=True)
class Work:
    """Seconds of ``count`` tangents of one degree: assembled, and factorized."""

    degree: int
    unknowns: int
    count: int
    assembly: float
    factorization: float


@dataclass(frozen=True)
class Step:
    """A discretisation that was solved and estimated.

    Attributes:
        cell: "tetrahedron" or "hexahedron".
        size: of the cells, relative to the first mesh; ``None`` where they were refined in places.
        cells: their number.
        solve, estimate: what they took; the estimate is one tangent of one degree more.
        compilation: seconds.
    """

    cell: str
    size: float | None
    cells: int
    solve: Work
    estimate: Work
    compilation: float

    @property
    def degree(self) -> int:
        return self.solve.degree

    @property
    def unknowns(self) -> int:
        return self.solve.unknowns


@dataclass(frozen=True)
class RefinementChoice:
    """What may come next: all cells smaller by a ``factor``, perhaps of a higher ``degree``, or marked cells refined.

    ``excess`` is the error that is expected, over what is allowed.
    """

    kind: Kind
    factor: float
    degree: int
    unknowns: int
    excess: float
    seconds: float


@dataclass(frozen=True)
class Places:
    """Refinement in places: by how much it multiplies the cells and the error."""

    cells: float
    error: float


class RefinementForecast:
    """Predictions from the steps so far, the last of which is the one to start from.

    Args:
        errors: of the steps, all in the same unit.
        excess: of the last one: its error over what is allowed.
    """

    def __init__(self, steps: Sequence[Step], errors: Sequence[float], excess: float) -> None:
        self.steps, self.errors, self.excess = steps, errors, excess
        self.last = steps[-1]
        done = [work for step in steps for work in (step.solve, step.estimate)]
        self.power, self._factorization = _fit((w.unknowns, w.factorization / max(w.count, 1)) for w in done)
        # Of the largest problem so far: in the smallest there is much besides.
        largest, step = max(
            ((work, step) for step in steps for work in (step.solve, step.estimate)), key=lambda pair: pair[0].unknowns
        )
        self._assembly = largest.assembly / max(largest.count, 1) / (step.cells * nodes(step.cell, largest.degree) ** 3)

    def order(self, degree: int) -> float:
        """``k`` of a degree, where all cells are refined."""
        slopes = self._slopes(degree)
        if len(slopes) > 1:
            return slopes[-1]
        if slopes:  # the coarsest mesh of all may tell little
            return (slopes[0] + degree + 1) / 2
        # What limits the order of one degree, a corner or an edge, limits that of the next.
        seen = {lower: self.order(lower) for lower in range(1, degree) if self._slopes(lower)}
        return min([degree + 1.0, *(k for lower, k in seen.items() if k < lower + 0.5)])

    def is_known(self, degree: int) -> bool:
        """Whether the order of a degree was seen twice, and so is more than presumed."""
        return len(self._slopes(degree)) > 1

    def gain(self, degree: int) -> float:
        """What one degree more leaves of the error on the same mesh."""
        for i in range(len(self.steps) - 1, 0, -1):
            before, after = self.steps[i - 1], self.steps[i]
            if (after.degree, after.cells) == (degree + 1, before.cells) and self.errors[i - 1] > 0:
                return min(max(self.errors[i] / self.errors[i - 1], 0.01), 0.9)
        return GAIN if self.order(degree) >= degree + 0.5 else POOR_GAIN

    def needed(self, degree: int) -> float:
        """By how much smaller all cells must be to meet the demand with a degree."""
        return float(max(self.everywhere(1.0, degree).excess / AIM, 1.0) ** (1 / self.order(degree)))

    def everywhere(self, factor: float, degree: int) -> RefinementChoice:
        """All cells smaller by ``factor``, and perhaps of one degree more."""
        excess = self.excess * factor ** -self.order(degree)
        if degree > self.last.degree:
            excess *= self.gain(self.last.degree)
        return self._choice("everywhere", factor, degree, factor**3, excess)

    def in_places(self, places: Places) -> RefinementChoice:
        """Marked cells refined."""
        return self._choice("in places", 1.0, self.last.degree, places.cells, self.excess * places.error)

    def seconds(self, degree: int, cells: float, unknowns: float) -> float:
        """Of one tangent, assembled and factorized."""
        assembly = self._assembly * cells * nodes(self.last.cell, degree) ** 3
        return float(assembly + self._factorization * unknowns**self.power)

    def _choice(self, kind: Kind, factor: float, degree: int, growth: float, excess: float) -> RefinementChoice:
        cells, unknowns = self.last.cells * growth, self.last.unknowns * growth * (degree / self.last.degree) ** 3
        finer = unknowns * ((degree + 1) / degree) ** 3
        seconds = SHAMANSKII * self.seconds(degree, cells, unknowns) + self.seconds(degree + 1, cells, finer)
        if degree not in {step.degree for step in self.steps}:
            seconds += max(COMPILATION, *(step.compilation for step in self.steps))
        return RefinementChoice(kind, factor, degree, round(unknowns), excess, seconds)

    def _slopes(self, degree: int) -> list[float]:
        """``k`` from each mesh refined everywhere to the next, of the steps of one degree."""
        errors = {
            step.size: error
            for step, error in zip(self.steps, self.errors, strict=True)
            if step.degree == degree and step.size is not None and error > 0
        }
        slopes = [
            math.log(errors[coarse] / errors[fine]) / math.log(coarse / fine)
            for coarse, fine in itertools.pairwise(sorted(errors, reverse=True))
        ]
        return [min(max(slope, 0.5), 2.0 * degree + 1) for slope in slopes]


def nodes(cell: str, degree: int) -> int:
    """Of one cell."""
    return (degree + 1) ** 3 if cell == "hexahedron" else math.comb(degree + 3, 3)


def _fit(points: Iterable[tuple[float, float]]) -> tuple[float, float]:
    """``q`` and ``c`` of ``c N^q`` seconds, by least squares in logarithms through the times that tell something."""
    logs = sorted((math.log(n), math.log(max(t, SHORTEST))) for n, t in points)
    told = [(n, t) for n, t in logs if t > math.log(SHORTEST)] or logs[-1:]
    mean_n, mean_t = (sum(values) / len(told) for values in zip(*told, strict=True))
    spread = sum((n - mean_n) ** 2 for n, _ in told)
    slope = sum((n - mean_n) * (t - mean_t) for n, t in told) / spread if spread > 0 else POWER
    power = min(max(slope, 1.0), 2.2)
    return power, math.exp(mean_t - power * mean_n)


def choose(
    forecast: RefinementForecast, factors: Sequence[float], places: Places | None, *, limit: int, highest: int
) -> RefinementChoice | None:
    """The cheapest discretisation that meets the demand, else the one that gets nearest to it.

    Args:
        factors: by which all cells can be made smaller, ascending.
        places: what refining in places would do if it went on to the end; ``None`` where it is not possible.
        limit: largest number of unknowns.
        highest: degree to which that may be raised.

    ``None`` if nothing that is possible makes the error much smaller.
    """
    last = forecast.last
    choices = [] if places is None else [forecast.in_places(places)]
    for degree in (last.degree, last.degree + 1)[: 1 + (last.degree < highest)]:
        needed = forecast.needed(degree)
        possible = [
            choice
            for factor in ([1.0] if degree > last.degree else []) + list(factors)
            if (choice := forecast.everywhere(factor, degree)).unknowns <= limit
        ]
        choices += [c for c in possible if c.factor >= needed - 1e-9][:1] or possible[-1:]
    choices = [c for c in choices if c.unknowns <= limit]
    if enough := [c for c in choices if c.excess <= 1]:
        return min(enough, key=lambda c: c.seconds)
    best = min(choices, key=lambda c: c.excess, default=None)
    return best if best is not None and best.excess < WORTHWHILE * forecast.excess else None


def cautious(forecast: RefinementForecast, choice: RefinementChoice, factors: Sequence[float]) -> float:
    """The factor to take now: orders that were only presumed, and long ways, are not to be trusted too far."""
    bound = BOLD if forecast.is_known(choice.degree) else CAREFUL
    if choice.factor <= bound:
        return choice.factor
    return max((f for f in factors if f <= bound), default=factors[0])
