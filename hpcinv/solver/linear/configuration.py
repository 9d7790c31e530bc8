"""What a linear solver is asked for, whichever it is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from petsc4py import PETSc

    from hpcinv.solver.petsc_options import Value


class Configuration(ABC):
    """A linear solver for the tangent: PETSc options, and what options cannot say.

    Attributes:
        name: as ``solver.linear`` has it.
        options: PETSc options without prefix.
        exact: whether it solves to rounding errors.
        error: of a correction, relative to its norm, as far as the solver goes where that will do.
    """

    name: ClassVar[str]
    exact: ClassVar[bool]
    error: ClassVar[float] = 0.0

    @property
    @abstractmethod
    def options(self) -> Mapping[str, Value]: ...

    @abstractmethod
    def prepare(self, ksp: PETSc.KSP, matrix: PETSc.Mat) -> None:
        """Take in a tangent that was just assembled; collective."""

    def set_accuracy(self, *, precise: bool) -> None:  # noqa: B027  (exact ones have no choice)
        """Solve systems for their own sake from now on, or, as at first, as far as a correction has to be."""

    def allow(self, iterations: int) -> None:  # noqa: B027  (exact ones take none)
        """Take so many Krylov iterations at most, in all solutions from now on."""

    def must_refactorize(self, ksp: PETSc.KSP) -> bool:
        """Whether the set-up that has just been made must be made again, in another way that is then prepared."""
        return False

    @abstractmethod
    def sign_of_determinant(self, ksp: PETSc.KSP) -> int:
        """Of the tangent whose factors are at hand; 0 if they do not tell."""

    @abstractmethod
    def lacked_memory(self, ksp: PETSc.KSP) -> bool:
        """Whether the last set-up failed for want of memory."""

    def destroy(self) -> None:  # noqa: B027  (most hold nothing)
        """Free what PETSc holds."""
