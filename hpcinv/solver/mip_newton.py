"""The stress that the last correction promised, in the geometric part of the tangent of a forward problem.

A correction that is linear in the displacement turns the body along tangents of circles, and so stretches what it
should only turn: a rotation by φ leaves a strain of φ²/2. In a slender body the stress of that strain exceeds the true
one by orders of magnitude; it makes the next tangent far too stiff against bending, and the corrections zigzag. But the
correction from x₀ by c was computed with a stress of its own,

    Ŝ = S(x₀) + ∂S/∂x [c],

which is in equilibrium with the load as far as the linear equations know. Newton's method for displacement and stress
as independent unknowns at each quadrature point, the stress then eliminated, has Ŝ in place of S in the geometric part
∫ Ŝ : (Grad δvᵀ Grad Δu) dV. The residual is not touched, and Ŝ - S vanishes with the square of the correction: neither
the answer nor the order of convergence changes. The matrix stays symmetric where it was.

The pressure ``p = -∂ψ/∂θ`` is such a stress as well where it is none of the unknowns, so that it stands in
``p ∂²θ/∂F²`` by its extrapolated value, too. Where it is an unknown, its own share ``-p F⁻¹ ∂θ/∂F`` of S is
extrapolated in steps that turn more than they stretch: in the others the exact one has proved better.

Source: Magisano, Leonetti & Garcea, Comput. Methods Appl. Mech. Eng. 313, 986–1005, 2017,
doi:10.1016/j.cma.2016.10.023.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import dolfinx.fem.petsc as fem_petsc
import ufl
from dolfinx import fem
from ufl.classes import Zero

from hpcinv.kinematics.staged_derivatives import gradient, without_stages
from hpcinv.parallel.jit import JIT_OPTIONS

if TYPE_CHECKING:
    from petsc4py import PETSc

    from hpcinv.model.scene import Scene
    from hpcinv.model.supports import Supports
    from hpcinv.solver.step_measure import Increment


class ExtrapolatedStress:
    """What it adds to the tangent at the present state of a scene; compiled when it is first wanted.

    Attributes:
        wanted: whether the present solve has it.
    """

    _smallest = 0.1  # rad: smaller rotations leave strains that do not tell
    _turning = 2.0  # times the stretch, from which on a step counts as a rotation

    def __init__(self, scene: Scene, supports: Supports) -> None:
        self._scene, self._supports = scene, supports
        self.wanted = False
        self._is_forward = scene.kinematics.direction == "forward"

    def compile(self) -> None:
        """Compile it, if it may ever be wanted."""
        if self._is_forward:
            assert self.form is not None

    def begin(self, increment: Increment | None) -> None:
        """Take in the first step of a solve, which decides for the whole of it; ``None`` before there is one."""
        self.wanted = self._is_forward and increment is not None and increment.turn > self._smallest
        if self.wanted and increment is not None:
            self._of_pressure.value = float(increment.turn > self._turning * increment.stretch)

    def add_to(self, matrix: PETSc.Mat, before: PETSc.Vec) -> None:
        """Add it to the tangent; ``before`` is the state from which a linear step has led to the present one."""
        before.copy(self._before.x.petsc_vec)
        self._before.x.scatter_forward()
        self._step.x.array[:] = self._scene.unknowns.state.x.array - self._before.x.array
        fem_petsc.assemble_matrix(matrix, self.form, bcs=self._supports.conditions)
        matrix.assemble()

    @cached_property
    def _before(self) -> fem.Function:
        return fem.Function(self._scene.unknowns.space)

    @cached_property
    def _step(self) -> fem.Function:
        return fem.Function(self._scene.unknowns.space)

    @cached_property
    def _of_pressure(self) -> fem.Constant:
        return fem.Constant(self._scene.unknowns.mesh, 0.0)

    @cached_property
    def form(self) -> fem.Form:
        scene, kin = self._scene, self._scene.kinematics
        unknowns = scene.unknowns
        trial = ufl.TrialFunction(unknowns.space)
        gradients = kin.Grad(unknowns.v), kin.Grad(trial if unknowns.p is None else ufl.split(trial)[0])
        metric = ufl.sym(gradients[0].T * gradients[1])
        total: Any = 0
        for number, part in enumerate(scene.parts):
            S = without_stages(kin.F_inverse * part.P)
            slope, p = without_stages(gradient(part.dilatation, scene.H)), without_stages(part.pressure)
            of_pressure = -p * kin.F_inverse * slope
            work = ufl.inner(self._excess(S - of_pressure), metric)
            if unknowns.p is None:
                curvature = ufl.derivative(ufl.inner(slope, gradients[0]), unknowns.state, trial)
                work -= self._excess(p) * curvature
            else:
                work += self._of_pressure * ufl.inner(self._excess(of_pressure), metric)
            total += kin.dV(work, kin.integration.part(number))
        return fem.form(total, jit_options=JIT_OPTIONS)

    def _excess(self, stress: Any) -> Any:
        """The extrapolated value of something that depends on the state, less the present one."""
        if isinstance(stress, Zero):
            return stress
        there = ufl.replace(stress, {self._scene.unknowns.state: self._before})
        return there + ufl.derivative(there, self._before, self._step) - stress
