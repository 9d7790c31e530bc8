"""Guccione."""

from typing import Any, ClassVar, Literal

from hpcinv.base.quantity import Family, ModulusField, PositiveField
from hpcinv.physics.materials.green_lagrange import GreenLagrangeLaw
from hpcinv.physics.materials.material_law import StartingValues


class Guccione(GreenLagrangeLaw):
    """Guccione, for passive myocardium, transversely isotropic about the fibres.

    In components, with the fibres' direction f, the exponent is
    ``b_f E_ff² + b_t (E_ss² + E_nn² + 2 E_sn²) + 2 b_fs (E_fs² + E_fn²)``, where ``E`` is the ``strain``.
    The shear modulus across the fibres is ``c b_t/2``, along them ``c b_fs/2``.

    Source: Guccione, Costa & McCulloch (1995), doi:10.1016/0021-9290(94)00174-3; as in Land et al. (2015),
    doi:10.1098/rspa.2015.0641.
    """

    formula = (
        "c/2*(exp(b_f/4*(I4_fibre - 1)**2 + b_fs/2*(I5_fibre - I4_fibre**2)"
        " + b_t/4*(I1**2 - 2*I1 - 2*I2 + 2 - 2*I5_fibre + 2*I4_fibre + I4_fibre**2)) - 1)"
    )
    example: ClassVar = {"law": "guccione", "c": "2 kPa", "b_f": 8, "b_t": 2, "b_fs": 4, "kappa": "10 kPa"}
    starting_values: ClassVar = {
        "tissue": StartingValues(
            {"c": "2 kPa", "b_f": 8, "b_t": 2, "b_fs": 4, "kappa": "incompressible"},
            "passive myocardium",
            "Land et al. (2015), doi:10.1098/rspa.2015.0641, problem 3: values of a benchmark",
        ),
    }

    law: Literal["guccione"] = "guccione"
    c: ModulusField
    """stress that scales the energy"""
    b_f: PositiveField
    """exponent of strain along the fibres"""
    b_t: PositiveField
    """exponent of strain across the fibres"""
    b_fs: PositiveField
    """exponent of shear along the fibres"""
    fibre: Family = "fibre"
    """family of fibres"""

    def shear_modulus(self, par: Any) -> Any:
        return par.c * par.b_t / 2
