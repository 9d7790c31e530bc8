"""Prediction of error and cost of the next discretisation, from those that have been solved.

The error is proportional to ``h^k``, the time of a factorization of ``N`` unknowns to ``N^q``, and the time of assembly
to the number of cells and the cube of their nodes. The exponents are fitted to the steps of the run as soon as two of
them can be compared; until then ``k`` is one more than the degree. With ``f`` times smaller cells, solids have ``f^3``
times as many, shells ``f^2``: their layer has one cell through the thickness.
"""

import itertools
import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from hpcinv.trust.discretisation.estimate import SingularLimit

TARGET = 0.7  # predicted error of a step, as a share of the demand, so that small deviations do not matter
GAIN, POOR_GAIN = 0.2, 0.5  # ratio of errors of one degree more, for smooth and other solutions
CAREFUL, BOLD = 2.0, 4.0  # largest refinement factor of one step, before and after the order was observed
WORTHWHILE = 0.8  # largest ratio of errors of a step that is taken although it does not meet the demand
LARGEST = 1e3  # largest refinement factor that is thought of; larger ones only cost time here
HIGHEST_DEGREE = 3  # largest degree that is chosen; its estimate uses one degree more
PROGRAMS = 1.0  # smallest presumed time (s) to make programs of a degree that the run has not used
POWER, SHORTEST = 1.5, 0.01  # ``q`` until a factorization has taken so many seconds
SHAMANSKII = 1.5  # number of factorizations of a solve from the solution on a coarser mesh

type RefinementKind = Literal["everywhere", "in places"]


@dataclass(frozen=True)
class Work:
    """Seconds for assembly and factorization of ``count`` tangents of one degree on ``cells`` cells."""

    degree: int
    cells: int
    unknowns: int
    count: int
    assembly: float
    factorization: float


@dataclass(frozen=True)
class Step:
    """Costs of a discretisation that was solved and estimated.

    Attributes:
        cell: "tetrahedron" or "hexahedron".
        size: size of the cells relative to the first mesh; ``None`` if they were refined locally.
        solve: work of the solve.
        estimate: work of the error estimate: a tangent of one degree more, of a shell on halved cells.
        programs: seconds to make programs.
        dimension: number of directions in which cells get smaller: 3, or 2 for a shell.
    """

    cell: str
    size: float | None
    cells: int
    solve: Work
    estimate: Work
    programs: float
    dimension: Literal[2, 3] = 3

    @property
    def degree(self) -> int:
        return self.solve.degree

    @property
    def unknowns(self) -> int:
        return self.solve.unknowns


@dataclass(frozen=True)
class RefinementChoice:
    """Possible next step: all cells smaller by a ``factor``, perhaps of a higher ``degree``, or marked cells refined.

    ``excess`` is the predicted ratio of the error to the demand.
    """

    kind: RefinementKind
    factor: float
    degree: int
    unknowns: int
    excess: float
    seconds: float


@dataclass(frozen=True)
class RefinementPlaces:
    """Local refinement: factors on the number of cells and on the error."""

    cells: float
    error: float


