"""The discrete equations of a scene, linearised and solved by PETSc's KSP."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import hpcinv.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
import numpy as np
from petsc4py import PETSc

from hpcinv.assembly.system import Assembly
from hpcinv.parallel.malloc import give_back_memory
from hpcinv.parallel.petsc_vectors import norm
from hpcinv.solver.linear.direct import Direct
from hpcinv.solver.linear.iterative import Iterative
from hpcinv.solver.linear.selection import Choice, Used
from hpcinv.solver.petsc_options import SolverOptions, Value

if TYPE_CHECKING:
    from hpcinv.model.scene import Scene
    from hpcinv.model.supports import Supports
    from hpcinv.parallel.timings import Timings
    from hpcinv.solver.linear.configuration import Preset


class LinearSystem(Assembly):
    """Residual and tangent of a scene, and a linear solver for them, whose symbolic analysis serves the whole run.

    Args:
        scene: residual and load factor.
        supports: Dirichlet conditions on the scene's unknowns.
        options: PETSc options of the job, beside those of the preset.
        choice: preset of the linear solver, and whether the other one may be tried where it fails.

    Attributes:
        fallback: why the other preset was taken, if it was.
    """

    def __init__(
        self, scene: Scene, supports: Supports, timings: Timings, options: Mapping[str, Value], choice: Choice
    ) -> None:
        super().__init__(scene, supports, timings)
        self.choice = choice
        self.fallback: str | None = None
        self._iterations = 0
        with timings("set-up"):
            self.options = SolverOptions(options)
            self.ksp = PETSc.KSP().create(self.comm)
            self.ksp.setOptionsPrefix(SolverOptions.prefix)
            self.preset = self._use(choice.preset)

    def _use(self, name: str) -> Preset:
        own = self.choice.is_own
        preset: Preset = Direct(symmetric=not own) if name == "direct" else Iterative(self.scene)
        self._is_factorized = False
        self.options.use(preset.options)
        self.ksp.reset()
        self.ksp.setOperators(self.matrix)
        self.ksp.setFromOptions()
        return preset

    def position(self) -> PETSc.Vec:
        """A copy of the present state."""
        x: PETSc.Vec = self.state.x.petsc_vec.copy()
        return x

    @property
    def used(self) -> Used:
        """Which linear solver it is by now, and why."""
        return Used(self.preset.name, self.choice.why, self.fallback, self.note)

    def linearise(self, load: float) -> None:
        """Assemble the tangent at the present state and a load factor."""
        self.set_load(load)
        self.tangent()

    def tangent(self) -> None:
        super().tangent()
        self._is_factorized = False

    def factorize(self) -> None:
        """Factorize the tangent that was last assembled, or make its preconditioner, unless that is done already."""
        if self._is_factorized:
            return
        with self.timings("factorization"):
            self.ksp.setOperators(self.matrix)
            self.preset.prepare(self.ksp, self.matrix)
            self.ksp.setUp()
            if self.preset.distrusts(self.ksp):
                self.ksp.setUp()
            self.ksp.setUpOnBlocks()
        self._is_factorized = True

    def solve_linear(self, b: PETSc.Vec, x: PETSc.Vec) -> bool:
        """``x = K⁻¹ b`` with the tangent that was last assembled, factorized if need be; false if that failed."""
        self.factorize()
        self.preset.aim(precise=True)
        self.preset.allow(self.choice.budget)
        with self.timings("linear solve"):
            solved = self.back_substitute(b, x)
        self.preset.aim(precise=False)
        if solved:
            return True
        if self.fall_back():
            return self.solve_linear(b, x)
        self.forget_factors()
        return False

    def back_substitute(self, b: PETSc.Vec, x: PETSc.Vec) -> bool:
        """``x = K⁻¹ b`` with the factors or the preconditioner at hand; false if that failed."""
        self.ksp.solve(b, x)
        self.count_iterations(self.ksp.getIterationNumber())
        reason: Any = self.ksp.getConvergedReason()  # an int, whatever its stub says
        return reason >= 0 and bool(np.isfinite(norm(x)))

    def count_iterations(self, number: int) -> None:
        """Take note of what a linear solve took."""
        if not self.preset.exact:
            self._iterations += number

    def counted_iterations(self) -> int:
        """Krylov iterations since this was asked last."""
        number, self._iterations = self._iterations, 0
        return number

    def fall_back(self) -> bool:
        """Go over to the other preset after a failure, if that may help."""
        if self.fallback is not None or self.choice.other is None:
            return False
        if self.preset.exact and not self.preset.lacked_memory(self.ksp):
            return False  # a singular tangent stays singular
        what = "did not converge" if not self.preset.exact else "ran out of memory"
        self.fallback = f"the {self.preset.name} solver {what}: {self.choice.other} from there on"
        self.preset.destroy()
        self.preset = self._use(self.choice.other)
        self.ksp.setConvergenceTest(None)  # drops that of the preset before
        return True

    def rest(self) -> None:
        """Keep what is worth it until the equations are used again: a symbolic factorization, but not multigrid."""
        if not self.preset.exact:
            self.ksp.reset()
            self._is_factorized = False
            give_back_memory()

    def forget_factors(self) -> None:
        """Begin anew after a factorization that failed: MUMPS cannot go on."""
        self._is_factorized = False
        self.options.restore()
        self.ksp.pc.reset()

    def sign_of_determinant(self) -> int:
        """Of the tangent whose factors are at hand; 0 if the linear solver does not tell."""
        return self.preset.sign_of_determinant(self.ksp)

    def correct(self, load: float) -> None:
        """Add one full Newton correction to the present state, whatever it does to the elements."""
        start, step = self.position(), self.rhs.duplicate()
        self.linearise(load)
        self.residual(self.rhs)
        self.solve_linear(self.rhs, step)
        step.aypx(-1.0, start)
        self.set_state(step)
        start.destroy()
        step.destroy()

    def destroy(self) -> None:
        """Free what PETSc holds."""
        self.options.remove()
        self.preset.destroy()
        for part in (self.ksp, self.matrix, self.rhs):
            part.destroy()
