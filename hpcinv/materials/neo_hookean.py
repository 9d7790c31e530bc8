"""Compressible neo-Hookean."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

from pydantic import ConfigDict, model_validator

from hpcinv.materials.lame import LameLaw
from hpcinv.quantities import Dimension, Dimensionless, Stress
from hpcinv.scalars import Number
from hpcinv.schema import Location, Spec, raise_if_any
from hpcinv.varying import LameField, StressField

if TYPE_CHECKING:
    from hpcinv.kinematics import Deformation


class YoungPoisson(Spec):
    """Young's modulus and Poisson's ratio, in place of Lamé's parameters."""

    law: Literal["neo-hookean"] = "neo-hookean"
    young: Stress
    """Young's modulus of the undeformed material"""
    poisson: Dimensionless
    """Poisson's ratio of the undeformed material, above -1 and up to 0.5 (incompressible)"""

    @model_validator(mode="after")
    def _is_stable(self) -> Self:
        raise_if_any(
            ((key,), f"must be {bounds}, not {getattr(self, key):g}")
            for key, bounds, good in (
                ("young", "positive", self.young > 0),
                ("poisson", "above -1 and at most 0.5", -1 < self.poisson <= 0.5),
            )
            if not good
        )
        return self

    @property
    def mu(self) -> float:
        return self.young / (2 * (1 + self.poisson))

    @property
    def lam(self) -> float:
        return 2 * self.mu * self.poisson / (1 - 2 * self.poisson) if self.poisson < 0.5 else math.inf


def _offer_both_pairs(schema: dict[str, Any]) -> None:
    other = YoungPoisson.model_json_schema()
    schema["oneOf"] = [{"required": pair["required"]} for pair in (schema, other)]
    schema["properties"] = other["properties"] | schema["properties"]
    del schema["required"]


class NeoHookean(LameLaw):
    """Compressible neo-Hookean.

    ``psi = mu/2 (I1 - 3) - mu ln J + lam/2 (ln J)²``; ``kappa = lam + 2/3 mu``.

    Instead of Lamé's ``mu`` and ``lam`` a job may give ``young`` and ``poisson``.

    Source: Mazier et al. (2022), eq. 22, doi:10.1007/s00366-021-01597-z.
    """

    model_config = ConfigDict(json_schema_extra=_offer_both_pairs)

    formula = "mu/2*(I1 - 3) - mu*ln(J)"
    example: ClassVar = {"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"}

    law: Literal["neo-hookean"] = "neo-hookean"
    mu: StressField
    """Lamé's second parameter, the shear modulus (or give young and poisson)"""
    lam: LameField
    """Lamé's first parameter, or 'incompressible' (or give young and poisson)"""

    @model_validator(mode="before")
    @classmethod
    def _from_young_and_poisson(cls, data: Any) -> Any:
        if not isinstance(data, Mapping) or not {"young", "poisson"} & data.keys():
            return data
        raise_if_any(
            ((key,), "give either mu and lam, or young and poisson, not a mixture of them")
            for key in ("mu", "lam")
            if key in data
        )
        given = YoungPoisson.model_validate(data)
        return {"law": given.law, "mu": given.mu, "lam": given.lam}

    @property
    def volumetric_formula(self) -> str:
        return "lam/2*ln(J)**2"

    def numbers(self) -> dict[Location, Number | str]:
        """Young's modulus and Poisson's ratio too, whichever pair the job gives; each with the other as it is."""
        found = super().numbers()
        mu, lam = found.get(("mu",)), found.get(("lam",))
        if isinstance(mu, Number) and (isinstance(lam, Number) or self.is_incompressible):
            ratio = lam.value / (2 * (lam.value + mu.value)) if isinstance(lam, Number) else 0.5
            found["young",] = Number(2 * mu.value * (1 + ratio), mu.dimension)
            found["poisson",] = "is 0.5, the end of its range" if ratio == 0.5 else Number(ratio, Dimension())
        return found

    def rates(self, place: Location) -> dict[str, tuple[Any, Dimension]]:
        if place not in (("young",), ("poisson",)):
            return super().rates(place)
        numbers = self.numbers()
        young, poisson = numbers["young",], numbers["poisson",]
        assert isinstance(young, Number)
        if place == ("young",):
            rates = {"mu": self.mu / young.value, "lam": self.lam / young.value}
        else:
            assert isinstance(poisson, Number)
            nu = poisson.value
            by_lam = young.value * (1 + 2 * nu**2) / ((1 + nu) * (1 - 2 * nu)) ** 2
            rates = {"mu": -self.mu / (1 + nu), "lam": by_lam}
        dimensions = {name: dimension for name, (_, dimension) in self.quantities().items()}
        return {name: (found, dimensions[name]) for name, found in rates.items() if math.isfinite(found)}

    def distortion(self, k: Deformation, par: Any) -> Any:
        return par.mu / 2 * k.I1_minus_3_minus_2_ln_J

    def dilatation(self, k: Deformation) -> Any:
        return k.ln_J
