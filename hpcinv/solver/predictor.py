"""Prediction of solutions along the tangent of their path, and the rotations and strains of such steps."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from hpcinv.base.parallel.petsc_vectors import norm
from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh.source import Floats
from hpcinv.model.assembly.system import System
from hpcinv.model.quadrature_values import QuadratureValues
from hpcinv.model.weak_form import WeakForm
from hpcinv.solver.bordered_solver import BorderedSolver
from hpcinv.solver.linear_solver import LinearSolver


@dataclass(frozen=True)
class Increment:
    """Largest rotation (rad) and strain (norm) of a step at any point, to first order."""

    rotation: float
    strain: float


class Increments:
    """Rotation and strain of steps from the present state.

    With ``F`` the gradient of the map from the mesh to the other body, ``δF F⁻¹ = d + w``: the strain ``d = dᵀ`` and
    the spin ``w = -wᵀ`` of that body. The residual does not measure a step: its stiffest parts dominate it.
    """

    def __init__(self, weak_form: WeakForm) -> None:
        unknowns, kin = weak_form.unknowns, weak_form.kinematics
        self._comm = unknowns.mesh.comm
        self._step = fem.Function(unknowns.space)
        step = self._step if unknowns.p is None else ufl.split(self._step)[0]
        rate = kin.sign * ufl.grad(step) * ufl.inv(ufl.Identity(3) + kin.sign * ufl.grad(unknowns.u))
        w, d = ufl.skew(rate), ufl.sym(rate)
        squares = ufl.as_vector([ufl.inner(w, w) / 2, ufl.inner(d, d)])
        self._squares = QuadratureValues(squares, unknowns.mesh, weak_form.quadrature_degree)

    def __call__(self, step: PETSc.Vec) -> Increment:
        """Increment of a step in all unknowns, added or subtracted; collective."""
        step.copy(self._step.x.petsc_vec)
        self._step.x.scatter_forward()
        largest = np.zeros(2)
        for _, values in self._squares:
            largest = np.maximum(largest, values.reshape(-1, 2).max(axis=0, initial=0.0))
        self._comm.Allreduce(MPI.IN_PLACE, largest, op=MPI.MAX)
        rotation, strain = np.sqrt(largest)
        return Increment(float(rotation), float(strain))


UNBOUNDED = Increment(np.inf, np.inf)


@dataclass(frozen=True)
class Prediction:
    """A step along the tangent of the path.

    Attributes:
        increment: largest rotation and strain that it makes.
        origin: the state where it begins; overwritten by the next prediction.
        numbers: the unknown numbers where it begins.
        is_taken: whether the state was moved along it.
        factorizations: number of new tangents.
        signs: signs of the determinants of the new tangents.
    """

    length: float
    increment: Increment
    origin: PETSc.Vec
    is_taken: bool
    factorizations: int = 0
    signs: tuple[int, ...] = ()
    numbers: Any = ((), 0.0)

    def including(self, first: Prediction) -> Prediction:
        """Return this prediction with the effort of the replaced one added."""
        factorizations = first.factorizations + self.factorizations
        return replace(self, factorizations=factorizations, signs=first.signs + self.signs)


class Predictor:
    """The tangent of the path of solutions of a system."""

    def __init__(self, system: System, linear: LinearSolver) -> None:
        self.system, self.linear = system, linear
        with system.timings("programs"):
            self.increments = Increments(system.weak_form)
        self._origin = system.rhs.duplicate()

    def predict(self, load: float, numbers: BorderedSolver, *, new_tangent: bool = False) -> Prediction:
        """Move the state and its numbers along the tangent of the solution path to another load factor.

        A step that would turn an element inside out, or carry it through an obstacle, is not taken.

        Args:
            new_tangent: assemble and factorize the tangent; else the present factors are used.
        """
        system, linear = self.system, self.linear
        start, count_before, kept_numbers = self._origin, linear.factorizations, numbers.kept_numbers()
        system.state.x.petsc_vec.copy(start)
        while True:
            numbers.put(load)
            if new_tangent:
                system.tangent()
            x, change = system.rhs.duplicate(), None
            if not new_tangent or numbers.set_columns(load, may_fall_back=False):
                system.residual(system.rhs)
                linear.factorize()
                linear.limit_iterations()
                with system.timings("linear solve"):
                    change = self._change(load, numbers, x)
            if change is not None or not linear.fall_back():
                break
            x.destroy()
        sign = linear.sign_of_determinant() * numbers.sign if change is not None and new_tangent else 0
        if change is None:
            linear.forget_factors()
        length, increment = norm(x), self.increments(x) if change is not None else UNBOUNDED
        x.aypx(-1.0, start)
        system.set_state(x)
        x.destroy()
        if change is not None:
            numbers.change(change)
            numbers.put(load)
        is_taken = change is not None and system.fault() is None and not system.weak_form.passages.has_passed()
        if not is_taken:
            system.set_state(start)
            numbers.restore(kept_numbers)
        factorizations = linear.factorizations - count_before
        return Prediction(length, increment, start, is_taken, factorizations, (sign,) if sign else (), kept_numbers)

    def _change(self, load: float, numbers: BorderedSolver, x: PETSc.Vec) -> Floats | None:
        """Set ``x`` to the correction, and return the change of the numbers; ``None`` if they cannot be solved for."""
        if not self.linear.back_substitute(self.system.rhs, x):
            return None
        try:
            return numbers.complete(numbers.equations(load), x)
        except np.linalg.LinAlgError:
            return None

    def destroy(self) -> None:
        self._origin.destroy()
