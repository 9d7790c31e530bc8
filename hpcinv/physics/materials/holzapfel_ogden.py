"""Holzapfel–Ogden."""

from typing import Annotated, Any, ClassVar, Literal

from hpcinv.base.quantity import Family, ModulusField, PositiveField, VaryingQuantity
from hpcinv.physics.materials.isochoric import IsochoricLaw
from hpcinv.physics.materials.material_law import StartingValues

_StiffnessOfFibres = Annotated[Any, VaryingQuantity("Pa", at_least=0)]  # zero leaves out a term


class HolzapfelOgden(IsochoricLaw):
    """Holzapfel–Ogden, for passive myocardium with the directions of fibres and of sheets.

    ``mu = a``. Fibres and sheets have energy only in tension; ``I4`` and ``I8 = f0·(C - I) s0`` are computed from
    ``C``, not from ``C_bar``.

    Source: Holzapfel & Ogden (2009), doi:10.1098/rsta.2009.0091.
    """

    formula = (
        "a/(2*b)*(exp(b*(I1_bar - 3)) - 1) + a_f/(2*b_f)*(exp(b_f*max(I4_fibre - 1, 0)**2) - 1)"
        " + a_s/(2*b_s)*(exp(b_s*max(I4_sheet - 1, 0)**2) - 1) + a_fs/(2*b_fs)*(exp(b_fs*I8_fibre_sheet**2) - 1)"
    )
    example: ClassVar = {
        "law": "holzapfel-ogden",
        "a": "0.496 kPa",
        "b": 7.209,
        "a_f": "15.193 kPa",
        "b_f": 20.417,
        "a_s": "3.283 kPa",
        "b_s": 11.176,
        "a_fs": "0.662 kPa",
        "b_fs": 9.466,
        "kappa": "5 kPa",
    }
    starting_values: ClassVar = {
        "tissue": StartingValues(
            {
                "a": "0.059 kPa",
                "b": 8.023,
                "a_f": "18.472 kPa",
                "b_f": 16.026,
                "a_s": "2.481 kPa",
                "b_s": 11.12,
                "a_fs": "0.216 kPa",
                "b_fs": 11.436,
                "kappa": "incompressible",
            },
            "passive myocardium of a pig in simple shear",
            "Holzapfel & Ogden (2009), doi:10.1098/rsta.2009.0091",
        ),
    }

    law: Literal["holzapfel-ogden"] = "holzapfel-ogden"
    a: ModulusField
    """shear modulus of the ground substance"""
    b: PositiveField
    """exponent of the ground substance"""
    a_f: _StiffnessOfFibres
    """stiffness along the fibres"""
    b_f: PositiveField
    """exponent along the fibres"""
    a_s: _StiffnessOfFibres
    """stiffness along the sheets, across the fibres"""
    b_s: PositiveField
    """exponent along the sheets"""
    a_fs: _StiffnessOfFibres
    """stiffness against shear between fibres and sheets"""
    b_fs: PositiveField
    """exponent of that shear"""
    fibre: Family = "fibre"
    """family of fibres along the muscle fibres"""
    sheet: Family = "sheet"
    """family of fibres along the sheets, at right angles to the muscle fibres"""

    def shear_modulus(self, par: Any) -> Any:
        return par.a
