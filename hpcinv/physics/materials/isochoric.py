"""Laws with a split of the energy into an isochoric and a volumetric part ``U = kappa/2 · theta(J)²``.

Since each volumetric energy is a square, ``theta`` is the strain whose conjugate is the pressure of the mixed form.
"""

from collections.abc import Callable
from typing import Any, Literal

from hpcinv.base.quantity import BulkModulusField
from hpcinv.physics.kinematics.stable_functions import log1p_remainder_ratio, sqrt
from hpcinv.physics.materials.material_law import Deformation, MaterialLaw

type Volumetric = Literal["quadratic", "logarithmic", "simo-taylor", "liu"]


def _simo_taylor(k: Deformation) -> Any:
    # With ln J = x + s x²: J² - 1 - 2 ln J = 2x + x² - 2x - 2s x².
    x = k.J_minus_1
    return x * sqrt(0.5 - log1p_remainder_ratio(x))


def _liu(k: Deformation) -> Any:
    # With ln J = x + s x²: J ln J - J + 1 = (1 + x)(x + s x²) - x.
    x = k.J_minus_1
    return x * sqrt(2 * (1 + k.J * log1p_remainder_ratio(x)))


DILATATIONS: dict[str, tuple[str, Callable[[Deformation], Any]]] = {
    "quadratic": ("kappa/2*(J - 1)**2", lambda k: k.J_minus_1),
    "logarithmic": ("kappa/2*ln(J)**2", lambda k: k.ln_J),
    "simo-taylor": ("kappa/4*(J**2 - 1 - 2*ln(J))", _simo_taylor),
    "liu": ("kappa*(J*ln(J) - J + 1)", _liu),
}
"""Energy as a formula, and ``theta``.

Sources: Simo & Taylor (1991), doi:10.1016/0045-7825(91)90100-K; Liu, Hofstetter & Mang (1994), "3D finite element
analysis of rubber-like materials at finite strains", Engineering Computations 11.
"""


class IsochoricLaw(MaterialLaw):
    """A law of the form ``psi = formula + U(J; kappa)``."""

    kappa: BulkModulusField
    """bulk modulus, or 'incompressible'"""
    volumetric: Volumetric = "quadratic"
    """volumetric energy U"""

    @property
    def volumetric_formula(self) -> str:
        return DILATATIONS[self.volumetric][0]

    def bulk_modulus(self, par: Any) -> Any:
        return par.kappa

    def dilatation(self, k: Deformation) -> Any:
        return DILATATIONS[self.volumetric][1](k)
