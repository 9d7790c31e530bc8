"""Interface of unknown numbers of loads or supports, with as many equations for them."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
from petsc4py import PETSc

from hpcinv.mesh.source import Floats


class Border(ABC):
    """Unknown numbers q on which the equilibrium ``R(x, q) = 0`` depends, and equations ``C(x, q) = 0`` for them.

    Methods are collective.

    Attributes:
        count: number of unknowns, and of equations.
        least: displacement (scaled) that rounding errors of C let count as none.
        least_load: load factor below which the numbers cannot be put in.
    """

    count: int
    least: float = 0.0
    least_load: float = 0.0

    @abstractmethod
    def put(self, load: float) -> None:
        """Put the present numbers into the system, whose load factor is ``load``."""

    @abstractmethod
    def kept_numbers(self) -> Any:
        """Return the present numbers for `restore`."""

    @abstractmethod
    def restore(self, numbers: Any) -> None:
        """Take numbers that `kept_numbers` returned; they are not put into the system."""

    @abstractmethod
    def change(self, change: Floats) -> None:
        """Change the numbers by ``Δq``; they are not put into the system."""

    @abstractmethod
    def recover(self, load: float) -> None:
        """Set the numbers that the present state has, an equilibrium at this load factor, such as a checkpoint."""

    def begin_path(self) -> None:  # noqa: B027  (most need nothing)
        """Let C lead from its value at the present state, where the system's path begins, to the value at full load."""

    @abstractmethod
    def equations(self, load: float) -> Floats:
        """Return C at the present state."""

    def force_rates(self, rates: Floats) -> Floats:
        """Return the derivatives of C along rates of the nodal forces (scaled) of the owned unknowns."""
        return np.zeros(self.count)

    @abstractmethod
    def set_columns(self, columns: Sequence[PETSc.Vec], r: PETSc.Vec, load: float) -> None:
        """Set the columns to ``∂R/∂q`` at the present state, where R is ``r``."""

    @abstractmethod
    def linearise(self, load: float) -> Floats:
        """Return ``∂C/∂q`` (count, count) at the present state; `slopes` are from there until the next call."""

    @abstractmethod
    def slopes(self, direction: PETSc.Vec) -> Floats:
        """Return the derivatives ``∂C/∂x`` along a direction."""

    def destroy(self) -> None:  # noqa: B027  (most have none)
        """Free PETSc objects."""
