"""Arruda–Boyce."""

from fractions import Fraction
from typing import Annotated, Any, ClassVar, Literal

from hpcinv.base.quantity import ModulusField, VaryingQuantity
from hpcinv.physics.kinematics.stable_functions import polynomial
from hpcinv.physics.materials.isochoric import IsochoricLaw
from hpcinv.physics.materials.material_law import StartingValues

# Coefficients of the integrated series of the inverse Langevin function; the first is 1/2.
_SERIES = {2: "1/20", 3: "11/1050", 4: "19/7000", 5: "519/673750"}


class ArrudaBoyce(IsochoricLaw):
    """Arruda–Boyce, the network of eight chains, by five terms of the series of the inverse Langevin function.

    The small-strain shear modulus is larger than ``mu``: ``2 mu Σ i cᵢ (3/lambda_m²)^(i-1)``, with the coefficients
    ``cᵢ`` of the series.

    Source: Arruda & Boyce (1993), doi:10.1016/0022-5096(93)90013-6.
    """

    formula = (
        "mu*(1/2*(I1_bar - 3)"
        + "".join(f" + {c}/lambda_m**{2 * i - 2}*(I1_bar**{i} - {3**i})" for i, c in _SERIES.items())
        + ")"
    )
    replaceable = ("mu", "kappa")
    example: ClassVar = {"law": "arruda-boyce", "mu": "0.3 MPa", "lambda_m": 2.5, "kappa": "2 MPa"}
    starting_values: ClassVar = {
        "rubber": StartingValues(
            {"mu": "0.297 MPa", "lambda_m": 4.91, "kappa": "incompressible"},
            "natural rubber",
            "our fit to the uniaxial test of Treloar (1944), doi:10.1039/TF9444000059, up to a stretch of 7.6",
        ),
    }

    law: Literal["arruda-boyce"] = "arruda-boyce"
    mu: ModulusField
    """shear modulus of chains far from their limiting stretch"""
    lambda_m: Annotated[Any, VaryingQuantity("", above=1)]
    """limiting stretch of the chains"""

    def shear_modulus(self, par: Any) -> Any:
        slopes = [1 / 2, *(i * float(Fraction(c)) for i, c in _SERIES.items())]
        return 2 * par.mu * polynomial(3 / par.lambda_m**2, slopes)
