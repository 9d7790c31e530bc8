"""The discrete equations of a scene, linearised and solved by PETSc's KSP."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import hpcinv.runtime  # noqa: F401  (its import order first)

# isort: split
import numpy as np
from petsc4py import PETSc

from hpcinv.assembly import Assembly
from hpcinv.petsc_options import SolverOptions, Value
from hpcinv.vectors import norm

if TYPE_CHECKING:
    from hpcinv.scene import Scene
    from hpcinv.supports import Supports
    from hpcinv.timings import Timings


class LinearSystem(Assembly):
    """Residual and tangent of a scene, and a linear solver for them, whose symbolic analysis serves the whole run.

    Args:
        scene: residual and load factor.
        supports: Dirichlet conditions on the scene's unknowns.
        options: PETSc options of the job, beside the defaults.
    """

    def __init__(self, scene: Scene, supports: Supports, timings: Timings, options: Mapping[str, Value]) -> None:
        super().__init__(scene, supports, timings)
        with timings("set-up"):
            self.options = SolverOptions(options)
            self.ksp = PETSc.KSP().create(self.comm)
            self.ksp.setOptionsPrefix(SolverOptions.prefix)
            self.ksp.setOperators(self.matrix)
            self.ksp.setFromOptions()

    def position(self) -> PETSc.Vec:
        """A copy of the present state."""
        x: PETSc.Vec = self.state.x.petsc_vec.copy()
        return x

    def linearise(self, load: float) -> None:
        """Assemble the tangent at the present state and a load factor."""
        self.set_load(load)
        self.tangent()

    def solve_linear(self, b: PETSc.Vec, x: PETSc.Vec) -> bool:
        """``x = K⁻¹ b`` with the tangent that was last assembled, factorized if need be; false if that failed."""
        with self.timings("factorization"):
            self.ksp.setOperators(self.matrix)
            self.ksp.setUp()
        with self.timings("linear solve"):
            self.ksp.solve(b, x)
        reason: Any = self.ksp.getConvergedReason()  # an int, whatever its stub says
        solved = bool(reason >= 0 and np.isfinite(norm(x)))
        if not solved:
            self.forget_factors()
        return solved

    def forget_factors(self) -> None:
        """Begin anew after a factorization that failed: MUMPS cannot go on."""
        self.options.restore()
        self.ksp.pc.reset()

    def sign_of_determinant(self) -> int:
        """Of the tangent whose factors are at hand; 0 if the linear solver does not tell."""
        pc = self.ksp.pc
        if pc.getType() != PETSc.PC.Type.LU or pc.getFactorSolverType() != "mumps":
            return 0
        mantissa = pc.getFactorMatrix().getMumpsRinfog(12)
        return (mantissa > 0) - (mantissa < 0)

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
        for part in (self.ksp, self.matrix, self.rhs):
            part.destroy()
