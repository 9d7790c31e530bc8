"""Confirmation of negative eigenvalues of a forward tangent as instabilities of the body.

The mixed tangent is positive or not on the *discrete* kernel of the volume constraint: displacements whose change of
volume vanishes on average against each discrete pressure, but not at each point. On such a displacement the pressure's
term ``-∫ p D²θ[v, v] dV`` can be negative where it could not be for a displacement of the continuous body, so that
Taylor–Hood elements, hexahedra above all, have spurious negative eigenvalues at finite strain (Auricchio, Beirão da
Veiga, Lovadina & Reali, Comput. Methods Appl. Mech. Eng. 194, 1075–1092, 2005, doi:10.1016/j.cma.2004.06.014;
ibid. 199, 314–323, 2010, doi:10.1016/j.cma.2008.06.004).

They vanish in the same spaces once the part of the change of volume that is orthogonal to the discrete pressures
costs energy too. With ``Π`` the projection on the discrete pressures, ``Λ`` the stiffness against ``θ``, and constant
``p``,

    a(v, v) = D²[W - pθ](v, v) + Λ ‖Π θ'[v]‖² + α ‖(1 - Π) θ'[v]‖² - loads,      α = min(10 (μ + |τ| + |p|), Λ),

where ``τ`` is the Kirchhoff stress: for the continuous body the second variation of its energy if ``α = Λ``, and equal
to it in every direction that keeps the volume if ``Λ`` is infinite. In the displacement form nothing needs to be added.

A negative eigenvalue counts if it stays negative with a margin: when 1 % of the linear elastic energy of the direction,
``2μ ‖sym grad v‖²`` with the gradient in the loaded body, is added. The quadrature is of higher degree than the
solve.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import dolfinx.fem.petsc as fem_petsc
import ufl
from dolfinx import fem
from petsc4py import PETSc

from hpcinv.mesh.source import Floats
from hpcinv.model.discrete_model import default_quadrature
from hpcinv.model.weak_form import Part, WeakForm
from hpcinv.on_demand import on_demand
from hpcinv.physics.kinematics.staged_derivatives import gradient, remove_stages
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.trust.stability.forward_factors import given_u_of
from hpcinv.trust.stability.inertia import inertia

MARGIN = 0.01
"""Share of the linear elastic energy of a direction that is added before it counts as unstable."""
PENALTY = 10.0  # other values: docs/theory/stability.md
_OVERLAP = 0.01  # share of α that stays in Λ too: what is left of Λ stays positive definite


def second_variation(equations: Equations, given_u: fem.Function | None) -> fem.Form:
    """Return the form whose negative eigenvalues, less one for each pressure, are confirmed instabilities; collective.

    Args:
        equations: its mesh must be the reference body, and its state the solution, when the form is assembled.
        given_u: as in `WeakForm`.
    """
    spaces = equations.job.discretisation
    degree = max(equations.quadrature_degree, default_quadrature(equations.body.source.kind, spaces.displacement)) + 2
    weak_form = equations.weak_form("forward", given_u, degree)
    unknowns, parts = weak_form.unknowns, weak_form.kinematics.integration.part
    trial = ufl.TrialFunction(unknowns.space)
    with equations.timings("programs"):
        form = ufl.derivative(weak_form.residual, unknowns.state, trial)
        for number, part in enumerate(weak_form.parts):
            form += weak_form.kinematics.dV(_added(weak_form, part, trial), parts(number))
        return fem.form(form)


@dataclass(frozen=True)
class Confirmed:
    """Number of confirmed unstable directions; ``asymmetry`` as in `Inertia`."""

    directions: int
    asymmetry: float


@contextmanager
def assembled(equations: Equations, solution: Solution) -> Iterator[PETSc.Mat]:
    """Context with the matrix of `second_variation`; the equations have the solution's mesh and state in it."""
    equations.put(solution.moved_to(solution.reference_nodes))
    form = second_variation(equations, given_u_of(equations))
    with equations.timings("tangent"):
        matrix = fem_petsc.assemble_matrix(form, bcs=equations.supports.conditions)
        matrix.assemble()
        if equations.supports.sliding is not None:
            constraint = on_demand("constraints of slides")(matrix, equations.supports.sliding)
            constraint.apply(_forces(equations) if equations.supports.is_curved else None)
            constraint.destroy()
    try:
        yield matrix
    finally:
        matrix.destroy()


def _forces(equations: Equations) -> Floats:
    """Return nodal forces of the owned unknowns in the present state; collective."""
    equilibrium = equations.equilibrium(equations.weak_form("forward", given_u_of(equations)))
    forces = equilibrium.system.forces(1.0)
    equations.release(equilibrium)
    return forces


def confirm(equations: Equations, solution: Solution) -> Confirmed | None:
    """Count the unstable directions of a solution; ``None`` if the form cannot be factorized; collective."""
    with assembled(equations, solution) as matrix, equations.timings("factorization"):
        counts = inertia(matrix)
    pressures = equations.unknowns.pressure_size
    if counts is None or counts.negative + counts.zero < pressures:
        return None
    return Confirmed(max(counts.negative - pressures, 0), counts.asymmetry)


def potential_note(asymmetry: float) -> str:
    """Return text for a note on an asymmetry of the tangent (as in `Inertia`); empty where loads have a potential."""
    return (
        ""
        if asymmetry < 1e-8
        else f"loads without a potential (asymmetry {asymmetry:.1g}): only the symmetric part was checked"
    )


def _added(weak_form: WeakForm, part: Part, trial: Any) -> Any:
    """Return the terms that `second_variation` adds to the tangent, per reference volume."""
    kin, unknowns = weak_form.kinematics, weak_form.unknowns
    mu, volume = part.shear_modulus, remove_stages(ufl.as_ufl(part.inelastic_volume))
    w, dp = (trial, None) if unknowns.p is None else ufl.split(trial)
    strains = [ufl.sym(kin.Grad(field) * kin.F_inverse) for field in (unknowns.v, w)]
    margin = MARGIN * 2 * mu * ufl.inner(*strains)
    if unknowns.p is None:
        return margin
    slope = remove_stages(gradient(part.dilatation, weak_form.H))
    tau = remove_stages(part.P) * (ufl.Identity(3) + kin.H).T
    alpha = PENALTY * (mu + ufl.sqrt(ufl.inner(tau, tau)) + abs(unknowns.p))
    compliance: Any = 0
    if (modulus := part.volumetric_modulus) is not None:
        alpha = ufl.min_value(alpha, modulus)
        # The pressures are left with Λ - α, as 1/(Λ - α) instead of the 1/Λ that the tangent has.
        compliance = 1 / (modulus - (1 - _OVERLAP) * alpha) - 1 / modulus
    volumes = ufl.inner(slope, kin.Grad(unknowns.v)) * ufl.inner(slope, kin.Grad(w))
    return margin + volume * (alpha * volumes - compliance * dp * unknowns.q)
