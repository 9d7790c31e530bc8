"""The scene: virtual work of one body under its material law and the effects that the job lists, in either direction.

Equilibrium is stated once, on the reference body,

    ∫ P : Grad δu dV  =  λ Σ external virtual work,            P = ∂ψ/∂F,

and, where the law is nearly or fully incompressible, with the pressure as an unknown of its own,

    ψ = W(F) - p θ(J) - p²/2Λ,      ∫ (θ(J) + p/Λ) δp dV = 0,

where ``U = Λ/2 θ²`` is the law's volumetric energy (``Λ → ∞`` drops the last term). `Kinematics` carries this to the
mesh, so that the inverse problem is the exact discrete inverse of the forward one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import hpcinv.runtime  # noqa: F401  (its import order first)

# isort: split
import ufl
from ufl.classes import Label, Variable

from hpcinv.kinematics import Deformation, Kinematics
from hpcinv.parameters import Parameters

if TYPE_CHECKING:
    from hpcinv.effects.base import Effect
    from hpcinv.materials.base import MaterialLaw
    from hpcinv.scales import Scales
    from hpcinv.unknowns import Unknowns


class Scene:
    """Material, effects and kinematics composed into one residual.

    Attributes:
        residual: UFL form, linear in the test functions of ``unknowns``.
        parameters: the load factor ``λ`` and the parameters of law and effects.
        strain_energy: UFL form of the energy stored in the body (scaled stress × length³).
        J: volume ratio; mesh_J: the determinant that must stay positive at every point.
        cauchy_stress: ``σ = J⁻¹ P Fᵀ`` in scaled stresses, (3, 3).
    """

    def __init__(
        self,
        unknowns: Unknowns,
        material: MaterialLaw,
        effects: Sequence[Effect],
        kinematics: type[Kinematics],
        quadrature_degree: int,
        scales: Scales,
    ) -> None:
        self.unknowns = unknowns
        self.kinematics = kinematics(unknowns.u, ufl.dx(unknowns.mesh, degree=quadrature_degree))
        self.quadrature_degree = quadrature_degree
        modulus = material.dilatation_modulus
        is_finite = math.isfinite(modulus)
        further = {"dilatation_modulus": modulus / scales.stress} if is_finite else {}
        self.parameters = parameters = Parameters([material, *effects], further, unknowns.mesh, scales)

        kin, par = self.kinematics, parameters.of(0)
        # A label of our own: UFL's running number would make the kernels of each scene's expressions new ones.
        H = Variable(kin.H, Label(0))
        deformation = Deformation(H)
        distortion = material.distortion(deformation, par)
        dilatation = material.dilatation(deformation)
        finite_modulus = parameters.further("dilatation_modulus") if is_finite else None
        if unknowns.p is None:
            psi = energy = distortion + finite_modulus * dilatation**2 / 2
        else:
            psi = distortion - unknowns.p * dilatation
            energy = distortion if finite_modulus is None else distortion + unknowns.p**2 / (2 * finite_modulus)
        P = ufl.diff(psi, H)

        residual = kin.dV(ufl.inner(P, kin.Grad(unknowns.v)))
        if unknowns.p is not None:
            constraint = dilatation if finite_modulus is None else dilatation + unknowns.p / finite_modulus
            residual -= kin.dV(constraint * unknowns.q)
        for number, effect in enumerate(effects, start=1):
            residual -= effect.virtual_work(kin, unknowns.v, parameters.load, parameters.of(number))

        self.residual = residual
        self.strain_energy = kin.dV(energy)
        self.J = deformation.J
        self.mesh_J = kin.mesh_J
        self.cauchy_stress = P * deformation.F.T / deformation.J
