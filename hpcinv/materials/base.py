"""What the scene asks of a material law."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, Any, Self

from pydantic import model_validator

from hpcinv.schema import Spec, raise_if_any

if TYPE_CHECKING:
    from hpcinv.kinematics import Deformation


class MaterialLaw(Spec):
    """A hyperelastic law ``psi = distortion + dilatation_modulus/2 · dilatation²``.

    A subclass in a module of this package, with a literal field ``law``, is registered by that. Its parameters are
    fields; the energy reads them, scaled, from ``par`` by the same names.
    """

    @abstractmethod
    def distortion(self, k: Deformation, par: Any) -> Any:
        """The energy per reference volume without its volumetric part, as a UFL expression."""

    @abstractmethod
    def dilatation(self, k: Deformation) -> Any:
        """The volumetric strain ``theta(J)``, zero at ``J = 1``, whose conjugate is the pressure of the mixed form."""

    @property
    @abstractmethod
    def dilatation_modulus(self) -> float:
        """Stiffness against ``dilatation``, in Pa; infinite if the material is incompressible."""

    @property
    @abstractmethod
    def shear_modulus(self) -> float:
        """Shear modulus ``mu`` of the undeformed material, in Pa."""

    @property
    @abstractmethod
    def bulk_modulus(self) -> float:
        """Bulk modulus ``kappa`` of the undeformed material, in Pa; infinite if it is incompressible."""

    @model_validator(mode="after")
    def _is_stable(self) -> Self:
        moduli = {"shear modulus": self.shear_modulus, "bulk modulus": self.bulk_modulus}
        raise_if_any(
            ((), f"the {name} that follows from these parameters must be positive, but is {value:g} Pa")
            for name, value in moduli.items()
            if not value > 0
        )
        return self
