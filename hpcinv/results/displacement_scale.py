"""The displacement that errors of a solution are compared with: its largest one, or a floor where that is zero."""

from dataclasses import dataclass

from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations

FLOOR = 1e-6
"""Share of the nominal displacement that is the floor. A larger one hides errors of bodies that are nearly held or
balanced; below 1e-9, rounding errors of such bodies count as errors."""
_LARGEST = 2.0  # nominal displacement is less, in scaled lengths


@dataclass(frozen=True)
class DisplacementScale:
    """Scale (m) of the errors of a solution.

    Attributes:
        length: the largest displacement, or the floor.
        note: which floor was taken, and why; empty if ``length`` is the largest displacement.
    """

    length: float
    note: str = ""

    def share(self, distance: float) -> float:
        """Return a distance (m) relative to the scale, or as it is where nothing loads the body."""
        return distance / self.length if self.length else distance


def nominal_sizes(equations: Equations, solution: Solution) -> tuple[float, float]:
    """Return nominal displacement (m) and force (scaled) of a solution (`NominalDisplacement`); collective."""
    equations.put(solution)
    with equations.timings("programs"):
        weak_form = equations.weak_form(solution.direction)
        nominal = weak_form.nominal_displacement
    with equations.timings("evaluation"):
        displacement, force = nominal()
    return displacement * equations.scales.length, force


def displacement_scale(equations: Equations, solution: Solution) -> DisplacementScale:
    """Return the scale of a solution; collective."""
    largest = solution.largest_displacement
    if largest >= FLOOR * _LARGEST * equations.scales.length:
        return DisplacementScale(largest)
    nominal, _ = nominal_sizes(equations, solution)
    if largest >= FLOOR * nominal:
        return DisplacementScale(largest)
    text = f"the displacement is {largest:.1g} m, so this is relative to {FLOOR:g} of the {nominal:.2g} m"
    return DisplacementScale(FLOOR * nominal, f"{text} that loads and inelastic strains would cause without balance")
