"""Thermal expansion in CalculiX: ``*EXPANSION`` of the materials and the temperature of the nodes.

A body that is free expands by ``1 + alpha ΔT`` in both programs. A body that is held has another stress in CalculiX
2.20: by ``2 (alpha ΔT)²`` of it (2e-4 at 1 %, 2 % at 10 %; block between two plates).

Source: Dhondt, *CalculiX CrunchiX User's Manual*, ``*EXPANSION``, ``*TEMPERATURE``.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from hpcinv.formats.inp import number
from hpcinv.studies.second_opinion.loaded_body import LoadedBody

LARGEST_STRAIN = 0.015
"""Thermal strain up to which stresses differ by 5e-4. Raised, both programs differ by their meaning of it."""


def add_expansion(body: LoadedBody, effect: Any, place: str) -> str | None:
    """Add thermal expansion, or return why it cannot be said."""
    coefficient, change = float(effect.coefficient), float(effect.temperature_change)
    if body.expansion:
        return "'thermal-expansion' is there twice"
    if abs(strain := coefficient * change) > LARGEST_STRAIN:
        text = (
            f"'thermal-expansion' by {strain:.2g} is another strain in CalculiX, which agrees up to {LARGEST_STRAIN:g}"
        )
        return f"{text}; Abaqus has no tested counterpart"
    body.expansion = coefficient, change
    body.notes.append(f"{place}: stresses of held parts differ by {2 * strain**2:.1g} of them, 2 (alpha ΔT)^2")
    return None


def expansion_lines(body: LoadedBody) -> Iterator[str]:
    """Yield the expansion of a material; nothing without one."""
    if body.expansion:
        yield f"*EXPANSION, ZERO=0.\n{number(body.expansion[0])}\n"


def first_temperature(body: LoadedBody, nodes: str) -> Iterator[str]:
    """Yield the temperature of a set of nodes at rest."""
    if body.expansion:
        yield f"*INITIAL CONDITIONS, TYPE=TEMPERATURE\n{nodes}, 0.\n"


def last_temperature(body: LoadedBody, nodes: str) -> Iterator[str]:
    """Yield the temperature of a set of nodes at the end of the step."""
    if body.expansion:
        yield f"*TEMPERATURE\n{nodes}, {number(body.expansion[1])}\n"
