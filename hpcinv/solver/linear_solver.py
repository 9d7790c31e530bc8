"""Linear systems with the tangent of a system of equations, solved by PETSc's KSP."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from petsc4py import PETSc

from hpcinv.parallel.malloc import release_freed_memory
from hpcinv.parallel.petsc_vectors import norm
from hpcinv.solver.linear.direct import Direct
from hpcinv.solver.linear.iterative import Iterative
from hpcinv.solver.linear.selection import Choice, Used
from hpcinv.solver.petsc_options import SolverOptions, Value

if TYPE_CHECKING:
    from hpcinv.assembly.system import System
    from hpcinv.solver.linear.configuration import Configuration


class LinearSolver:
    """Linear solver for ``K x = b`` with the tangent K of a system; one symbolic analysis serves the whole run.

    K is the last assembled tangent, which is factorized when it is first needed.

    Args:
        system: assembles the tangent.
        options: PETSc options of the job, which extend or replace options of the configuration.
        choice: configuration of the linear solver, and whether the other one may be tried where it fails.

    Attributes:
        options: options in PETSc's database, including options of Newton's method.
        fallback: reason why the other configuration was taken, if it was.
    """

    def __init__(self, system: System, options: Mapping[str, Value], choice: Choice) -> None:
        self.system, self.choice = system, choice
        self.fallback: str | None = None
        self._iterations = 0
        self._factorized = -1  # number of the tangent that was factorized last
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
        """The present configuration, and the reasons for it."""
        return Used(self.configuration.name, self.choice.why, self.fallback, self.system.note)

    def factorize(self) -> None:
        """Factorize the last assembled tangent, or set up its preconditioner, unless that is done already."""
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
        """Solve to rounding errors, or to the accuracy of an iterative solver; return whether that succeeded."""
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
        """Limit the Krylov iterations from now on to those of one solve of Newton's method."""
        self.configuration.allow(self.choice.budget)

    def back_substitute(self, b: PETSc.Vec, x: PETSc.Vec) -> bool:
        """Solve with the present factors or preconditioner; return whether that succeeded."""
        self.ksp.solve(b, x)
        self.count_iterations(self.ksp.getIterationNumber())
        reason: Any = self.ksp.getConvergedReason()  # an int, whatever its stub says
        return reason >= 0 and bool(np.isfinite(norm(x)))

    def count_iterations(self, number: int) -> None:
        """Add to the number of Krylov iterations."""
        if not self.configuration.exact:
            self._iterations += number

    def take_iterations(self) -> int:
        """Return the number of Krylov iterations since the last call."""
        number, self._iterations = self._iterations, 0
        return number

    def fall_back(self) -> bool:
        """Change to the other configuration after a failure; return whether there is one that may help."""
        if self.fallback is not None or self.choice.other is None:
            return False
        if self.configuration.exact and not self.configuration.lacked_memory(self.ksp):
            return False  # a singular tangent stays singular
        what = "did not converge" if not self.configuration.exact else "ran out of memory"
        self.fallback = f"the {self.configuration.name} solver {what}: {self.choice.other} from there on"
        self.configuration.destroy()
        self.configuration = self._use(self.choice.other)
        self.ksp.setConvergenceTest(None)  # removes the test of the previous configuration
        return True

    def release_preconditioner(self) -> None:
        """Free the multigrid hierarchy until the solver is used again; a symbolic factorization is kept."""
        if not self.configuration.exact:
            self.ksp.reset()
            self._factorized = -1
            release_freed_memory()

    def forget_factors(self) -> None:
        """Discard the factors after a failed factorization, with which MUMPS cannot continue."""
        self._factorized = -1
        self.options.restore()
        self.ksp.pc.reset()

    def sign_of_determinant(self) -> int:
        """Return the sign of the determinant of the factorized tangent; 0 if it is not known."""
        return self.configuration.sign_of_determinant(self.ksp)

    def destroy(self) -> None:
        """Free PETSc objects."""
        self.options.remove()
        self.configuration.destroy()
        self.ksp.destroy()
