"""Hyperelastic materials of FEBio, whose energy is an expression, and its fibres of Holzapfel, Gasser and Ogden."""

from __future__ import annotations

import re
from typing import Any

from hpcinv.formats.cards.card import CardError, Stress, UnknownLaw
from hpcinv.formats.cards.entry import Entry

_NAME = re.compile(r"[A-Za-z_]\w*")
_FUNCTIONS = frozenset({"exp", "ln", "sqrt"})
_LONGEST = 512
_COUPLED = {"I4": "I4_f", "I5": "I5_f"}
_UNCOUPLED = {"I1": "I1_bar", "I2": "I2_bar", "I4": "(I4_f*J**(-2/3))", "I5": "(I5_f*J**(-4/3))"}


def hyperelastic_energy(law: Entry) -> tuple[str, dict[str, Any]]:
    """Return the energy of a material by its expression ``W``, along a family f, and its parameters.

    Raises:
        UnknownLaw: it has names or functions that an energy of a job has not.
    """
    text, is_uncoupled = law.values.get("W", ""), law.type.startswith("uncoupled")
    if not text or len(text) > _LONGEST:
        raise CardError(f"law {law.type}: W has {len(text)} characters, not 1 to {_LONGEST}")
    known = {"I1", "I2"} | (set() if is_uncoupled else {"J"}) | ({"I4", "I5"} if "trans-iso" in law.type else set())
    numbers = {name for name in law.values if name not in ("W", "k", "pressure_model", "density")}
    names = set(_NAME.findall(re.sub(r"\d+\.?\d*[eE][+-]?\d+", "", text)))
    if unknown := sorted(names - known - _FUNCTIONS - numbers):
        raise UnknownLaw(f"law {law.type} with {', '.join(unknown)} has no counterpart; state an energy in a job")
    replaced = _UNCOUPLED if is_uncoupled else _COUPLED
    own = {name: f"({law.number(name):.17g})" for name in numbers & names}
    energy = _NAME.sub(lambda match: own.get(match[0], replaced.get(match[0], match[0])), text).replace("^", "**")
    return f"unit*({energy})", {"unit": Stress(1.0)}


def fibres_in_a_plane(law: Entry) -> tuple[str, dict[str, Any]]:
    """Return energy and parameters of ``HGO unconstrained``, along families f and g.

    Raises:
        CardError: a number is damaged.
    """
    constants = (law.number("c"), law.number("k"))
    values: dict[str, Any] = {"k1": Stress(law.number("k1")), "k2": law.number("k2"), "d": law.number("kappa")}
    families = ("f", "g") if law.number("gamma") else ("f",)
    factor = len(families)
    terms = [f"k1/({factor}*k2)*(exp(k2*max(d*(I1 - 3) + (1 - 3*d)*(I4_{name} - 1), 0)**2) - 1)" for name in families]
    if constants[0]:
        terms.append("c/2*(I1 - 3) - c*ln(J)")
        values["c"] = Stress(constants[0])
    if constants[1]:
        terms.append("k/2*((J**2 - 1)/2 - ln(J))")
        values["k"] = Stress(constants[1])
    return " + ".join(terms), values
