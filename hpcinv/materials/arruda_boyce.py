"""Arruda–Boyce."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from hpcinv.kinematics.stable_functions import polynomial
from hpcinv.materials.base import StartingValues
from hpcinv.materials.isochoric import IsochoricLaw
from hpcinv.quantity.spatial_fields import ModulusField, VaryingQuantity

_SERIES = (1 / 2, 1 / 20, 11 / 1050, 19 / 7000, 519 / 673750)  # of the inverse Langevin function, integrated


class ArrudaBoyce(IsochoricLaw):
    """Arruda–Boyce, the network of eight chains, by five terms of the series of the inverse Langevin function.

    The small-strain shear modulus is larger than ``mu``: ``2 mu Σ i cᵢ (3/lambda_m²)^(i-1)``, with the factors ``cᵢ``
    of the series.

    Source: Arruda & Boyce (1993), doi:10.1016/0022-5096(93)90013-6.
    """

    formula = (
        "mu*(1/2*(I1_bar - 3) + 1/20/lambda_m**2*(I1_bar**2 - 9) + 11/1050/lambda_m**4*(I1_bar**3 - 27)"
        " + 19/7000/lambda_m**6*(I1_bar**4 - 81) + 519/673750/lambda_m**8*(I1_bar**5 - 243))"
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
    """shear modulus of chains that are far from being stretched out"""
    lambda_m: Annotated[Any, VaryingQuantity("", above=1)]
    """stretch at which the chains are stretched out"""

    def shear_modulus(self, par: Any) -> Any:
        slopes = [i * c for i, c in enumerate(_SERIES, start=1)]
        return 2 * par.mu * polynomial(3 / par.lambda_m**2, slopes)
