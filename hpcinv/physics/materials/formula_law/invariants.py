"""Invariants of energy formulas, as jets.

Their names are ``I1, I2, J``; ``I1_bar, I2_bar`` of ``J^(-2/3) C``; of a family ``f`` of fibres ``I4_f = a0·C a0`` and
``I5_f = a0·C² a0``; of two families ``I8_f_s = a0·(C - I) b0``. The strains of the jets are ``E`` for ``tr E``, ``E_f``
for ``a0·E a0`` and ``E_f_s`` for ``a0·E b0``.
"""

from __future__ import annotations

import keyword
import math
import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from functools import cached_property
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from hpcinv.physics.materials.formula_law.coefficients import Coefficient
from hpcinv.physics.materials.formula_law.jet import Jet, Strains

if TYPE_CHECKING:
    from hpcinv.physics.kinematics.kinematics import Deformation

ISOTROPIC = ("I1", "I2", "J", "I1_bar", "I2_bar")
_OF_FIBRES = re.compile(r"I[45]_([A-Za-z][A-Za-z0-9]*)|I8_([A-Za-z][A-Za-z0-9]*)_([A-Za-z][A-Za-z0-9]*)")


def families_in(name: str) -> tuple[str, ...] | None:
    """Return families of fibres of an invariant, none if it is isotropic; ``None`` if the name is not an invariant."""
    if name in ISOTROPIC:
        return ()
    match = _OF_FIBRES.fullmatch(name)
    return tuple(family for family in match.groups() if family) if match else None


def fault_of_name(name: str, taken: Collection[str]) -> str | None:
    """Reason why a parameter or a definition cannot have this name in formulas, or ``None``."""
    if name in taken or families_in(name) is not None:
        return "is already the name of something else; 'hpcinv formulas' lists the reserved names"
    if not name.isidentifier() or keyword.iskeyword(name) or name.startswith("_"):
        return "cannot be a name in a formula; choose a name of letters, digits and _"
    return None


def invariants(
    names: Iterable[str],
    k: Deformation | PrincipalStretches,
    strains: Strains,
    families: Mapping[str, str] | None = None,
) -> dict[str, Jet]:
    """Return the invariants of a deformation among the names.

    Args:
        strains: receives the strains of the deformation in its ``values``.
        families: families of fibres by their names in the invariants; ``None`` if these are the names of the families.
    """
    mentions = ((name, families_in(name)) for name in sorted(names))
    return {
        name: _invariant(name, tuple(f if families is None else families[f] for f in mentioned), k, strains)
        for name, mentioned in mentions
        if mentioned is not None
    }


def _invariant(name: str, families: tuple[str, ...], k: Any, strains: Strains) -> Jet:
    literal = Coefficient.literal

    def jet(constant: float, slope: float, strain: str, value: Any, remainder: Any = 0.0, positive: bool = True) -> Jet:
        strains.values[strain] = value
        return Jet(strains, literal(constant), {strain: literal(slope)}, remainder, 2, positive)

    match name.split("_")[0], *families:
        case "I4", f:
            return jet(1.0, 2.0, f"E_{f}", k.fibre(f).E_aa)
        case "I5", f:
            return jet(1.0, 4.0, f"E_{f}", k.fibre(f).E_aa, 4 * (k.E * k.fibre(f).direction) ** 2)
        case "I8", f, s:
            return jet(0.0, 2.0, "_".join(["E", *sorted((f, s))]), k.I8(f, s) / 2, positive=False)
    match name:
        case "I1":
            return jet(3.0, 2.0, "E", k.I1_minus_3 / 2)
        case "I2":
            return jet(3.0, 4.0, "E", k.I1_minus_3 / 2, k._second_of_E)
        case "J":
            J = jet(1.0, 1.0, "E", k.I1_minus_3 / 2, -k._trE_minus_J_minus_1)
            return replace(J, exact_change=k.J_minus_1)
    remainder = k.I1_bar_minus_3 if name == "I1_bar" else k.I2_bar_minus_3
    return Jet(strains, literal(3.0), {}, remainder, 2, is_positive=True)


class PrincipalStretches:
    """A deformation with the principal stretches ``exp(e)`` in floats, without strain of the fibres.

    It serves to compute small-strain moduli without UFL and NumPy.
    """

    E = 0.0

    def __init__(self, *e: float) -> None:
        self._e = e
        self._mean = sum(e) / 3

    @cached_property
    def I1_minus_3(self) -> float:
        return sum(math.expm1(2 * e) for e in self._e)

    @property
    def I1_bar_minus_3(self) -> float:
        return sum(math.expm1(2 * (e - self._mean)) for e in self._e)

    @property
    def I2_bar_minus_3(self) -> float:
        return sum(math.expm1(2 * (self._mean - e)) for e in self._e)

    @property
    def J_minus_1(self) -> float:
        return math.expm1(3 * self._mean)

    @property
    def _trE_minus_J_minus_1(self) -> float:
        return self.I1_minus_3 / 2 - self.J_minus_1

    @property
    def _second_of_E(self) -> float:
        return (self.I1_minus_3**2 - sum(math.expm1(2 * e) ** 2 for e in self._e)) / 2

    def fibre(self, family: str) -> Any:
        return SimpleNamespace(E_aa=0.0, direction=0.0)

    def I8(self, family: str, other: str) -> float:
        return 0.0
