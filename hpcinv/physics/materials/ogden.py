"""Ogden."""

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

from pydantic import ValidationInfo

from hpcinv.base.quantity import Dimensionless, Faults, KeyPath, ListOf, StressField
from hpcinv.physics.materials.isochoric import IsochoricLaw
from hpcinv.physics.materials.material_law import Deformation, StartingValues


class Ogden(IsochoricLaw):
    """Ogden with isochoric principal stretches and any number of terms.

    The shear modulus is ``½ Σ muᵢ alphaᵢ``. Some texts write ``2 muᵢ/alphaᵢ²`` instead of ``muᵢ/alphaᵢ``: what they
    call ``muᵢ`` is ``muᵢ alphaᵢ/2`` here.

    Source: Ogden (1972), doi:10.1098/rspa.1972.0026.
    """

    formula = "mu_i/alpha_i*(lambda1_bar**alpha_i + lambda2_bar**alpha_i + lambda3_bar**alpha_i - 3)"
    """One of the terms; the number of the term replaces ``_i``."""
    replaceable = ("mu", "kappa")
    example: ClassVar = {
        "law": "ogden",
        "mu": ["0.63 MPa", "1.2 kPa", "-10 kPa"],
        "alpha": [1.3, 5, -2],
        "kappa": "2 MPa",
    }
    starting_values: ClassVar = {
        "rubber": StartingValues(
            {"mu": ["0.63 MPa", "1.2 kPa", "-10 kPa"], "alpha": [1.3, 5, -2], "kappa": "incompressible"},
            "natural rubber",
            "Ogden (1972), doi:10.1098/rspa.1972.0026: his fit to the tests of Treloar (1944)",
        ),
    }

    law: Literal["ogden"] = "ogden"
    mu: ListOf[StressField]
    """factor of each term"""
    alpha: ListOf[Dimensionless]
    """exponent of each term, of the same sign as its factor in most cases"""

    def _contradictions(self, info: ValidationInfo) -> Faults:
        if not self.alpha:
            yield ("alpha",), "must have at least one entry"
        elif 0 in self.alpha:
            yield from ((("alpha", i), "must not be 0") for i, exponent in enumerate(self.alpha) if exponent == 0)
        elif len(self.mu) != len(self.alpha):
            yield ("alpha",), f"must have as many entries as mu, {len(self.mu)}, not {len(self.alpha)}"
        else:
            yield from super()._contradictions(info)

    @classmethod
    def leaves_out(cls, parameter: str, data: Mapping[str, Any]) -> bool:
        """Return whether a parameter is missing; the last factor is, if there are more exponents than factors."""
        given, exponents = data.get(parameter, ()), data.get("alpha")
        if parameter != "mu" or not isinstance(given, list | tuple) or not isinstance(exponents, list | tuple):
            return parameter not in data
        return len(given) < len(exponents)

    @classmethod
    def put(cls, parameter: str, value: Any, data: Mapping[str, Any]) -> dict[str, Any]:
        return super().put(parameter, [*data.get("mu", ()), value] if parameter == "mu" else value, data)

    def place_of(self, parameter: str) -> KeyPath:
        return (parameter, len(self.mu) - 1) if parameter == "mu" else (parameter,)

    @property
    def own_formula(self) -> str:
        terms = (self.formula.replace("_i", str(i + 1)) for i in range(len(self.mu)))
        return " + ".join(terms)

    def shear_modulus(self, par: Any) -> Any:
        return sum(par.mu[i] * par.alpha[i] for i in range(len(self.mu))) / 2

    # Principal stretches are not among the invariants of formulas: the sums of their powers need another algorithm to
    # keep their digits where stretches are equal.
    def isochoric_energy(self, k: Deformation, par: Any) -> Any:
        from hpcinv.physics.kinematics.principal_stretches import IsochoricStretches

        stretches = IsochoricStretches(k)
        return sum(par.mu[i] / par.alpha[i] * stretches.power_sum_minus_3(par.alpha[i]) for i in range(len(self.mu)))
