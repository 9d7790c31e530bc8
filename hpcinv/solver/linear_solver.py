"""Linear systems with the tangent of a system of equations, solved by PETSc's KSP."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from petsc4py import PETSc

from hpcinv.base.parallel.malloc import release_freed_memory
from hpcinv.base.parallel.petsc_calls import set_up, solve
from hpcinv.base.parallel.petsc_vectors import norm
from hpcinv.model.assembly.system import System
from hpcinv.model.outcome import Outcome
from hpcinv.on_demand import on_demand
from hpcinv.solver.linear.configuration import LinearConfiguration
from hpcinv.solver.linear.factorization import Direct, is_mumps
from hpcinv.solver.linear.selection import Choice, Used
from hpcinv.solver.petsc_options import OptionValue, SolverOptions


class LinearSolver:
    """Linear solver for ``K x = b`` with the tangent K of a system; one symbolic analysis serves the whole run.

    K is the last assembled tangent, which is factorized when it is first needed.

    Args:
        system: assembles the tangent.
        options: PETSc options of the job, which extend or replace options of the configuration.
        choice: configuration of the linear solver, and whether the other one may be tried where it fails.
        where: place of the options in messages.

    Attributes:
        options: options in PETSc's database, including options of Newton's method.
        fallback: reason why the other configuration was taken, if it was.
        factorizations: number of tangents that were factorized, or for which a preconditioner was set up.
        failure: reason why the last solution failed, if one has.

    Raises:
        JobError: from every method, if PETSc refuses options of the job, or fails with them.
    """

    def __init__(
        self, system: System, options: Mapping[str, OptionValue], choice: Choice, where: str = "solver.petsc"
    ) -> None:
        self.system, self.choice = system, choice
        self.fallback: str | None = None
        self.factorizations, self.failure = 0, Outcome.LINEAR_SOLVER
        self._iterations, self._has_changed, self._has_options = 0, False, bool(options)
        self._is_refined = choice.is_refined
        self._factorized = -1  # number of the tangent that was factorized last
        self._pattern = 0
        self._released = -1  # number of the tangent whose factors were given up, as long as they exist
        with system.timings("set-up"):
            self.options = SolverOptions(options, where)
            self.ksp = PETSc.KSP().create(system.comm)
            self.ksp.setOptionsPrefix(SolverOptions.prefix)
            if system.director is not None:
                system.director.attach(self.ksp)
            self.configuration = self._use(choice.configuration)

    def _use(self, name: str) -> LinearConfiguration:
        configuration: LinearConfiguration
        choice = self.choice
        # Of bodies that turn far, only the first inverse tangent is symmetric: factors L U of all have one analysis.
        may_be_symmetric = choice.nearly_symmetric or self.system.weak_form.kinematics.direction == "forward"
        if name == "iterative":
            iterative = on_demand("multigrid")(self.system.weak_form)
            iterative.test.most = choice.most
            configuration = iterative
        elif self._is_refined:
            configuration = on_demand("refined factors")(
                self.system.weak_form.unknowns,
                symmetric=may_be_symmetric,
                low_rank=choice.low_rank,
                precision=choice.precision,
                minimum_fill=choice.minimum_fill,
                nearly_symmetric=choice.nearly_symmetric,
            )
        else:
            configuration = Direct(
                self.system.weak_form.unknowns,
                symmetric=may_be_symmetric and not choice.is_own,
                minimum_fill=choice.minimum_fill,
            )
        self._factorized, self._released = -1, -1
        self.options.use(configuration.options)
        self.ksp.reset()
        self.ksp.setOperators(self.system.matrix)
        with self.options.blamed():
            self.ksp.setFromOptions()
        return configuration

    @property
    def used(self) -> Used:
        """The present configuration, and the reasons for it."""
        notes = (self.system.note, self.configuration.note)
        return Used(self.configuration.name, self.choice.why, self.fallback, "; ".join(filter(None, notes)))

    def factorize(self, *, may_keep: bool = False) -> None:
        """Factorize the last assembled tangent, or set up its preconditioner, unless that is done already.

        Args:
            may_keep: whether factors of an earlier tangent may precondition this one instead.
        """
        if self._factorized == self.system.tangents:
            return
        if may_keep and self._factorized >= 0 and self.configuration.keep(self.ksp):
            self.ksp.setOperators(self.system.matrix)
            self._factorized = self.system.tangents
            return
        with self.system.timings("factorization"), self.options.blamed():
            self._set_up()
            while larger := self.configuration.larger_workspace(self.ksp):
                self.options.change(larger)
                self.ksp.pc.reset()
                self._set_up()
            self.ksp.setUpOnBlocks()
            self.ksp.pc.setReusePreconditioner(True)
        self._factorized, self._released = self.system.tangents, -1

    def _set_up(self) -> None:
        if self._pattern != self.system.pattern:  # PETSc would free what MUMPS has of the nodes' order
            self.ksp.pc.reset()
            self._pattern = self.system.pattern
        self.ksp.pc.setReusePreconditioner(False)
        self.ksp.setOperators(self.system.matrix)
        self.configuration.prepare(self.ksp, self.system.matrix)
        set_up(self.ksp)
        if self.configuration.must_refactorize(self.ksp):
            set_up(self.ksp.pc)  # the KSP takes itself for set up
        self.factorizations += 1

    def factorize_if_needed(self) -> None:
        """Let the factors of an earlier tangent precondition the last one, also if they were released.

        If there are none, or the configuration has no iterations for that, the last tangent is factorized.
        """
        self._factorized = max(self._factorized, self._released)
        self.factorize(may_keep=True)

    def become_exact(self) -> bool:
        """Change to factors in double precision, unless they are too large; return whether one application solves."""
        if self._is_refined and self.configuration.name == "direct" and not self.choice.low_rank:
            self._is_refined, kept_fallback = False, self.fallback
            self._replace("direct", "")
            self.fallback = kept_fallback
        return self.configuration.exact

    def reuse_factors(self) -> bool:
        """Let factors of an earlier tangent, also released ones, serve as they are; return whether there are any.

        Only a solver that is exact in one application of its factors needs no tangent that belongs to them.
        """
        if not self.configuration.exact or max(self._factorized, self._released) < 0:
            return False
        self._factorized = self.system.tangents
        return True

    def solve(self, b: PETSc.Vec, x: PETSc.Vec, *, may_fall_back: bool = True) -> bool:
        """Solve to rounding errors, or to the accuracy of an iterative solver; return whether that succeeded.

        Args:
            may_fall_back: whether another configuration may be taken if this one fails.
        """
        self.factorize()
        self.configuration.set_accuracy(precise=True)
        self.limit_iterations()
        with self.system.timings("linear solve"):
            solved = self.back_substitute(b, x)
        self.configuration.set_accuracy(precise=False)
        if solved or not may_fall_back:
            return solved
        if self.fall_back():
            return self.solve(b, x)
        self.forget_factors()
        return False

    def limit_iterations(self) -> None:
        """Limit the Krylov iterations from now on to the iterations of one solve of Newton's method."""
        self.configuration.test.left = self.choice.budget

    def back_substitute(self, b: PETSc.Vec, x: PETSc.Vec) -> bool:
        """Solve with the present factors or preconditioner; return whether that succeeded."""
        if not np.isfinite(norm(b)) or self._has_failed_factors:  # an error of PETSc would leave b locked
            return False
        with self.options.blamed():
            solve(self.ksp, b, x)
        self.count_iterations(self.ksp.getIterationNumber())
        if self.must_renew:
            self.renew()
            return self.back_substitute(b, x)
        reason: Any = self.ksp.getConvergedReason()  # an int, whatever its stub says
        return reason >= 0 and bool(np.isfinite(norm(x)))

    @property
    def _has_failed_factors(self) -> bool:
        """True if MUMPS has not factorized the tangent, which PETSc forgets when it is asked a second time."""
        return is_mumps(self.ksp.pc) and self.ksp.pc.getFactorMatrix().getMumpsInfog(1) < 0

    @property
    def has_factors(self) -> bool:
        """True if there are factors by MUMPS for the unknowns at the nodes, of this tangent or an earlier one."""
        if self.system.director is not None:
            return False
        return (
            self.configuration.name == "direct" and max(self._factorized, self._released) >= 0 and is_mumps(self.ksp.pc)
        )

    @property
    def has_set_up(self) -> bool:
        """True if there are such factors, or multigrid whose memory was not freed."""
        is_multigrid = self.configuration.name == "iterative"
        return self.has_factors or (is_multigrid and max(self._factorized, self._released) >= 0)

    @property
    def has_linear_preconditioner(self) -> bool:
        """True if the preconditioner is linear: none by iterations, which PETSc's options of the job may choose."""
        return not self._has_options and self.system.weak_form.unknowns.p is None

    @property
    def has_transpose(self) -> bool:
        """True if factors or preconditioner can be applied transposed, which PETSc's options of the job may prevent."""
        return self.configuration.name == "direct" or not self._has_options

    def apply_factors(self, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Solve with the present factors as they are, without Krylov iterations."""
        with self.options.blamed():
            self.ksp.pc.apply(b, x)

    @property
    def must_renew(self) -> bool:
        """True if the last solution must be repeated with new factors, earlier ones being no longer good."""
        return self.configuration.must_renew(self.ksp)

    def renew(self) -> None:
        """Factorize the last assembled tangent, which was preconditioned by earlier factors."""
        self._factorized = -1
        self.factorize()

    def count_iterations(self, number: int) -> None:
        """Add to the number of Krylov iterations."""
        if not self.configuration.exact:
            self._iterations += number

    def take_iterations(self) -> int:
        """Return the number of Krylov iterations since the last call."""
        number, self._iterations = self._iterations, 0
        return number

    def fall_back(self) -> bool:
        """Change to another configuration after a failure; return whether there is one that may help."""
        if self._is_refined and self.configuration.name == "direct":
            self._is_refined = False
            kinds = {"single": "in single precision", "double": "of earlier tangents"}
            text = f"factors {kinds[self.choice.precision]} did not suffice: double precision from there on"
            self._replace("direct", text)
            return True
        if self._has_changed or self.choice.other is None:
            return False
        failure = self.configuration.failure(self.ksp)
        if failure is Outcome.LINEAR_SOLVER:
            return False  # a singular tangent stays singular
        what = "did not converge" if failure is Outcome.KRYLOV_LIMIT else "ran out of memory"
        self._has_changed = True
        self._replace(
            self.choice.other, f"the {self.configuration.name} solver {what}: {self.choice.other} from there on"
        )
        return True

    def _replace(self, name: str, reason: str) -> None:
        self.fallback = reason
        self.configuration.destroy()
        self.configuration = self._use(name)
        self.ksp.setConvergenceTest(None)  # removes the test of the previous configuration

    def release_preconditioner(self) -> None:
        """Let the next solve of Newton's method begin without the present factors, or without this preconditioner.

        `factorize_if_needed` takes them all the same.
        """
        self._released, self._factorized = max(self._factorized, self._released), -1

    def free_preconditioner(self) -> None:
        """Free the memory of the multigrid hierarchy; a factorization is kept."""
        if not self.configuration.has_analysis:
            self._released, self._factorized = -1, -1
            self.ksp.reset()
            release_freed_memory()

    def free_krylov_vectors(self) -> None:
        """Free the memory of Krylov vectors; the preconditioner is kept."""
        krylov = self.ksp.getType()
        self.ksp.setType(PETSc.KSP.Type.NONE)
        self.ksp.setType(krylov)
        with self.options.blamed():
            self.ksp.setFromOptions()
        release_freed_memory()

    def forget_factors(self) -> None:
        """Discard the factors after a failed factorization: MUMPS cannot continue with them; `failure` has why."""
        self.failure = self.configuration.failure(self.ksp)
        self._factorized, self._released = -1, -1
        self.options.restore()
        self.ksp.pc.reset()

    @property
    def symmetric_factors(self) -> PETSc.PC | None:
        """Factors L D Lᵀ of an earlier tangent with their inertia, if there are any."""
        pc = self.ksp.pc
        if max(self._factorized, self._released) < 0 or pc.getType() != PETSc.PC.Type.CHOLESKY or not is_mumps(pc):
            return None
        factors = pc.getFactorMatrix()
        has_signs = self.system.comm.size == 1 or factors.getMumpsIcntl(13) == 1
        return pc if has_signs and factors.getMumpsInfog(1) == 0 and factors.getMumpsIcntl(24) == 1 else None

    def sign_of_determinant(self) -> int:
        """Return the sign of the determinant of the factorized tangent; 0 if it is not known."""
        return self.configuration.sign_of_determinant(self.ksp)

    def inertia_mark(self) -> int:
        """Return a number of the factorized tangent that changes with its inertia; 0 if there is none.

        It is 1 more than the number of negative pivots of L D Lᵀ, or the sign of the determinant of L U.
        """
        if (factors := self.symmetric_factors) is not None:
            return 1 + int(factors.getFactorMatrix().getMumpsInfog(12))
        return self.sign_of_determinant()

    def destroy(self) -> None:
        """Free PETSc objects."""
        self.options.remove()
        self.configuration.destroy()
        self.ksp.destroy()
