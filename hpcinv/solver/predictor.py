"""Prediction of solutions along the tangent of their path, measured by the rotations and strains that it makes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hpcinv.parallel.petsc_vectors import norm
from hpcinv.solver.step_measure import Increment, Increments

if TYPE_CHECKING:
    from petsc4py import PETSc

    from hpcinv.assembly.system import System
    from hpcinv.solver.linear_solver import LinearSolver

UNBOUNDED = Increment(np.inf, np.inf)


@dataclass(frozen=True)
class Prediction:
    """A step along the tangent of the path.

    Attributes:
        length: of the step.
        increment: largest rotation and strain that it makes.
        origin: the state where it begins; it holds until the next prediction.
        is_taken: whether the state was moved along it; not if an element would turn inside out.
        factorizations, signs: new tangents that it took, and signs of their determinants.
    """

    length: float
    increment: Increment
    origin: PETSc.Vec
    is_taken: bool
    factorizations: int = 0
    signs: tuple[int, ...] = ()

    def after(self, first: Prediction) -> Prediction:
        """This prediction, with the effort of the one that it replaces."""
        factorizations = first.factorizations + self.factorizations
        return replace(self, factorizations=factorizations, signs=first.signs + self.signs)


class Predictor:
    """The tangent of the path of solutions of a system."""

    def __init__(self, system: System, linear: LinearSolver) -> None:
        self.system, self.linear = system, linear
        with system.timings("compile"):
            self.increments = Increments(system.scene)
        self._origin = system.rhs.duplicate()

    def predict(self, load: float, *, new_tangent: bool = False) -> Prediction:
        """Move the state along the tangent of the solution path to another load factor.

        A step that would turn an element inside out is not taken.

        Args:
            new_tangent: assemble and factorize it; else the factors at hand are used.
        """
        system, linear = self.system, self.linear
        start, factorizations = self._origin, 0
        system.state.x.petsc_vec.copy(start)
        while True:
            system.set_load(load)
            if new_tangent:
                system.tangent()
                factorizations += 1
            system.residual(system.rhs)
            x = system.rhs.duplicate()
            linear.factorize()
            linear.limit_iterations()
            with system.timings("linear solve"):
                solved = linear.back_substitute(system.rhs, x)
            if solved or not linear.fall_back():
                break
            x.destroy()
        sign = linear.sign_of_determinant() if solved and new_tangent else 0
        if not solved:
            linear.forget_factors()
        length, increment = norm(x), self.increments(x) if solved else UNBOUNDED
        x.aypx(-1.0, start)
        system.set_state(x)
        x.destroy()
        is_taken = solved and system.fault() is None
        if not is_taken:
            system.set_state(start)
        return Prediction(length, increment, start, is_taken, factorizations, (sign,) if sign else ())

    def destroy(self) -> None:
        """Free what PETSc holds."""
        self._origin.destroy()
