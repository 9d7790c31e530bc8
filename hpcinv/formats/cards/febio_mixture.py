"""Solid mixtures of FEBio, whose stresses add up, and the fibres in them; energies of its source (``FEBioMech``)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import isfinite
from typing import Any

from hpcinv.base.quantity.schema import members_of
from hpcinv.formats.cards.card import Counterpart, Stress, UnknownLaw
from hpcinv.formats.cards.entry import Entry
from hpcinv.formats.cards.formula_names import renamed
from hpcinv.physics.materials import MaterialLaw
from hpcinv.physics.materials.isochoric import IsochoricLaw
from hpcinv.physics.materials.lame import LameLaw
from hpcinv.physics.materials.moduli import shear_and_bulk
from hpcinv.physics.materials.mooney_rivlin import MooneyRivlin


def sum_of(parts: Sequence[tuple[str, Counterpart]]) -> Counterpart:
    """Return the law whose energy is the sum of the energies of others; one of them may be uncoupled.

    Args:
        parts: type, for messages, and law.

    Raises:
        UnknownLaw: the energy of one is not a formula of the whole deformation.
    """
    volumes = {kind: volume for kind, part in parts if (volume := _volume(part))}
    if len(volumes) > 1 or sum(kind in volumes for kind, _ in parts) > 1:
        raise UnknownLaw(f"law solid mixture of several uncoupled solids ({', '.join(volumes)}) has no counterpart")
    return _sum(parts, _formula, next(iter(volumes.values()), {}))


def isochoric_sum_of(parts: Sequence[tuple[str, Counterpart]]) -> Counterpart:
    """Return the law whose isochoric energy is the sum of others'; its volumetric energy is left to the mixture.

    Raises:
        UnknownLaw: a law has no isochoric energy.
    """
    return _sum(parts, _isochoric_formula, {})


def _volume(part: Counterpart) -> dict[str, Any]:
    """Return bulk modulus and volumetric energy of an uncoupled law; empty for others."""
    material = part.material
    kappa = Stress(2 * material["d1"].value) if "d1" in material else material.get("kappa")
    return {} if kappa is None else {"kappa": kappa, "volumetric": material.get("volumetric", "quadratic")}


def _sum(
    parts: Sequence[tuple[str, Counterpart]],
    formula: Callable[[str, Counterpart], tuple[str, Mapping[str, Any]]],
    volume: Mapping[str, Any],
) -> Counterpart:
    energies: list[str] = []
    parameters: dict[str, Any] = {}
    fibres: dict[str, Any] = {}
    definitions: dict[str, str] = {}
    notes: list[str] = []
    for number, (kind, part) in enumerate(parts, 1):
        energy, own = formula(kind, part)
        names = {name: f"{name}{number}" for name in (*own, *part.definitions)}
        families = {name: f"{name}{number}" for name in part.fibres}
        energies.append(renamed(energy, names, families))
        parameters |= {names[name]: value for name, value in own.items()}
        fibres |= {families[name]: direction for name, direction in part.fibres.items()}
        definitions |= {names[name]: renamed(text, names, families) for name, text in part.definitions.items()}
        notes += part.notes
    material = {"law": "formula", "energy": " + ".join(energies), "parameters": parameters, **volume}
    return Counterpart(material, fibres, definitions, tuple(notes))


def _formula(kind: str, part: Counterpart) -> tuple[str, Mapping[str, Any]]:
    """Return energy and parameters of a law."""
    material = part.material
    if _volume(part):
        return _isochoric_formula(kind, part)
    if material["law"] == "formula":
        return material["energy"], material["parameters"]
    law = members_of(MaterialLaw, "law")[material["law"]]
    if not issubclass(law, LameLaw):
        raise UnknownLaw(f"law solid mixture of {kind} has no counterpart; state an energy in a job, by 'law: formula'")
    mu, kappa = shear_and_bulk({"young": material["young"].value, "poisson": material["poisson"]})
    if not isfinite(kappa):
        raise UnknownLaw(f"law solid mixture of an incompressible {kind} has no counterpart")
    moduli = {"mu": mu, "lam": kappa - 2 / 3 * mu}
    energy = law.model_validate({"law": material["law"], **moduli}).energy_formula
    return energy, {name: Stress(value) for name, value in moduli.items()}


def _isochoric_formula(kind: str, part: Counterpart) -> tuple[str, Mapping[str, Any]]:
    """Return isochoric energy and parameters of an uncoupled law."""
    own = {name: value for name, value in part.material.items() if name not in ("law", "kappa", "d1", "volumetric")}
    if part.material["law"] == "formula":
        return own["energy"], own["parameters"]
    law = members_of(MaterialLaw, "law")[part.material["law"]]
    is_plain = all(isinstance(value, Stress | float) for value in own.values()) and not part.fibres
    if not is_plain or not issubclass(law, IsochoricLaw | MooneyRivlin):
        raise UnknownLaw(
            f"law uncoupled solid mixture of {kind} has no counterpart; state an energy in a job, by 'law: formula'"
        )
    values = {name: value.value if isinstance(value, Stress) else value for name, value in part.material.items()}
    return law.model_validate(values).own_formula, own


def exponential_fibres(law: Entry) -> tuple[str, dict[str, Any]]:
    """Return energy and parameters of ``fiber-exp-pow``, along a family f; uncoupled, of its isochoric stretch."""
    if law.number("mu", 0.0):
        raise UnknownLaw("law fiber-exp-pow with mu has no counterpart; state an energy in a job, by 'law: formula'")
    alpha, beta, start = law.number("alpha", 0.0), law.number("beta", 2.0), law.number("lam0", 1.0)
    stretch = "I4_f*J**(-2/3)" if law.type.endswith("-uncoupled") else "I4_f"
    power = f"max({stretch} - {start**2:.17g}, 0)**{beta:.17g}"
    energy = f"ksi/(alpha*beta)*(exp(alpha*{power}) - 1)" if alpha else f"ksi/beta*{power}"
    values = {"ksi": Stress(law.number("ksi", 0.0)), "beta": beta}
    return energy, values | ({"alpha": alpha} if alpha else {})


def toe_fibres(law: Entry) -> tuple[str, dict[str, Any]]:
    """Return energy and parameters of ``fiber-pow-linear``, whose stress is a power of the strain and then linear."""
    if law.number("tension_only", 1.0) == 0:
        raise UnknownLaw("law fiber-pow-linear with compression has no counterpart; state an energy in a job")
    young, start, beta = law.number("E"), law.number("lam0"), law.number("beta", 2.0)
    if start <= 1:
        raise UnknownLaw(f"law fiber-pow-linear with lam0 {start:g} has no counterpart; it must be above 1")
    square = start**2
    ksi = young / 4 / (beta - 1) * square**-1.5 * (square - 1) ** (2 - beta)
    values = {"ksi": Stress(ksi), "beta": beta, "b": Stress(ksi * (square - 1) ** (beta - 1) + young / 2 / start)}
    strain = f"min(max(I4_f - 1, 0), {square - 1:.17g})"
    energy = (
        f"ksi/beta*{strain}**{beta:.17g} + b*max(I4_f - {square:.17g}, 0)"
        f" - e*(sqrt(max(I4_f, {square:.17g})) - {start:.17g})"
    )
    return energy, values | {"e": Stress(young)}
