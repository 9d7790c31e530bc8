"""What is told of one solve at a fixed load factor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hpcinv.model.outcome import Outcome
    from hpcinv.solver.newton import NewtonIteration


@dataclass(frozen=True)
class Solve:
    """What one solve at a fixed load factor did; ``iterations`` is empty if a test of the user's options ended it.

    ``signs`` are those of the determinants of its tangents (empty if the linear solver does not tell them): the number
    of negative eigenvalues has changed by an odd number where it changes. ``position_residual`` is the distance of the
    loaded body from the given one (m) after a step of a fixed-point method. ``linear_iterations`` are those of a Krylov
    solver, if there is one. ``strategy`` is what it was a part of; at a ``turning_point`` the load is an extremum along
    the path.
    """

    load: float
    outcome: Outcome
    iterations: tuple[NewtonIteration, ...]
    factorizations: int
    signs: tuple[int, ...] = ()
    position_residual: float | None = None
    linear_iterations: int = 0
    strategy: str = "load steps"
    turning_point: bool = False
