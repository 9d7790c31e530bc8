"""Transversely isotropic, the standard reinforcing model."""

from typing import ClassVar, Literal

from hpcinv.base.quantity import Family, ModulusField
from hpcinv.physics.materials.isochoric import IsochoricLaw


class TransverselyIsotropic(IsochoricLaw):
    """Standard reinforcing model: neo-Hookean with one family of fibres, alike in tension and compression.

    ``I4`` is computed from ``C``, not from ``C_bar``.

    Source: Qiu & Pence (1997), "Remarks on the behavior of simple directionally reinforced incompressible nonlinearly
    elastic solids", Journal of Elasticity 49.
    """

    formula = "mu/2*(I1_bar - 3) + k/2*(I4_fibre - 1)**2"
    example: ClassVar = {"law": "transversely-isotropic", "mu": "5 kPa", "k": "20 kPa", "kappa": "30 kPa"}

    law: Literal["transversely-isotropic"] = "transversely-isotropic"
    mu: ModulusField
    """shear modulus of the ground substance"""
    k: ModulusField
    """stiffness of the fibres: they add 4 k to the modulus along them"""
    fibre: Family = "fibre"
    """family of fibres"""
