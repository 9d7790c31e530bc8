"""Elastic moduli of an isotropic material; any two determine the others."""

from collections.abc import Callable, Mapping
from math import inf, isinf, sqrt
from typing import Any

from pydantic import field_validator

from hpcinv.base.quantity import BulkStress, Dimensionless, Stress
from hpcinv.base.quantity.docstrings import meanings
from hpcinv.base.quantity.schema import Spec


class Moduli(Spec):
    """Elastic moduli (Pa) of the undeformed material that a job may give instead of a law's own parameters."""

    young: Stress | None = None
    """Young's modulus of the undeformed material"""
    poisson: Dimensionless | None = None
    """Poisson's ratio of the undeformed material, above -1 and up to 0.5 (incompressible)"""
    shear_modulus: Stress | None = None
    """shear modulus of the undeformed material"""
    bulk_modulus: BulkStress | None = None
    """bulk modulus of the undeformed material, or 'incompressible'"""
    lame: BulkStress | None = None
    """Lamé's first parameter of the undeformed material, or 'incompressible'"""

    @field_validator("young", "shear_modulus", "bulk_modulus")
    @classmethod
    def _is_positive(cls, modulus: float | None) -> float | None:
        if modulus is not None and modulus <= 0:
            raise ValueError(f"must be positive, not {modulus:g}")
        return modulus

    @field_validator("poisson")
    @classmethod
    def _is_admissible(cls, ratio: float | None) -> float | None:
        if ratio is not None and not -1 < ratio <= 0.5:
            raise ValueError(f"must be above -1 and at most 0.5, not {ratio:g}")
        return ratio


NAMES = tuple(Moduli.model_fields)


def shear_and_bulk(given: Mapping[str, float]) -> tuple[float, float]:
    """Return shear and bulk modulus (Pa) from any two moduli; the latter is infinite for an incompressible material.

    Args:
        given: two moduli by their names in `Moduli`.

    Raises:
        ValueError: if the two do not determine the others, or contradict each other.
    """
    first, second = sorted(given, key=NAMES.index)
    a, b = given[first], given[second]
    pair = f"{first} = {a:g} and {second} = {b:g}"
    try:
        mu, kappa = _FROM[first, second](a, b)
    except ZeroDivisionError:
        raise ValueError(f"{pair} do not determine the other moduli") from None
    if not (0 < mu < inf and kappa > 0):
        text = f"a shear modulus of {mu:g} Pa and a bulk modulus of {kappa:g} Pa"
        raise ValueError(f"{pair} give {text}, which must both be positive")
    return mu, kappa


def bulk_of(mu: float, poisson: float) -> float:
    """Return the bulk modulus from the shear modulus and Poisson's ratio."""
    return 2 * mu * (1 + poisson) / (3 * (1 - 2 * poisson)) if poisson < 0.5 else inf


def young_and_poisson(mu: float, kappa: float) -> tuple[float, float]:
    """Return Young's modulus (Pa) and Poisson's ratio from the shear and the bulk modulus."""
    if isinf(kappa):
        return 3 * mu, 0.5
    return 9 * kappa * mu / (3 * kappa + mu), (3 * kappa - 2 * mu) / (2 * (3 * kappa + mu))


def slopes(name: str, mu: float, kappa: float) -> tuple[float, float]:
    """Return the derivatives of a modulus by the shear and the bulk modulus; the latter must be finite."""
    whole = 3 * kappa + mu
    return {
        "young": (27 * kappa**2 / whole**2, 9 * mu**2 / whole**2),
        "poisson": (-9 * kappa / (2 * whole**2), 9 * mu / (2 * whole**2)),
        "shear_modulus": (1.0, 0.0),
        "bulk_modulus": (0.0, 1.0),
        "lame": (-2 / 3, 1.0),
    }[name]


def rates(varied: str, fixed: str, mu: float, kappa: float) -> tuple[float, float]:
    """Return the derivatives of the shear and the bulk modulus by one modulus with another one fixed."""
    (a, b), (c, d) = slopes(varied, mu, kappa), slopes(fixed, mu, kappa)
    determinant = a * d - b * c
    return d / determinant, -c / determinant


def _young_and_bulk(young: float, kappa: float) -> tuple[float, float]:
    return (young / 3 if isinf(kappa) else 3 * kappa * young / (9 * kappa - young)), kappa


def _young_and_shear(young: float, mu: float) -> tuple[float, float]:
    return mu, inf if young == 3 * mu else mu * young / (3 * (3 * mu - young))


def _young_and_lame(young: float, lame: float) -> tuple[float, float]:
    if isinf(lame):
        return young / 3, inf
    mu = (young - 3 * lame + sqrt(young**2 + 9 * lame**2 + 2 * young * lame)) / 4
    return mu, lame + 2 / 3 * mu


def _poisson_and_bulk(poisson: float, kappa: float) -> tuple[float, float]:
    if isinf(kappa) or poisson == 0.5:
        raise ZeroDivisionError
    return 3 * kappa * (1 - 2 * poisson) / (2 * (1 + poisson)), kappa


def _poisson_and_lame(poisson: float, lame: float) -> tuple[float, float]:
    if isinf(lame) or poisson == 0.5:
        raise ZeroDivisionError
    mu = lame * (1 - 2 * poisson) / (2 * poisson)
    return mu, lame + 2 / 3 * mu


def _young_and_poisson(young: float, poisson: float) -> tuple[float, float]:
    mu = young / (2 * (1 + poisson))
    return mu, bulk_of(mu, poisson)


_FROM: dict[tuple[str, str], Callable[[float, float], tuple[float, float]]] = {
    ("young", "poisson"): _young_and_poisson,
    ("young", "shear_modulus"): _young_and_shear,
    ("young", "bulk_modulus"): _young_and_bulk,
    ("young", "lame"): _young_and_lame,
    ("poisson", "shear_modulus"): lambda poisson, mu: (mu, bulk_of(mu, poisson)),
    ("poisson", "bulk_modulus"): _poisson_and_bulk,
    ("poisson", "lame"): _poisson_and_lame,
    ("shear_modulus", "bulk_modulus"): lambda mu, kappa: (mu, kappa),
    ("shear_modulus", "lame"): lambda mu, lame: (mu, lame + 2 / 3 * mu),
    ("bulk_modulus", "lame"): lambda kappa, lame: (1.5 * (kappa - lame), kappa),
}


def moduli_schema() -> dict[str, Any]:
    """Return the JSON schema of the moduli as keys of a law."""
    properties = Moduli.model_json_schema()["properties"]
    for name, text in meanings(Moduli).items():
        properties[name] = {**properties[name]["anyOf"][0], "description": text}
    return dict(properties)
