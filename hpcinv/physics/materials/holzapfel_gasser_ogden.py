"""Holzapfel–Gasser–Ogden."""

from typing import ClassVar, Literal

from pydantic import field_validator

from hpcinv.base.quantity import DispersionField, Family, ListOf, ModulusField, PositiveField, raise_if_any
from hpcinv.physics.materials.isochoric import IsochoricLaw
from hpcinv.physics.materials.material_law import StartingValues

_GROUND = "mu/2*(I1_bar - 3)"
_FIBRES = "k1/(2*k2)*(exp(k2*max(dispersion*(I1 - 3) + (1 - 3*dispersion)*(I4_fibres_i - 1), 0)**2) - 1)"


class HolzapfelGasserOgden(IsochoricLaw):
    """Holzapfel–Gasser–Ogden, for arteries: families of dispersed collagen fibres in a neo-Hookean ground substance.

    The strain of fibres is computed from ``C``, not from ``C_bar``, so that it includes the change of volume. Only
    positive strain has energy.

    Source: Gasser, Ogden & Holzapfel (2006), doi:10.1098/rsif.2005.0073, with the invariants of
    Nolan et al. (2014), doi:10.1016/j.jmbbm.2014.06.016.
    """

    formula = f"{_GROUND} + {_FIBRES}"
    """The formula for one family; its number replaces ``_i`` in the second term."""
    example: ClassVar = {
        "law": "holzapfel-gasser-ogden",
        "mu": "3 kPa",
        "k1": "2.4 kPa",
        "k2": 0.84,
        "dispersion": 0.1,
        "kappa": "20 kPa",
    }
    starting_values: ClassVar = {
        "tissue": StartingValues(
            {"mu": "3 kPa", "k1": "2.3632 kPa", "k2": 0.8393, "dispersion": 0, "kappa": "incompressible"},
            "media of a rabbit's carotid artery, families of fibres at 29° to the circumference",
            "Holzapfel, Gasser & Ogden (2000), doi:10.1023/A:1010835316564",
        ),
    }

    law: Literal["holzapfel-gasser-ogden"] = "holzapfel-gasser-ogden"
    mu: ModulusField
    """shear modulus of the ground substance"""
    k1: ModulusField
    """stiffness of each family of fibres"""
    k2: PositiveField
    """exponent, how fast fibres stiffen"""
    dispersion: DispersionField
    """from 0, fibres of a family are parallel, to 1/3, they have all directions alike"""
    fibres: ListOf[Family] = ("fibre1", "fibre2")
    """families of fibres, one or more"""

    @field_validator("fibres")
    @classmethod
    def _are_different(cls, fibres: tuple[str, ...]) -> tuple[str, ...]:
        if not fibres:
            raise ValueError("must name at least one family of fibres")
        raise_if_any(((i,), f"'{name}' is duplicated") for i, name in enumerate(fibres) if name in fibres[:i])
        return fibres

    @property
    def own_formula(self) -> str:
        families = (_FIBRES.replace("_i", str(i + 1)) for i in range(len(self.fibres)))
        return " + ".join([_GROUND, *families])
