"""Mixed-integration-point (MIP) Newton: extrapolated stress in the geometric tangent of a forward problem.

A correction is linear in the displacement, and moves points along the tangents of circles: where it should rotate the
body by φ, it also strains it by φ²/2. In a slender body the stress of that strain exceeds the true one by orders of
magnitude; it makes the next tangent far too stiff against bending, and the corrections oscillate. The linear equations
for the correction c at x₀, however, contain the extrapolated stress

    Ŝ = S(x₀) + ∂S/∂x [c],

which is in equilibrium with the load to first order. Newton's method for displacement and stress
as independent unknowns at each quadrature point, the stress then eliminated, has Ŝ instead of S in the geometric part
∫ Ŝ : (Grad δvᵀ Grad Δu) dV. The residual is the same, and Ŝ - S vanishes with the square of the correction: neither
the solution nor the order of convergence changes. A symmetric matrix stays symmetric.

Where the pressure ``p = -∂ψ/∂θ`` is not an unknown, it is such a stress as well, and its extrapolated value replaces it
in ``p ∂²θ/∂F²``. Where it is an unknown, its share ``-p F⁻¹ ∂θ/∂F`` of S is extrapolated in steps with more rotation
than strain; in the others the exact share has proved better.

Source: Magisano, Leonetti & Garcea, Comput. Methods Appl. Mech. Eng. 313, 986–1005, 2017,
doi:10.1016/j.cma.2016.10.023.
"""

from functools import cached_property
from typing import Any

import ufl
from dolfinx import fem
from petsc4py import PETSc
from ufl.classes import Zero

from hpcinv.model.assembly.system import System
from hpcinv.model.assembly.tangent_moduli import Term
from hpcinv.physics.kinematics.staged_derivatives import gradient, remove_stages
from hpcinv.solver.predictor import Increment


class ExtrapolatedStress:
    """Additional term of the tangent at the present state of a system; made at its first use."""

    _smallest = 0.1  # rad: the spurious strain of smaller rotations is negligible
    _rotation_to_strain = 2.0  # ratio above which the pressure's share is extrapolated

    def __init__(self, system: System) -> None:
        self._system, self._weak_form = system, system.weak_form
        self._is_forward = self._weak_form.kinematics.direction == "forward"

    def is_needed(self, first: Increment) -> bool:
        """Return whether the tangents of a solve need the term, by the first step of that solve."""
        return self._is_forward and first.rotation > self._smallest

    def extrapolation(self, start: PETSc.Vec, first: Increment) -> Any:
        """Return the term, for ``System.tangent``.

        Args:
            start: the state from which a linear step has led to the present one.
            first: increment of the first step of the solve.
        """
        term = self._term
        self._pressure_share.value = float(first.rotation > self._rotation_to_strain * first.strain)
        start.copy(self._start.x.petsc_vec)
        self._start.x.scatter_forward()
        self._step.x.array[:] = self._weak_form.unknowns.state.x.array - self._start.x.array
        return term

    @cached_property
    def _term(self) -> Any:
        weak_form, kin = self._weak_form, self._weak_form.kinematics
        unknowns = weak_form.unknowns
        self._start, self._step = fem.Function(unknowns.space), fem.Function(unknowns.space)
        self._pressure_share = fem.Constant(unknowns.mesh, 0.0)
        trial = ufl.TrialFunction(unknowns.space)
        gradients = kin.Grad(unknowns.v), kin.Grad(trial if unknowns.p is None else ufl.split(trial)[0])
        metric = ufl.sym(gradients[0].T * gradients[1])
        total: Any = 0
        excesses: dict[Any, Any] = {}

        def excess(stress: Any) -> Any:
            """Return a symbol for the extrapolated value of an expression of the state, less its present value."""
            if isinstance(stress, Zero):
                return stress
            there = ufl.replace(stress, {unknowns.state: self._start})
            symbol = ufl.Constant(unknowns.mesh, stress.ufl_shape)
            excesses[symbol] = there + ufl.derivative(there, self._start, self._step) - stress
            return symbol

        for number, part in enumerate(weak_form.parts):
            S = remove_stages(kin.F_inverse * part.P)
            slope, p = remove_stages(gradient(part.dilatation, weak_form.H)), remove_stages(part.pressure)
            pressure_stress = -p * kin.F_inverse * slope
            work = ufl.inner(excess(S - pressure_stress), metric)
            if unknowns.p is None:
                curvature = ufl.derivative(ufl.inner(slope, gradients[0]), unknowns.state, trial)
                work -= excess(p) * curvature
            else:
                work += self._pressure_share * ufl.inner(excess(pressure_stress), metric)
            total += kin.dV(work, kin.integration.part(number))
        return self._system.term(Term(total, trial, excesses))
