"""Linear systems with the tangent of a system of equations, solved by PETSc's KSP."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from petsc4py import PETSc

from hpcinv.parallel.malloc import give_back_memory
from hpcinv.parallel.petsc_vectors import norm
from hpcinv.solver.linear.direct import Direct
from hpcinv.solver.linear.iterative import Iterative
from hpcinv.solver.linear.selection import Choice, Used
from hpcinv.solver.petsc_options import SolverOptions, Value

if TYPE_CHECKING:
    from hpcinv.assembly.system import System
    from hpcinv.solver.linear.configuration import Configuration


class LinearSolver:
    """``K x = b`` with the tangent K of a system; its symbolic analysis serves the whole run.

    The tangent that was last assembled counts: it is factorized when it is first needed.

    Args:
        system: assembles the tangent.
        options: PETSc options of the job, beside those of the configuration.
        choice: configuration of the linear solver, and whether the other one may be tried where it fails.

    Attributes:
        options: as PETSc has them, those of Newton's method included.
        fallback: why the other configuration was taken, if it was.
    """

    def __init__(self, system: System, options: Mapping[str, Value], choice: Choice) -> None:
        self.system, self.choice = system, choice
        self.fallback: str | None = None
        self._iterations = 0
        self._factorized = -1  # number of the tangent whose factors are at hand
        with system.timings("set-up"):
            self.options = SolverOptions(options)
            self.ksp = PETSc.KSP().create(system.comm)
            self.ksp.setOptionsPrefix(SolverOptions.prefix)
            self.configuration = self._use(choice.configuration)

    def _use(self, name: str) -> Configuration:
        own = self.choice.is_own
        configuration: Configuration = Direct(symmetric=not own) if name == "direct" else Iterative(self.system.scene)
        self._factorized = -1
        self.options.use(configuration.options)
        self.ksp.reset()
        self.ksp.setOperators(self.system.matrix)
        self.ksp.setFromOptions()
        return configuration

    @property
    def used(self) -> Used:
        """Which linear solver it is by now, and why."""
        return Used(self.configuration.name, self.choice.why, self.fallback, self.system.note)

    def factorize(self) -> None:
        """Factorize the tangent that was last assembled, or make its preconditioner, unless that is done already."""
        if self._factorized == self.system.tangents:
            return
        with self.system.timings("factorization"):
            self.ksp.setOperators(self.system.matrix)
            self.configuration.prepare(self.ksp, self.system.matrix)
            self.ksp.setUp()
            if self.configuration.must_refactorize(self.ksp):
                self.ksp.setUp()
            self.ksp.setUpOnBlocks()
        self._factorized = self.system.tangents

    def solve(self, b: PETSc.Vec, x: PETSc.Vec) -> bool:
        """``x = K⁻¹ b`` to rounding errors, or to the accuracy of an iterative solver; false if that failed."""
        self.factorize()
        self.configuration.set_accuracy(precise=True)
        self.limit_iterations()
        with self.system.timings("linear solve"):
            solved = self.back_substitute(b, x)
        self.configuration.set_accuracy(precise=False)
        if solved:
            return True
        if self.fall_back():
            return self.solve(b, x)
        self.forget_factors()
        return False

    def limit_iterations(self) -> None:
        """Allow the Krylov iterations of one solve of Newton's method from now on."""
        self.configuration.allow(self.choice.budget)

    def back_substitute(self, b: PETSc.Vec, x: PETSc.Vec) -> bool:
        """``x = K⁻¹ b`` with the factors or the preconditioner at hand; false if that failed."""
        self.ksp.solve(b, x)
        self.count_iterations(self.ksp.getIterationNumber())
        reason: Any = self.ksp.getConvergedReason()  # an int, whatever its stub says
        return reason >= 0 and bool(np.isfinite(norm(x)))

    def count_iterations(self, number: int) -> None:
        """Take note of what a linear solve took."""
        if not self.configuration.exact:
            self._iterations += number

    def take_iterations(self) -> int:
        """Krylov iterations since this was asked last."""
        number, self._iterations = self._iterations, 0
        return number

    def fall_back(self) -> bool:
        """Change to the other configuration after a failure, if that may help."""
        if self.fallback is not None or self.choice.other is None:
            return False
        if self.configuration.exact and not self.configuration.lacked_memory(self.ksp):
            return False  # a singular tangent stays singular
        what = "did not converge" if not self.configuration.exact else "ran out of memory"
        self.fallback = f"the {self.configuration.name} solver {what}: {self.choice.other} from there on"
        self.configuration.destroy()
        self.configuration = self._use(self.choice.other)
        self.ksp.setConvergenceTest(None)  # drops that of the configuration before
        return True

    def release_preconditioner(self) -> None:
        """Free multigrid until the solver is used again; a symbolic factorization is kept."""
        if not self.configuration.exact:
            self.ksp.reset()
            self._factorized = -1
            give_back_memory()

    def forget_factors(self) -> None:
        """Begin again after a factorization that failed: MUMPS cannot go on."""
        self._factorized = -1
        self.options.restore()
        self.ksp.pc.reset()

    def sign_of_determinant(self) -> int:
        """Of the tangent whose factors are at hand; 0 if the linear solver does not tell."""
        return self.configuration.sign_of_determinant(self.ksp)

    def destroy(self) -> None:
        """Free what PETSc holds."""
        self.options.remove()
        self.configuration.destroy()
        self.ksp.destroy()
