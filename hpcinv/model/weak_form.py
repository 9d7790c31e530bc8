"""The weak form of equilibrium of one body under the material laws and effects of a job, in either direction.

Equilibrium is stated once, on the reference body,

    ∫ P : Grad δu dV  =  Σ external virtual work,            P = ∂ψ/∂F,

and, for nearly or fully incompressible laws, with the pressure as an additional unknown,

    ψ = W(F) - p θ(F) - p²/2Λ,      ∫ (θ(F) + p/Λ) δp dV = 0,

where ``U = Λ/2 θ²`` is the law's volumetric energy (``Λ → ∞`` drops the last term). With effects
that strain the body without stress, the law depends on the elastic part of the deformation, ``F_e = F F_g⁻¹`` and
``ψ = J_g ψ(F_e)``. `Kinematics` transforms this to the mesh, so that the inverse problem is the exact discrete inverse
of the forward one.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from ufl.classes import Label, Variable

from hpcinv.base.quantity.component import Ingredient
from hpcinv.base.quantity.nondimensional import Scales
from hpcinv.job.job import Job
from hpcinv.mesh.kind_source import source_of
from hpcinv.model.cell_means import PartExpressions, StateMeans
from hpcinv.model.constraint_integral import ConstraintIntegral
from hpcinv.model.contacts import Contacts, Passages, paired_obstacles
from hpcinv.model.external_work import constraint_forms, external_work
from hpcinv.model.field_checks import shear_modulus
from hpcinv.model.fields import BodyFields, law_cells
from hpcinv.model.measures import Integration
from hpcinv.model.nominal_displacement import NominalDisplacement
from hpcinv.model.parameters import ParameterDerivative, Parameters
from hpcinv.model.spaces import Unknowns
from hpcinv.on_demand import on_demand
from hpcinv.physics.effects import Effect
from hpcinv.physics.kinematics.kinematics import Deformation, Kinematics, OtherState
from hpcinv.physics.kinematics.staged_derivatives import gradient, remove_stages
from hpcinv.physics.materials import MaterialLaw
from hpcinv.physics.points.kernels import noted

LABEL = Label(1_000_001)
"""Label of ``H``, the variable of the laws' derivatives; fixed and large as the kinematics'."""


@dataclass(frozen=True)
class Part:
    """Scaled energy and stress of one law, as UFL expressions.

    Attributes:
        cells: cells of the law, ``None`` for all.
        constraint: residual of the pressure, ``None`` if it is not an unknown.
        domain: scalars that are positive where the law is defined.
        fixed_volume: elastic volume ratio if the law is incompressible, else ``None``.
        pressure: -∂ψ/∂θ per reference volume, an unknown or not.
        dilatation: volumetric strain θ.
        shear_modulus: μ of the undeformed material.
        volumetric_modulus: Λ, ``None`` if it is infinite.
        inelastic_volume: J_g.
    """

    cells: npt.NDArray[np.int32] | None
    energy: Any
    P: Any
    constraint: Any
    domain: tuple[Any, ...]
    fixed_volume: Any
    pressure: Any
    dilatation: Any
    shear_modulus: Any
    volumetric_modulus: Any
    inelastic_volume: Any

    @property
    def compliance(self) -> Any:
        """``1/μ + 1/Λ`` of the undeformed material."""
        return 1 / self.shear_modulus + (0 if self.volumetric_modulus is None else 1 / self.volumetric_modulus)


class WeakForm:
    """Virtual work of materials, effects and kinematics, as one residual.

    Args:
        given_u: fixed displacement (scaled) of the state in which fibres, strains, fields and densities are given on
            the current body; by default they are given in the state that is solved for.

    Attributes:
        residual: UFL form, linear in the test functions of ``unknowns``.
        J: volume ratio; mesh_J: the determinant that must be positive at every point.
        H: displacement gradient, the variable of all expressions in `parts`.
        constraints: integrals that unknown numbers of effects make zero, by the places of the effects.
        derived: further forms with their programs, which are kept as long as this one.

    Raises:
        MeshError: on all ranks, if the mesh lacks a region or an array that the job names.
    """

    def __init__(
        self,
        job: Job,
        fields: BodyFields,
        unknowns: Unknowns,
        kinematics: type[Kinematics],
        quadrature_degree: int,
        scales: Scales,
        given_u: fem.Function | None = None,
    ) -> None:
        self.unknowns = unknowns
        self.derived: dict[str, Any] = {}
        self.quadrature_degree = quadrature_degree
        cells = law_cells(fields.body, job.laws)
        integration = Integration(fields.body, quadrature_degree, cells)
        self.kinematics = kin = kinematics(unknowns.u, integration)
        if given_u is not None:
            kin.data_state = OtherState(kin, given_u)
        may_grow = kin.sign > 0 and any(effect.presses_at_any_load for effect in job.effects)
        self.parameters = par = Parameters(_ingredients(job), kin, fields, scales, job.case_count, may_grow=may_grow)
        count = len(job.laws)
        effect_data = _effect_data(job, fields, par)
        named = tuple(zip((where for where, _ in job.named_effects), effect_data, strict=True))
        self.contacts = _contacts(job, named, fields, unknowns, kin, scales)
        directions = _directions(job, kin, par, count + len(effect_data))
        self.H = H = Variable(kin.H, LABEL)
        source = fields.body.source
        is_one_layer = source_of(source.body_kind).corrects_shear(source, job.discretisation.displacement)
        total = Deformation(on_demand("shear of one layer")(H, kin) if is_one_layer else H, directions)
        strains = [*_strains(effect_data, total, kin.data_state)]
        elastic, J_g = _elastic(total, [strain for _, strain in strains])
        self._own = own = [strain for effect, strain in strains if effect.writes_its_stress]
        self._reference_elastic = _elastic(Deformation(ufl.zero(3, 3), directions), own)[0] if own else None
        self._laws = tuple(job.laws.values())
        potentials = [*_potentials(named, total)]
        self.parts = tuple(
            _part(law, par.quantities(i), elastic, J_g, potentials, unknowns.p, H, own_cells)
            for i, (law, own_cells) in enumerate(zip(job.laws.values(), cells or (None,) * count, strict=True))
        )
        for (where, law), part in zip(job.laws.items(), self.parts, strict=True):
            noted(where, law.isochoric_energy, part.energy)
        self._strains, self._potentials = [strain for _, strain in strains], potentials
        self._works = [*_works(named, kin, unknowns.v)]
        constraints = constraint_forms(named, kin, unknowns.u)
        self.constraints = {place: ConstraintIntegral(form, unknowns, par) for place, form in constraints}
        self.residual = self._residual()
        self.J = Deformation(H).J if is_one_layer else total.J
        self.mesh_J = kin.mesh_J

    def _residual(self) -> Any:
        kin, unknowns, residual = self.kinematics, self.unknowns, 0
        for number, part in enumerate(self.parts):
            dx = kin.integration.part(number)
            residual += kin.dV(ufl.inner(part.P, kin.Grad(unknowns.v)), dx)
            if part.constraint is not None:
                residual -= kin.dV(part.constraint * unknowns.q, dx)
        for work in self._works:
            residual -= work
        return residual

    def update_parameters(self, job: Job, scales: Scales) -> None:
        """Set the numbers of another job of the same reuse group."""
        self.parameters.update_parameters(_ingredients(job), scales)
        self.contacts.update_parameters(job.effects, _modulus(job, self.parameters.fields, scales), scales)

    def begin_line(self, job: Job) -> None:
        """Let the load factor lead from the numbers of another job of the same reuse group to the present ones."""
        self.parameters.begin_line(_ingredients(job))

    def pressure_mass(self, pressures: fem.FunctionSpace) -> Any:
        """Return ``∫ (1/μ + 1/Λ) p q`` over the mesh, spectrally equivalent to the Schur complement of the pressures.

        Source: Wathen & Silvester, SIAM J. Numer. Anal. 30, 630–649, 1993, doi:10.1137/0730031.
        """
        p, q = ufl.TrialFunction(pressures), ufl.TestFunction(pressures)
        dx = self.kinematics.integration.part
        return sum(part.compliance * p * q * dx(number) for number, part in enumerate(self.parts))

    @cached_property
    def passages(self) -> Passages:
        """The ways of the body past obstacles of contact."""
        return self.contacts.passages(self.unknowns)

    @cached_property
    def means(self) -> StateMeans:
        """Means over cells, volume ratios and strain energy, to be evaluated in any state."""
        volume = self.kinematics.volumes[0]
        parts = [
            PartExpressions(cells, sigma, self.J, part.energy * volume)
            for part, (sigma, cells) in zip(self.parts, self.cauchy_stress, strict=True)
        ]
        return StateMeans(parts, self.prestrain_stress, self.unknowns.mesh, self.quadrature_degree)

    @cached_property
    def nominal_displacement(self) -> NominalDisplacement:
        """The displacement that loads and inelastic strains would cause if nothing balanced them."""
        moduli = [(part.shear_modulus, part.cells) for part in self.parts]
        return NominalDisplacement(
            self._strains, self._potentials, self._works, self.H, moduli, self.unknowns, self.quadrature_degree
        )

    @cached_property
    def parameter_derivative(self) -> ParameterDerivative:
        """Derivative of the residual by the parameters."""
        return ParameterDerivative(self.residual, self.parameters, self.unknowns.mesh)

    @cached_property
    def cauchy_stress(self) -> list[tuple[Any, npt.NDArray[np.int32] | None]]:
        """``σ = J⁻¹ P Fᵀ`` in scaled stresses, (3, 3), of each part and the cells of that part (``None`` for all)."""
        F = ufl.Identity(3) + self.kinematics.H
        return [(remove_stages(part.P * F.T / self.J), part.cells) for part in self.parts]

    @property
    def prestrain_stress(self) -> list[tuple[Any, npt.NDArray[np.int32] | None]]:
        """Cauchy stress at ``F = I`` that prestrain alone causes, as `cauchy_stress`; empty without prestrain.

        It is the deviator where the law is incompressible, since the strain does not determine the pressure.
        """
        if self._reference_elastic is None:
            return []
        H = Variable(self._reference_elastic.H, LABEL)
        elastic, stresses = Deformation(H, self._reference_elastic.fibres), []
        for number, (law, part) in enumerate(zip(self._laws, self.parts, strict=True)):
            psi = law.isochoric_energy(elastic, self.parameters.quantities(number))
            if part.volumetric_modulus is not None:
                psi = psi + part.volumetric_modulus * law.dilatation(elastic) ** 2 / 2
            sigma = gradient(psi, H) * elastic.F.T / elastic.J
            stresses.append((remove_stages(ufl.dev(sigma) if law.is_incompressible else sigma), part.cells))
        return stresses

    @property
    def prestrain(self) -> Any:
        """The stress-free stretch ``F0`` on the reference body, (3, 3), the product of all prestrains."""
        F0 = ufl.Identity(3)
        for strain in self._own:
            F0 = (ufl.Identity(3) + strain) * F0
        return remove_stages(F0)


def _potentials(named: Iterable[tuple[str, tuple[Effect, Any, Any]]], total: Deformation) -> Iterator[Any]:
    """Yield the potentials of effects."""
    for where, (effect, load, p) in named:
        potential = noted(where, effect.potential, effect.potential(total, load, p))
        if potential is not None:
            yield potential


def _strains(data: Sequence[tuple[Effect, Any, Any]], total: Deformation, state: Any) -> Iterator[tuple[Effect, Any]]:
    """Yield each effect with an inelastic strain, and that strain."""
    for effect, load, p in data:
        strain = _strain(effect, effect.inelastic_strain(total, load, p), state)
        if strain is not None:
            yield effect, strain


def _effect_data(job: Job, fields: BodyFields, par: Parameters) -> list[tuple[Effect, Any, Any]]:
    """Return each effect with its load factor and its quantities, with the functions that the solver updates."""
    data = []
    for i, (where, effect) in enumerate(job.named_effects, start=len(job.laws)):
        p = par.quantities(i)
        if effect.presses_at_any_load:
            p.growing = par.growing
        for name, (components, degree) in effect.functions(job.discretisation.displacement).items():
            setattr(p, name, fields.updated(f"{where}.{name}", components, degree))
        data.append((effect, par.load(job.case_of(effect)), p))
    return data


def _part(
    law: MaterialLaw,
    p: Any,
    elastic: Deformation,
    J_g: Any,
    potentials: list[Any],
    unknown: Any,
    H: Variable,
    cells: npt.NDArray[np.int32] | None,
) -> Part:
    """Return energy and stress of a law with parameters ``p``, and with the potentials of effects.

    ``unknown`` is the pressure, ``None`` if the law gives it.
    """
    theta = law.dilatation(elastic)
    modulus = None if law.is_incompressible else law.volumetric_modulus(p)
    psi = energy = law.isochoric_energy(elastic, p)
    constraint = None
    if unknown is None:
        psi = energy = psi + modulus * theta**2 / 2
        pressure = -J_g * modulus * theta
    else:
        psi = psi - unknown * theta
        pressure = J_g * unknown
        constraint = J_g * (theta if modulus is None else theta + unknown / modulus)
        energy = energy if modulus is None else energy + unknown**2 / (2 * modulus)
    return Part(
        cells,
        J_g * energy,
        gradient(sum(potentials, J_g * psi), H),
        constraint,
        law.domain(elastic, p),
        elastic.J if law.is_incompressible else None,
        pressure,
        theta,
        law.shear_modulus(p),
        modulus,
        J_g,
    )


def _modulus(job: Job, fields: BodyFields, scales: Scales) -> float:
    """Return a typical shear modulus of the body, scaled."""
    return shear_modulus(job, fields) / scales.stress


def _contacts(
    job: Job, named: tuple[Any, ...], fields: BodyFields, unknowns: Unknowns, kin: Kinematics, scales: Scales
) -> Contacts:
    """Return the contacts of a job, with obstacles of its ``named`` effects and between bodies."""
    modulus, body = _modulus(job, fields, scales), fields.body
    obstacles, pairs = paired_obstacles(named, body, job.resolve), ()
    if job.interfaces or obstacles:
        pair = on_demand("interfaces")
        pairs = pair(job.interfaces, obstacles, body, unknowns, kin.sign, (modulus, scales.stress))
    return Contacts(named, kin, body, job.resolve, job.discretisation.displacement, modulus, pairs)


def _ingredients(job: Job) -> list[tuple[str, Ingredient]]:
    """Return laws, effects and families of fibres with their names in the job or its state, in a fixed order."""
    effects = ((f"effects[{i}]", effect) for i, effect in enumerate(job.effects))
    return [*job.laws.items(), *effects, *job.families.items()]


def _strain(effect: Effect, strain: Any, data_state: Kinematics | OtherState) -> Any:
    """Return an inelastic strain ``F_g - I`` of the reference body, ``None`` if there is none."""
    if strain is None or effect.strain_given_on == "reference":
        return strain
    return data_state.F_inverse * strain * (ufl.Identity(3) + data_state.H)


def _elastic(total: Deformation, strains: Iterable[Any]) -> tuple[Deformation, Any]:
    """Return ``F F_g⁻¹`` and ``J_g`` of inelastic strains, the first one first."""
    elastic, J_g = total, 1
    for strain in strains:
        stretch = Deformation(strain)
        elastic, J_g = elastic.elastic_part(stretch), J_g * stretch.J
    return elastic, J_g


def _directions(job: Job, kin: Kinematics, par: Parameters, first: int) -> dict[str, Any]:
    """Return unit vectors of the fibres in the reference body; in ``par`` they begin at the first owner."""
    return {
        name.removeprefix("fibres."): _unit(kin.data_state, family.given_on, par.quantities(i).direction)
        for i, (name, family) in enumerate(job.families.items(), start=first)
    }


def _works(named: Iterable[tuple[str, Any]], kin: Kinematics, v: Any) -> Iterator[Any]:
    for where, (effect, load, quantities) in named:
        work = external_work(where, effect, kin, v, load, quantities)
        if work is not None:
            yield work


def _unit(kin: Kinematics | OtherState, given_on: str, direction: Any) -> Any:
    """Return a unit vector in the reference body."""
    a = direction if given_on == "reference" else kin.F_inverse * direction
    return a / ufl.sqrt(ufl.inner(a, a))
