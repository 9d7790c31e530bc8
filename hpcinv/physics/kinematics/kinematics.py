"""Finite-strain kinematics: the only module that depends on the configuration of the mesh.

The unknown is the displacement ``u = x - X`` in both directions (the paper's ``u'`` is ``-u``).

==================  =====================  ==========================
quantity            forward                inverse
==================  =====================  ==========================
the mesh is         reference body         current body
position map        ``x = X + u``          ``X = x - u``
``H = F - I``       ``∇u``                 ``h (I - h)⁻¹``, ``h = ∇u``
``Grad v``          ``∇v``                 ``∇v F``
``dV``              ``dx``                 ``det(I - h) dx``
``dv``              ``J dx``               ``dx``
``dA``              ``ds``                 ``|cof(I - h) n| ds``
``da``              ``|cof(F) N| ds``      ``ds``
``n da``            ``cof(F) N ds``        ``n ds``
==================  =====================  ==========================

Invariants are computed from ``H``, never from ``F``, which avoids cancellation at small strain (Shakeri et al., "Stable
numerics for finite-strain elasticity", 2024, arXiv:2401.13196).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from copy import copy
from functools import cached_property
from types import MappingProxyType
from typing import Any, Protocol

import ufl
from ufl.classes import Label, Variable

from hpcinv.physics.kinematics.stable_functions import log1p_remainder
from hpcinv.physics.kinematics.staged_derivatives import stage

LABEL = Label(1_000_000)
"""Label of `Kinematics.H`. UFL's running number would change the kernels of each weak form, and a small number might be
used by a variable of a law."""


class Measures(Protocol):
    """Interface of measures of integration over the mesh, implemented in `hpcinv.model.measures`."""

    @property
    def volume(self) -> Any:
        """The whole body."""

    def part(self, number: int) -> Any:
        """Return one of the parts of the body, from 0."""

    def surface(self, region: str, least_degree: int = 0) -> Any:
        """Return a region of the boundary, with a quadrature degree of at least ``least_degree``."""

    @property
    def layers(self) -> int:
        """Number of layers of a shell."""


class Deformation:
    """Strain measures and invariants of one displacement gradient ``H`` (3 × 3, dimensionless).

    ``fibres`` are unit vectors ``a0`` of the reference body by the name of their family.

    Quantities that vanish in the undeformed state are computed without subtracting large numbers; laws should be
    written in terms of them.
    """

    def __init__(self, H: Any, fibres: Mapping[str, Any] = MappingProxyType({})) -> None:
        self.H = H
        self.fibres = fibres

    @cached_property
    def I(self) -> Any:  # noqa: E743  (the identity's name in every text on the subject)
        return ufl.Identity(3)

    @cached_property
    def F(self) -> Any:
        """Deformation gradient ``F = I + H``."""
        return self.I + self.H

    @stage
    def E(self) -> Any:
        """Green–Lagrange strain ``E = sym H + ½ Hᵀ H``."""
        return ufl.sym(self.H) + self.H.T * self.H / 2

    @stage
    def J_minus_1(self) -> Any:
        """``det F - 1 = tr H + ½ (tr² H - tr H²) + det H``."""
        return ufl.tr(self.H) + self._second_order

    @cached_property
    def J(self) -> Any:
        """Volume ratio ``J = det F``."""
        return 1 + self.J_minus_1

    @stage
    def ln_J(self) -> Any:
        return self.J_minus_1 + log1p_remainder(self.J_minus_1)

    @stage
    def I1_minus_3(self) -> Any:
        """``tr C - 3``."""
        return 2 * ufl.tr(self.E)

    @stage
    def I1_bar_minus_3(self) -> Any:
        """``J^(-2/3) tr C - 3``."""
        s = self._cbrt_J_minus_1
        remainder = -(s**2) * (2 * s + 3) / 3  # J^(2/3) - 1 - 2/3 (J - 1)
        return (2 * self._trE_minus_J_minus_1 - 3 * remainder) / (1 + s) ** 2

    @stage
    def I2_bar_minus_3(self) -> Any:
        """``J^(-4/3) I2 - 3``."""
        s = self._cbrt_J_minus_1
        remainder = s**2 * (3 * s**2 + 8 * s + 6) / 3  # J^(4/3) - 1 - 4/3 (J - 1)
        return (4 * self._trE_minus_J_minus_1 + self._second_of_E - 3 * remainder) / (1 + s) ** 4

    def fibre(self, family: str) -> Fibre:
        return Fibre(self, self.fibres[family])

    def I8(self, family: str, other: str) -> Any:
        """Return ``a0·(C - I) b0`` of two families: ``a·b`` of the deformed fibres, if ``a0·b0 = 0``."""
        return 2 * ufl.inner(self.fibres[family], self.E * self.fibres[other])

    def orthogonalised(self, family: str, other: str) -> Deformation:
        """Return the same deformation with the direction of ``other`` replaced by its part across ``family``."""
        a, b = self.fibres[family], self.fibres[other]
        normal_part = b - ufl.inner(a, b) * a
        deformation = copy(self)
        deformation.fibres = {**self.fibres, other: normal_part / ufl.sqrt(ufl.inner(normal_part, normal_part))}
        return deformation

    def axial_strain(self, families: Sequence[str], strains: Sequence[Any]) -> Any:
        """Return ``Σ ε_i a_i⊗aⁱ``, which strains lines along three families ``a_i``; ``aⁱ`` are reciprocal to them.

        A third direction that is left out is normal to the other two.
        """
        axes = [self.fibres[family] for family in families]
        if len(axes) == 2:
            axes.append(ufl.cross(*axes))
        pairs = [ufl.cross(axes[1], axes[2]), ufl.cross(axes[2], axes[0]), ufl.cross(axes[0], axes[1])]
        volume = ufl.inner(axes[0], pairs[0])
        return sum(e / volume * ufl.outer(a, pair) for e, a, pair in zip(strains, axes, pairs, strict=True))

    def elastic_part(self, stretch: Deformation) -> Deformation:
        """Return ``F F_g⁻¹`` for a stretch ``F_g`` that precedes it, with fibres ``F_g a0 / |F_g a0|``.

        Fibres are lines of the material, so that a rotation in ``F_g`` changes no invariant.
        """
        fibres = {}
        for family, direction in self.fibres.items():
            a = stretch.F * direction
            fibres[family] = a / ufl.sqrt(ufl.inner(a, a))
        return Deformation((self.H - stretch.H) * ufl.inv(stretch.F), fibres)

    @stage
    def _cbrt_J_minus_1(self) -> Any:
        """``J^(1/3) - 1``, from ``t³ - 1 = (t - 1)(1 + t + t²)``."""
        t = self.J ** (1 / 3)
        return self.J_minus_1 / (1 + t + t**2)

    @stage
    def _second_order(self) -> Any:
        """``J - 1 - tr H``."""
        H = self.H
        return (ufl.tr(H) ** 2 - ufl.tr(H * H)) / 2 + ufl.det(H)

    @stage
    def _trE_minus_J_minus_1(self) -> Any:
        """``tr E - (J - 1)``, whose first-order terms cancel analytically."""
        return ufl.inner(self.H, self.H) / 2 - self._second_order

    @stage
    def _second_of_E(self) -> Any:
        return 2 * (ufl.tr(self.E) ** 2 - ufl.inner(self.E, self.E))


class Fibre:
    """Invariants of one family of fibres with the unit vector ``a0`` in the reference body."""

    def __init__(self, k: Deformation, direction: Any) -> None:
        self._k, self.direction = k, direction

    @property
    def dyad(self) -> Any:
        """``a0⊗a0``."""
        return ufl.outer(self.direction, self.direction)

    @stage
    def E_aa(self) -> Any:
        """Green–Lagrange strain along the fibre, ``a0·E a0``."""
        return ufl.inner(self.direction, self._k.E * self.direction)

    @cached_property
    def I4_minus_1(self) -> Any:
        """``a0·C a0 - 1``, the squared stretch of the fibre less 1."""
        return 2 * self.E_aa


class Kinematics(ABC):
    """Position, gradients and measures of both bodies for one direction of the analysis.

    Args:
        u: displacement ``x - X``, vector of 3, in scaled lengths.
        integration: measures of the mesh.

    Attributes:
        data_state: state in which fibres, fields and densities "of the current body" are given: this one, or another.
    """

    direction: str
    sign: int
    """The other body is the mesh displaced by ``sign * u``; 1 for the current body, -1 for the reference body."""

    def __init__(self, u: Any, integration: Measures) -> None:
        self.u = u
        self.data_state: Kinematics | OtherState = self
        self.integration = integration
        self._coordinates = ufl.SpatialCoordinate(ufl.domain.extract_unique_domain(u))

    @cached_property
    def H(self) -> Variable:
        """Displacement gradient with respect to the reference body, ``∂u/∂X``, a stage of derivatives.

        It is not the variable by which laws are differentiated, which leaves fibres and strains as they are that are
        given on the current body.
        """
        return Variable(self._H, LABEL)

    @property
    @abstractmethod
    def _H(self) -> Any:
        """`H` as an expression of the displacement."""

    @property
    @abstractmethod
    def F_inverse(self) -> Any:
        """``∂X/∂x``."""

    @abstractmethod
    def Grad(self, v: Any) -> Any:
        """Return the gradient of ``v`` with respect to the reference body."""

    @cached_property
    def _h(self) -> Any:
        """Gradient of the map from the mesh to the other body, less ``I``."""
        return self.sign * ufl.grad(self.u)

    def reference_and_current(self, mesh: Any, other: Any) -> tuple[Any, Any]:
        """Return the value of the reference and the value of the current body."""
        return (mesh, other) if self.sign > 0 else (other, mesh)

    def unknown_body_value[T](self, reference: T, current: T) -> T:
        """Return the value of the unknown body, of the values of the reference and of the current body."""
        return current if self.sign > 0 else reference

    def load_factors(self, load: Any, growing: Any = 0) -> tuple[Any, Any]:
        """Return two factors at a load factor: of forces given by the current position, and of motions in space.

        In forward problems such forces, of an obstacle say, act at every load, on a body that reaches its position
        while the obstacle moves. In inverse ones the current position is known, and so are these forces: they grow with
        the load, and motions are complete.

        Args:
            growing: 1 if such forces grow with the load in forward problems too, else 0.
        """
        return (1 + growing * (load - 1), load) if self.sign > 0 else (load, 1)

    @cached_property
    def X(self) -> Any:
        """Reference position in scaled lengths."""
        return self._coordinates if self.sign > 0 else self._coordinates - self.u

    @cached_property
    def x(self) -> Any:
        """Current position in scaled lengths."""
        return self._coordinates + self.u if self.sign > 0 else self._coordinates

    @cached_property
    def N(self) -> Any:
        """Outward unit normal of the reference body."""
        return self.reference_and_current(self._normal, self._area_vector / self._area)[0]

    @cached_property
    def n(self) -> Any:
        """Outward unit normal of the current body."""
        return self.reference_and_current(self._normal, self._area_vector / self._area)[1]

    @property
    def J(self) -> Any:
        """Volume ratio."""
        return self.volumes[1] / self.volumes[0]

    @property
    def volumes(self) -> tuple[Any, Any]:
        """Volume of the reference and of the current body per volume of the mesh."""
        return self.reference_and_current(1, self.mesh_J)

    @property
    def areas(self) -> tuple[Any, Any]:
        """Area of the boundary of the reference and of the current body per area of the mesh."""
        return self.reference_and_current(1, self._area)

    def dV(self, integrand: Any, measure: Any = None) -> Any:
        """Return the integral over the reference volume, of the whole body or of ``measure``."""
        return integrand * self.volumes[0] * (measure or self.integration.volume)

    def dv(self, integrand: Any) -> Any:
        """Return the integral over the current volume."""
        return integrand * self.volumes[1] * self.integration.volume

    def dm(self, integrand: Any, density_in: str) -> Any:
        """Return the integral of what is in proportion to a mass density, over the volume to which that refers.

        The volume of the current body is the volume in `data_state`, so that all states have the same mass.
        """
        if density_in == "reference":
            return self.dV(integrand)
        return self.dv(integrand) if self.data_state is self else self.dV(integrand * self.data_state.J)

    def dA(self, integrand: Any, region: str) -> Any:
        """Return the integral over the reference area of a region of the boundary."""
        return integrand * self.areas[0] * self.integration.surface(region)

    def da(self, integrand: Any, region: str, least_degree: int = 0) -> Any:
        """Return the integral over the current area of a region of the boundary.

        Args:
            least_degree: quadrature degree, if the one of the weak form is lower.
        """
        return integrand * self.areas[1] * self.integration.surface(region, least_degree)

    def n_da(self, vector: Any, region: str, least_degree: int = 0) -> Any:
        """Return ``∫ vector · n da`` over a region of the boundary, with the outward unit normal ``n``.

        Args:
            least_degree: quadrature degree, if the one of the weak form is lower.
        """
        n_da = self.reference_and_current(self._normal, self._area_vector)[1]
        return ufl.inner(vector, n_da) * self.integration.surface(region, least_degree)

    @cached_property
    def across(self) -> tuple[Any, Any]:
        """Material line through a layer of a shell, in the reference and in the current body."""
        line = self._line_across
        return self.reference_and_current(line, line + self._h * line)

    def work_of_moment(self, moment: Sequence[Any], v: Any) -> Any:
        """Return ``m · (d × δd)/(d·d)``, the virtual work of a moment on a line ``d`` through the thickness."""
        line = self.across[1]
        arm = ufl.cross(ufl.as_vector(list(moment)), line) / ufl.inner(line, line)
        return ufl.inner(ufl.grad(v) * self._line_across, arm)

    def dL(self, integrand: Any, edge: str) -> Any:
        """Return the integral over the reference length of an edge of a shell, of the mean over its thickness."""
        line, surface = self.across[0], self.integration.surface(edge)
        share = self.areas[0] / (self.integration.layers * ufl.sqrt(ufl.inner(line, line)))
        return integrand * share * surface

    @cached_property
    def mesh_J(self) -> Any:
        """Determinant that must be positive at every point: of ``∂x/∂X`` or of ``∂X/∂x``."""
        return Deformation(self._h).J

    @cached_property
    def _line_across(self) -> Any:
        """Line through a layer of a shell in the mesh, along the third axis of its cells."""
        jacobian = ufl.Jacobian(ufl.domain.extract_unique_domain(self._coordinates))
        return ufl.as_vector([jacobian[i, 2] for i in range(3)])

    @cached_property
    def _normal(self) -> Any:
        return ufl.FacetNormal(ufl.domain.extract_unique_domain(self._coordinates))

    @cached_property
    def _area_vector(self) -> Any:
        """Normal of the other body times its area per area of the mesh (Nanson's formula)."""
        return ufl.cofac(ufl.Identity(3) + self._h) * self._normal

    @cached_property
    def _area(self) -> Any:
        return ufl.sqrt(ufl.inner(self._area_vector, self._area_vector))


class OtherState:
    """The body in another state: the same material points at other current positions.

    Args:
        kin: kinematics of the state that is solved for, whose reference body is the same.
        u: displacement ``x - X`` of the other state at the material points, in scaled lengths.
    """

    def __init__(self, kin: Kinematics, u: Any) -> None:
        self.X, self.x = kin.X, kin.X + u
        self.H = kin.Grad(u)

    @cached_property
    def F_inverse(self) -> Any:
        """``∂X/∂x``."""
        return ufl.inv(ufl.Identity(3) + self.H)

    @cached_property
    def J(self) -> Any:
        """Volume ratio."""
        return Deformation(self.H).J


class ForwardKinematics(Kinematics):
    """Kinematics of forward problems: the mesh is the reference body, the deformed body is unknown."""

    direction = "forward"
    sign = 1

    @property
    def _H(self) -> Any:
        return self._h

    @cached_property
    def F_inverse(self) -> Any:
        return ufl.inv(ufl.Identity(3) + self.H)

    def Grad(self, v: Any) -> Any:
        return ufl.grad(v)


class InverseKinematics(Kinematics):
    """Kinematics of inverse problems: the mesh is the current body, the undeformed body is unknown.

    Source: doi:10.1007/s00366-021-01597-z.
    """

    direction = "inverse"
    sign = -1

    @cached_property
    def F_inverse(self) -> Any:
        return ufl.Identity(3) + self._h

    @property
    def _H(self) -> Any:
        return -self._h * ufl.inv(self.F_inverse)

    def Grad(self, v: Any) -> Any:
        return ufl.grad(v) * (ufl.Identity(3) + self.H)
