"""Ogden."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import ValidationInfo, field_validator

from hpcinv.materials.isochoric import IsochoricLaw
from hpcinv.quantities import Dimensionless
from hpcinv.schema import ListOf, raise_if_any
from hpcinv.varying import StressField

if TYPE_CHECKING:
    from hpcinv.kinematics import Deformation


class Ogden(IsochoricLaw):
    """Ogden with isochoric principal stretches and any number of terms.

    ``psi = Σ muᵢ/alphaᵢ (lambda1_bar^alphaᵢ + lambda2_bar^alphaᵢ + lambda3_bar^alphaᵢ - 3) + U(J; kappa)``; the shear
    modulus is ``½ Σ muᵢ alphaᵢ``. Some texts write ``2 muᵢ/alphaᵢ²`` in place of ``muᵢ/alphaᵢ``: what they call ``muᵢ``
    is ``muᵢ alphaᵢ/2`` here.

    Source: Ogden (1972), doi:10.1098/rspa.1972.0026.
    """

    formula = "mu_i/alpha_i*(lambda1_bar**alpha_i + lambda2_bar**alpha_i + lambda3_bar**alpha_i - 3)"
    """One term; each has its number in place of ``_i``."""
    example: ClassVar = {
        "law": "ogden",
        "mu": ["0.63 MPa", "1.2 kPa", "-10 kPa"],
        "alpha": [1.3, 5, -2],
        "kappa": "2 MPa",
    }

    law: Literal["ogden"] = "ogden"
    mu: ListOf[StressField]
    """factor of each term"""
    alpha: ListOf[Dimensionless]
    """exponent of each term, of the same sign as its factor in most cases"""

    @field_validator("alpha")
    @classmethod
    def _belong_to_the_factors(cls, alpha: tuple[float, ...], info: ValidationInfo) -> tuple[float, ...]:
        if not alpha:
            raise ValueError("must have at least one entry")
        raise_if_any(((i,), "must not be 0") for i, exponent in enumerate(alpha) if exponent == 0)
        if "mu" in info.data and (count := len(info.data["mu"])) != len(alpha):
            raise ValueError(f"must have as many entries as mu, {count}, not {len(alpha)}")
        return alpha

    @property
    def energy_formula(self) -> str:
        terms = (self.formula.replace("_i", str(i + 1)) for i in range(len(self.mu)))
        return " + ".join([*terms, self.volumetric_formula])

    def shear_modulus(self, par: Any) -> Any:
        return sum(par.mu[i] * par.alpha[i] for i in range(len(self.mu))) / 2

    def distortion(self, k: Deformation, par: Any) -> Any:
        from hpcinv.stretches import IsochoricStretches

        stretches = IsochoricStretches(k)
        return sum(par.mu[i] / par.alpha[i] * stretches.power_sum_minus_3(par.alpha[i]) for i in range(len(self.mu)))
