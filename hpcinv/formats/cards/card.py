"""A card as sections of a job, and what the programs have in common: polynomials, volumes, dispersed fibres."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from hpcinv.base.quantity.spatial_fields import is_uniform
from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.base.quantity.units import Dimension, parse_unit
from hpcinv.errors import JobError
from hpcinv.physics.materials.material_law import MaterialLaw

STRESS = parse_unit("Pa")[1]
MOST_TERMS = 6
"""Terms of a sum; Abaqus and FEBio have no more. Raised, a wrong N makes a formula that is slow to check."""


class CardError(JobError):
    """A card that cannot be read or written."""


class UnknownLaw(CardError):
    """A law, or a property of a material, without a counterpart; the message names it."""


@dataclass(frozen=True)
class Stress:
    """A number in the unit of stress of the card."""

    value: float


type Direction = Sequence[float] | str | None
"""of fibres: a vector, or the name of an array of the mesh; ``None`` where the card does not state it"""


@dataclass(frozen=True)
class Counterpart:
    """Sections of a job for the law of a card.

    Attributes:
        material: the section; stresses in it are `Stress`.
        fibres: directions by family.
        definitions: the section ``let``.
        notes: what a user should know.
    """

    material: Mapping[str, Any]
    fibres: Mapping[str, Direction] = field(default_factory=dict)
    definitions: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def section(self, unit: str) -> dict[str, Any]:
        """Return the section ``material``, with stresses in a unit."""
        return {key: _with_unit(value, unit) for key, value in self.material.items()}


@dataclass(frozen=True)
class Card:
    """A material of a file.

    Attributes:
        name: of the material; empty if the card does not state it.
        title: the law as the program names it.
        unit: of stress, if the file states its units.
    """

    name: str
    title: str
    law: Counterpart
    unit: str = ""


def _with_unit(value: Any, unit: str) -> Any:
    match value:
        case Stress():
            return f"{value.value:.15g} {unit}"
        case list():
            return [_with_unit(entry, unit) for entry in value]
        case Mapping():
            return {key: _with_unit(entry, unit) for key, entry in value.items()}
        case float():
            return float(f"{value:.15g}")
    return value


def chosen(names: Iterable[str], name: str | None) -> str:
    """Return the material that a user names, or the only one.

    Raises:
        CardError: there is none, or several.
    """
    known = list(names)
    if not known:
        raise CardError("has no material")
    if name is None:
        if len(known) > 1:
            raise CardError(f"has several materials: {', '.join(known)}; choose one with --name")
        return known[0]
    if name not in known:
        raise CardError(f"has no material '{name}'.{did_you_mean(name, known)}")
    return name


_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?")


def number(text: str, place: str) -> float:
    """Return a number of a card, whose exponent may be Fortran's ``D``.

    Raises:
        CardError: it is not a finite number.
    """
    if _NUMBER.fullmatch(text.strip()):
        value = float(text.strip().upper().replace("D", "E"))
        if math.isfinite(value):
            return value
    raise CardError(f"{place}: {text.strip()!r} is not a number")


def bulk_from(compliance: float) -> Any:
    """Return the bulk modulus ``2/D`` of Abaqus and Ansys, which write 0 for an incompressible material."""
    return "incompressible" if compliance == 0 else Stress(2 / compliance)


def polynomial(coefficients: Mapping[tuple[int, int], float], compliances: Sequence[float]) -> Counterpart:
    """Return the law ``sum Cij (I1_bar - 3)^i (I2_bar - 3)^j + sum 1/Dk (J - 1)^2k``: a named one if there is one.

    Args:
        coefficients: ``Cij`` by the powers of both invariants.
        compliances: ``Dk``; a zero stands for an incompressible material (the first), or for no term (the others).
    """
    used = {powers: value for powers, value in coefficients.items() if value}
    first, *others = compliances or [0.0]
    if not first and any(others):
        raise CardError("D1 is 0, as of an incompressible material, but another D is not")
    if not any(others) and (named := _named_polynomial(used, first)) is not None:
        return Counterpart(named)
    terms = [f"c{i}{j}{_power('I1_bar - 3', i)}{_power('I2_bar - 3', j)}" for i, j in used]
    parameters = {f"c{i}{j}": Stress(value) for (i, j), value in used.items()}
    for k, compliance in enumerate(others, start=2):
        if compliance:
            terms.append(f"e{k}*(J - 1)**{2 * k}")
            parameters[f"e{k}"] = Stress(1 / compliance)
    energy = {"energy": " + ".join(terms), "parameters": parameters, "kappa": bulk_from(first)}
    return Counterpart({"law": "formula", **energy})


def _named_polynomial(used: Mapping[tuple[int, int], float], compliance: float) -> dict[str, Any] | None:
    """Return the section of a law with these coefficients other than 0; ``None`` if it has no name."""
    c10, c20, c30, c01 = (Stress(used.get(powers, 0.0)) for powers in ((1, 0), (2, 0), (3, 0), (0, 1)))
    if used.keys() <= {(1, 0)}:
        return {"law": "isochoric-neo-hookean", "mu": Stress(2 * c10.value), "kappa": bulk_from(compliance)}
    if used.keys() <= {(1, 0), (0, 1)}:
        half = Stress(1 / compliance) if compliance else "incompressible"
        return {"law": "mooney-rivlin", "c1": c10, "c2": c01, "d1": half}
    if used.keys() <= {(1, 0), (2, 0), (3, 0)} and (1, 0) in used:
        return {"law": "yeoh", "c1": c10, "c2": c20, "c3": c30, "kappa": bulk_from(compliance)}
    return None


def _power(base: str, exponent: int) -> str:
    return "" if exponent == 0 else f"*({base})" if exponent == 1 else f"*({base})**{exponent}"


def triangle(order: int) -> list[tuple[int, int]]:
    """Return the powers of a full polynomial in the order of cards: C10, C01, C20, C11, C02, …"""
    return [(total - j, j) for total in range(1, order + 1) for j in range(total + 1)]


def dispersed_fibres(
    mu: float, k1: float, k2: float, dispersion: float, bulk: Any, directions: Mapping[str, Sequence[float] | None]
) -> Counterpart:
    """Return the law of Gasser, Ogden & Holzapfel with the isochoric invariants of fibres, as Abaqus and FEBio have it.

    Ours has the invariants of ``C``; both are the same if the volume cannot change.
    """
    if bulk == "incompressible":
        values = {"mu": Stress(mu), "k1": Stress(k1), "k2": k2, "dispersion": dispersion, "kappa": bulk}
        return Counterpart({"law": "holzapfel-gasser-ogden", **values, "fibres": list(directions)}, directions)
    energy = "mu/2*(I1_bar - 3)" + "".join(
        f" + k1/(2*k2)*(exp(k2*max(d*(I1_bar - 3) + (1 - 3*d)*(I4_{family}*J**(-2/3) - 1), 0)**2) - 1)"
        for family in directions
    )
    parameters = {"mu": Stress(mu), "k1": Stress(k1), "k2": k2, "d": dispersion}
    material = {"law": "formula", "energy": energy, "parameters": parameters, "kappa": bulk}
    note = "isochoric invariants of fibres: law holzapfel-gasser-ogden has I4 and I6 of C, and differs where J is not 1"
    return Counterpart({**material, "volumetric": "simo-taylor"}, directions, notes=(note,))


@dataclass(frozen=True)
class Values:
    """Numbers of a law, with stresses in the unit of a card that is written.

    Attributes:
        program: for messages.
        size: of the unit, in Pa.
    """

    law: MaterialLaw
    program: str
    size: float

    def __post_init__(self) -> None:
        entries = [value for value, _ in self.law.quantities().values()]
        flat = [e for value in entries for e in (value if isinstance(value, tuple) else (value,))]
        if not all(is_uniform(entry) for entry in flat):
            raise self.refusal("its parameters vary over the body; a card has one number for each")

    def __getitem__(self, name: str) -> Any:
        value, dimension = self.law.quantities()[name]
        return (
            tuple(self._in_unit(v, dimension) for v in value)
            if isinstance(value, tuple)
            else self._in_unit(value, dimension)
        )

    def _in_unit(self, value: float, dimension: Dimension) -> float:
        return value / self.size if dimension == STRESS else value

    @property
    def kind(self) -> str:
        """The name of the law in a job."""
        return str(self.law.law)  # type: ignore[attr-defined]

    def writer[T](self, writers: Mapping[str, T], reason: str) -> T:
        """Return what writes this law; ``UnknownLaw`` with the reason if nothing does."""
        if self.kind not in writers:
            raise self.refusal(reason)
        return writers[self.kind]

    def refusal(self, reason: str) -> UnknownLaw:
        return UnknownLaw(f"law '{self.kind}' has no counterpart in {self.program}: {reason}")

    @property
    def is_incompressible(self) -> bool:
        return self.law.is_incompressible

    @property
    def bulk(self) -> float:
        """The bulk modulus, finite."""
        return float(self.law.bulk_modulus(_Numbers(self)))

    def require(self, volumetric: str) -> None:
        """Raise `UnknownLaw` unless the volumetric energy is of one kind, or the material is incompressible."""
        own = getattr(self.law, "volumetric", None)
        if not self.is_incompressible and own != volumetric:
            raise self.refusal(f"its volumetric energy there is '{volumetric}', not '{own}'")

    def compliance(self, volumetric: str = "quadratic") -> float:
        """Return ``D = 2/K`` of Abaqus and Ansys, 0 if the material is incompressible."""
        self.require(volumetric)
        return 0.0 if self.is_incompressible else 2 / self.bulk


class _Numbers:
    """The numbers of a law as attributes, for its moduli."""

    def __init__(self, values: Values) -> None:
        self._values = values

    def __getattr__(self, name: str) -> Any:
        return self._values[name]


def shown(value: float) -> str:
    """Return a number of a card."""
    return f"{value:.15g}"
