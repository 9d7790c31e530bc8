"""Usyk and McCulloch."""

from typing import Any, ClassVar, Literal

from hpcinv.base.quantity import Family, ModulusField, PositiveField
from hpcinv.physics.materials.green_lagrange import GreenLagrangeLaw
from hpcinv.physics.materials.material_law import Deformation


class UsykMcCulloch(GreenLagrangeLaw):
    """Usyk and McCulloch, for passive myocardium, orthotropic in fibres, sheets and normal of the sheets.

    In components, with fibres f, sheets s and the normal n of the sheets, the exponent is
    ``b_f E_ff² + b_s E_ss² + b_n E_nn² + 2 b_fs E_fs² + 2 b_fn E_fn² + 2 b_sn E_sn²``, where ``E`` is the ``strain``.
    Directions of sheets span the sheet together with the fibres: their part at right angles to the fibres counts, in
    the undeformed body. The shear moduli between pairs of axes are ``c b_fs/2``, ``c b_fn/2`` and ``c b_sn/2``.
    With ``b_s = b_n = b_sn`` and ``b_fs = b_fn`` it is the law ``guccione``.

    Source: Usyk, LeGrice & McCulloch (2002), doi:10.1007/s00791-002-0081-9.
    """

    # The part of b_sn is isotropic across the fibres, as in `guccione`, so that law `formula` finds its modulus.
    formula = (
        "c/2*(exp(b_f/4*(I4_fibre - 1)**2 + b_fs/2*I8_fibre_sheet**2"
        " + b_fn/2*(I5_fibre - I4_fibre**2 - I8_fibre_sheet**2)"
        " + (b_s - b_sn)/4*(I4_sheet - 1)**2 + (b_n - b_sn)/4*(I1 - I4_fibre - I4_sheet - 1)**2"
        " + b_sn/4*(I1**2 - 2*I1 - 2*I2 + 2 - 2*I5_fibre + 2*I4_fibre + I4_fibre**2)) - 1)"
    )
    example: ClassVar = {
        "law": "usyk-mcculloch",
        "c": "0.88 kPa",
        "b_f": 8,
        "b_s": 6,
        "b_n": 3,
        "b_fs": 12,
        "b_fn": 3,
        "b_sn": 3,
        "kappa": "10 kPa",
    }

    law: Literal["usyk-mcculloch"] = "usyk-mcculloch"
    c: ModulusField
    """stress that scales the energy"""
    b_f: PositiveField
    """exponent of strain along the fibres"""
    b_s: PositiveField
    """exponent of strain along the sheets, across the fibres"""
    b_n: PositiveField
    """exponent of strain along the normal of the sheets"""
    b_fs: PositiveField
    """exponent of shear between fibres and sheets"""
    b_fn: PositiveField
    """exponent of shear between fibres and the normal"""
    b_sn: PositiveField
    """exponent of shear between sheets and the normal"""
    fibre: Family = "fibre"
    """family of fibres along the muscle fibres"""
    sheet: Family = "sheet"
    """family of fibres along the sheets, across the muscle fibres"""

    def shear_modulus(self, par: Any) -> Any:
        return par.c * par.b_sn / 2

    def _evaluated_formula(self, k: Deformation, par: Any) -> tuple[Any, tuple[Any, ...]]:
        return super()._evaluated_formula(k.orthogonalised(self.fibre, self.sheet), par)
