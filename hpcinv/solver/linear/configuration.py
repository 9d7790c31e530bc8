"""Interface of the configurations of the linear solver."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar

from petsc4py import PETSc

from hpcinv.model.outcome import Outcome
from hpcinv.solver.linear.convergence_test import Settling
from hpcinv.solver.petsc_options import OptionValue


class LinearConfiguration(ABC):
    """A linear solver for the tangent: PETSc options, and settings that are not options.

    Attributes:
        name: value of ``solver.linear``.
        options: PETSc options without prefix.
        exact: whether it solves to rounding errors.
        has_analysis: whether a set-up keeps what later ones need, as a symbolic factorization.
        error: relative error of a correction of Newton's method.
        test: convergence test of Krylov iterations, without effect on a solver that has none.
    """

    name: ClassVar[str]
    exact: ClassVar[bool]
    has_analysis: ClassVar[bool]
    error: ClassVar[float] = 0.0

    def __init__(self, test: Settling) -> None:
        self.test = test

    @property
    @abstractmethod
    def options(self) -> Mapping[str, OptionValue]: ...

    @abstractmethod
    def prepare(self, ksp: PETSc.KSP, matrix: PETSc.Mat) -> None:
        """Prepare the solver for a tangent that was just assembled; collective."""

    def set_accuracy(self, *, precise: bool) -> None:
        """Solve to the accuracy of a solution from now on, or, as initially, of a correction."""
        self.test.precise = precise

    def set_rough(self, *, rough: bool) -> None:
        """Loosen the tolerance from now on, where other iterations make up for that, or restore it."""
        self.test.rough = rough

    @property
    def note(self) -> str:
        """Text on unusual settings; empty without any."""
        return ""

    def keep(self, ksp: PETSc.KSP) -> bool:
        """Return whether the last set-up may serve for a tangent that was just assembled, which is then prepared."""
        return False

    def must_renew(self, ksp: PETSc.KSP) -> bool:
        """Return whether the last solution with a kept set-up must be repeated with a new one."""
        return False

    def must_refactorize(self, ksp: PETSc.KSP) -> bool:
        """Return whether the last set-up must be repeated; its replacement is then prepared."""
        return False

    def sign_of_determinant(self, ksp: PETSc.KSP) -> int:
        """Return the sign of the determinant of the factorized tangent; 0 if it is not known."""
        return 0

    def larger_workspace(self, ksp: PETSc.KSP) -> Mapping[str, OptionValue]:
        """Return options with which the last set-up may succeed, if it failed for lack of workspace; collective."""
        return {}

    def failure(self, ksp: PETSc.KSP) -> Outcome:
        """Return the reason why the last set-up or solution failed; collective."""
        return Outcome.KRYLOV_LIMIT

    def destroy(self) -> None:
        """Free PETSc objects."""
        self.test.destroy()