class RefinementForecast:
    """Predictions from the steps so far, relative to the last one.

    Args:
        errors: of the steps, all in the same unit.
        excess: ratio of the last error to the demand.
        limit: effect of singular edges on the last error, ``None`` without one.
    """

    def __init__(
        self, steps: Sequence[Step], errors: Sequence[float], excess: float, limit: SingularLimit | None = None
    ) -> None:
        self.steps, self.errors, self.excess, self.limit = steps, errors, excess, limit
        self.last = steps[-1]
        done = [work for step in steps for work in (step.solve, step.estimate)]
        self.power, self._factorization = _fit((w.unknowns, w.factorization / max(w.count, 1)) for w in done)
        # Measured on the largest problem so far: overhead matters least there.
        largest = max(done, key=lambda work: work.unknowns)
        work_of_nodes = largest.cells * nodes(self.last.cell, largest.degree) ** 3
        self._assembly = largest.assembly / max(largest.count, 1) / work_of_nodes

    def order(self, degree: int) -> float:
        """Return ``k`` of a degree if all cells are refined."""
        slopes = self._slopes(degree)
        if len(slopes) > 1:
            return slopes[-1]
        if slopes:  # the coarsest mesh may be outside the asymptotic range
            return (slopes[0] + degree + 1) / 2
        # A singularity at a corner or an edge limits the order of each degree.
        seen = {lower: self.order(lower) for lower in range(1, degree) if self._slopes(lower)}
        return min([degree + 1.0, *(k for lower, k in seen.items() if k < lower + 0.5)])

    def is_known(self, degree: int) -> bool:
        """Return whether the order of a degree was observed twice."""
        return len(self._slopes(degree)) > 1

    def gain(self, degree: int) -> float:
        """Return the ratio of errors of one degree more on the same mesh."""
        for i in range(len(self.steps) - 1, 0, -1):
            earlier, later = self.steps[i - 1], self.steps[i]
            if (later.degree, later.cells) == (degree + 1, earlier.cells) and self.errors[i - 1] > 0:
                return min(max(self.errors[i] / self.errors[i - 1], 0.01), 0.9)
        return GAIN if self.order(degree) >= degree + 0.5 else POOR_GAIN

    def needed(self, degree: int) -> float:
        """Return the refinement factor of all cells that meets the demand with a degree."""
        if self.limit is None:
            return float(max(self.everywhere(1.0, degree).excess / TARGET, 1.0) ** (1 / self.order(degree)))
        low, high = 0.0, math.log(LARGEST)
        for _ in range(40):
            middle = (low + high) / 2
            low, high = (middle, high) if self._reached(math.exp(middle), degree) > TARGET else (low, middle)
        return math.exp(low)

    def everywhere(self, factor: float, degree: int) -> RefinementChoice:
        """Return the choice of all cells smaller by ``factor``, perhaps with one degree more."""
        growth = factor**self.last.dimension
        return self._choice("everywhere", factor, degree, growth, self._reached(factor, degree))

    def _reached(self, factor: float, degree: int) -> float:
        """Return the predicted ratio of the error to the demand."""
        if self.limit is not None:
            return self.excess * self.limit.remaining(factor, self.last.degree, degree)
        gain = self.gain(self.last.degree) if degree > self.last.degree else 1.0
        return float(self.excess * gain * factor ** -self.order(degree))

    def local_choice(self, places: RefinementPlaces) -> RefinementChoice:
        """Return the choice of refining marked cells."""
        return self._choice("in places", 1.0, self.last.degree, places.cells, self.excess * places.error)

    def seconds(self, degree: int, cells: float, unknowns: float) -> float:
        """Return the seconds for assembly and factorization of one tangent."""
        assembly = self._assembly * cells * nodes(self.last.cell, degree) ** 3
        return float(assembly + self._factorization * unknowns**self.power)

    def _choice(
        self, kind: RefinementKind, factor: float, degree: int, growth: float, excess: float
    ) -> RefinementChoice:
        cells, unknowns = self.last.cells * growth, self.last.unknowns * growth * (degree / self.last.degree) ** 3
        seconds = SHAMANSKII * self.seconds(degree, cells, unknowns)
        if self.last.dimension == 2:
            seconds += self.seconds(degree, 4 * cells, 4 * unknowns)
        else:
            seconds += self.seconds(degree + 1, cells, unknowns * ((degree + 1) / degree) ** 3)
        if degree not in {step.degree for step in self.steps}:
            seconds += max(PROGRAMS, *(step.programs for step in self.steps))
        return RefinementChoice(kind, factor, degree, round(unknowns), excess, seconds)

    def _slopes(self, degree: int) -> list[float]:
        """Return ``k`` between successive uniformly refined meshes, for the steps of one degree."""
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
    """Return the number of nodes of one cell."""
    return (degree + 1) ** 3 if cell == "hexahedron" else math.comb(degree + 3, 3)


def _fit(points: Iterable[tuple[float, float]]) -> tuple[float, float]:
    """Return ``q`` and ``c`` of ``c N^q`` seconds, by least squares in logarithms, without short times."""
    logs = sorted((math.log(n), math.log(max(t, SHORTEST))) for n, t in points)
    sizes, times = zip(*[(n, t) for n, t in logs if t > math.log(SHORTEST)] or logs[-1:], strict=True)
    slope = statistics.linear_regression(sizes, times).slope if len(set(sizes)) > 1 else POWER
    power = min(max(slope, 1.0), 2.2)
    return power, math.exp(statistics.fmean(times) - power * statistics.fmean(sizes))


def choose(
    forecast: RefinementForecast, factors: Sequence[float], places: RefinementPlaces | None, *, limit: int, highest: int
) -> RefinementChoice | None:
    """Return the cheapest discretisation that meets the demand, else the most accurate one.

    Args:
        factors: possible refinement factors of all cells, ascending.
        places: effect of complete local refinement; ``None`` if it is not possible.

    Returns:
        ``None`` if no possible choice reduces the error much.
    """
    last = forecast.last
    choices = [] if places is None else [forecast.local_choice(places)]
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
    """Return the refinement factor of the next step, which is bounded since predictions become uncertain."""
    bound = BOLD if forecast.is_known(choice.degree) else CAREFUL
    if choice.factor <= bound:
        return choice.factor
    return max((f for f in factors if f <= bound), default=factors[0])
