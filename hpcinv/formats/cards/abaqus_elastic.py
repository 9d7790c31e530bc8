"""``*ELASTIC`` of Abaqus and CalculiX with axes of its own. Source: *Abaqus Keywords Guide*, ``*ELASTIC``."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hpcinv.base.reading.abaqus_keywords import Keyword
from hpcinv.formats.cards.card import CardError, Counterpart, UnknownLaw, number
from hpcinv.formats.cards.orthotropic import FAMILIES, orthotropic, stiffness_of

_ISOTROPIC = ("ISO", "ISOTROPIC")
_KINDS = {
    "ENGINEERING CONSTANTS": "ENGINEERING CONSTANTS",
    "ORTHO": "ORTHOTROPIC",
    "ORTHOTROPIC": "ORTHOTROPIC",
    "ANISO": "ANISOTROPIC",
    "ANISOTROPIC": "ANISOTROPIC",
}
_NORMAL = {(0, 0): 0, (0, 1): 1, (1, 1): 2, (0, 2): 3, (1, 2): 4, (2, 2): 5}
"""place of the stiffness of two normal strains"""
_SHEAR_OF_ANISOTROPIC = (9, 14, 20)  # D1212, D1313, D2323


def is_isotropic(keyword: Keyword) -> bool:
    return _kind(keyword) in _ISOTROPIC


def _kind(keyword: Keyword) -> str:
    return " ".join(keyword.options.get("TYPE", "ISOTROPIC").upper().split())


def elastic_law(keyword: Keyword) -> tuple[str, Counterpart]:
    """Return title and counterpart of a law that is not isotropic; its axes are the axes of an ``*ORIENTATION``.

    Raises:
        UnknownLaw: it has no counterpart.
        CardError: it is damaged, or unstable.
    """
    kind = _kind(keyword)
    title = f"*ELASTIC, TYPE={kind}"
    if kind not in _KINDS:
        raise UnknownLaw(f"{title} has no counterpart")
    count = 21 if _KINDS[kind] == "ANISOTROPIC" else 9
    if len(keyword.lines) > -(-(count + 1) // 8):
        raise UnknownLaw(f"{title} depends on temperature; keep its first {count} constants")
    constants = [number(entry or "0", title) for line in keyword.lines for entry in line]
    if len(constants) not in (count, count + 1):  # a temperature may follow
        raise CardError(f"{title} has {len(constants)} constants, not {count}")
    if _KINDS[kind] == "ENGINEERING CONSTANTS":
        e1, e2, e3, v12, v13, v23, g12, g13, g23 = constants[:9]
        stiffness = stiffness_of((e1, e2, e3), v12, v13, v23)
    else:
        stiffness = np.zeros((3, 3))
        for (i, j), place in _NORMAL.items():
            stiffness[i, j] = stiffness[j, i] = constants[place]
        g12, g13, g23 = _shears_of_anisotropic(constants, title) if count == 21 else constants[6:9]
    return title, orthotropic(stiffness, (g12, g23, g13), dict.fromkeys(FAMILIES))


def _shears_of_anisotropic(constants: Sequence[float], title: str) -> list[float]:
    """Return the shear moduli G12, G13 and G23 of the 21 constants of an anisotropic law without coupled shears."""
    if any(c for at, c in enumerate(constants[:21]) if at > 5 and at not in _SHEAR_OF_ANISOTROPIC):
        raise UnknownLaw(f"{title} with coupled shears has no counterpart; state an energy by 'law: formula'")
    return [constants[at] for at in _SHEAR_OF_ANISOTROPIC]
