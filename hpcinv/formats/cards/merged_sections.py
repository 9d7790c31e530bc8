"""One job's sections for several materials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hpcinv.formats.cards.formula_names import renamed


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
    families = {name: f"{name}{suffix}" for name in sections.get("fibres", {})}
    names = {name: f"{name}{suffix}" for name in sections.get("let", {})}

    def new(value: Any) -> Any:
        return renamed(value, names, families) if isinstance(value, str) else value

    material = {key: new(value) if key == "energy" else value for key, value in sections["material"].items()}
    if "fibres" in material:
        material["fibres"] = [families.get(name, name) for name in material["fibres"]]
    result: dict[str, Any] = {"material": material}
    if names:
        result["let"] = {names[name]: new(value) for name, value in sections["let"].items()}
    if families:
        result["fibres"] = {families[name]: value for name, value in sections["fibres"].items()}
    return result
