"""One job's sections for several materials."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

_WORD = re.compile(r"[^\W\d]\w*")


def merged(materials: Sequence[tuple[str, Mapping[str, Any]]]) -> dict[str, Any]:
    """Return the sections ``let``, ``fibres`` and ``material`` of a job, with a law for each region.

    Definitions and families of fibres that several materials have by one name get names of their own.

    Args:
        materials: region and sections of its material.
    """
    result: dict[str, Any] = {"let": {}, "fibres": {}, "material": {}}
    for number, (region, sections) in enumerate(materials, 1):
        own = sections
        if any(result[key].get(name, value) != value for key in ("let", "fibres") for name, value in _of(own, key)):
            own = _renamed(own, f"x{number}")
        for key in ("let", "fibres"):
            result[key] |= dict(_of(own, key))
        result["material"][region] = own["material"]
    return {key: value for key, value in result.items() if value}


def _of(sections: Mapping[str, Any], key: str) -> list[tuple[str, Any]]:
    return list(sections.get(key, {}).items())


def _renamed(sections: Mapping[str, Any], suffix: str) -> dict[str, Any]:
    """Return sections whose definitions and families have longer names, also where formulas use them."""
    families, definitions = sections.get("fibres", {}), sections.get("let", {})

    def longer(match: re.Match[str]) -> str:
        word = match[0]
        is_own = word in definitions or word.partition("_")[2] in families  # such as I4_fibre
        return f"{word}{suffix}" if is_own else word

    def renamed(value: Any) -> Any:
        return _WORD.sub(longer, value) if isinstance(value, str) else value

    material = {key: renamed(value) if key == "energy" else value for key, value in sections["material"].items()}
    if "fibres" in material:
        material["fibres"] = [f"{name}{suffix}" if name in families else name for name in material["fibres"]]
    result: dict[str, Any] = {"material": material}
    if definitions:
        result["let"] = {f"{name}{suffix}": renamed(value) for name, value in definitions.items()}
    if families:
        result["fibres"] = {f"{name}{suffix}": value for name, value in families.items()}
    return result
