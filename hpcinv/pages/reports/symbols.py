"""Symbols of supports and loads on the boundary of a body."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hpcinv.base.quantity.quantity import quantities_of
from hpcinv.base.quantity.written_units import as_shown
from hpcinv.output.surfaces.boundary_surface import Boundary
from hpcinv.physics.effects import effects

_EACH = 60  # symbols of one support or load
_HIDDEN = ("effect", "region", "case", "constants", "fix")


def symbols(
    job: Mapping[str, Any], state: Mapping[str, Any], boundary: Boundary, units: Mapping[str, str] | None = None
) -> list[dict[str, Any]]:
    """Return the supports and loads of a state as plain data.

    Each has ``kind`` (support or load), ``label``, ``rows`` (triangles with a symbol), ``fixed`` (axes of a support),
    ``vector`` (direction in space, ``None`` for one along the normal into the body), and ``body`` (whether it acts in
    the volume).

    Args:
        job: the summary's, with its defaults filled in (SI).
        state: supports and effects of the state instead of the job's.
        units: by SI unit the symbol of the unit in which values are shown.
    """
    drawn = [_support(support, boundary) for support in state.get("supports") or job.get("supports") or ()]
    for effect in state.get("effects") or job.get("effects") or ():
        load = _load(effect, boundary, units or {})
        load["label"] += _found_in(effect, job.get("cavities") or {})
        drawn.append(load)
    return drawn


def _found_in(effect: Mapping[str, Any], cavities: Mapping[str, Any]) -> str:
    """Return the end of the label of a pressure that the solve finds; "" for other loads."""
    if effect["effect"] != "pressure" or effect.get("pressure"):
        return ""
    names = [name for name, cavity in cavities.items() if effect["region"] in _surfaces(cavity)]
    return "".join(f": found, in cavity {name}" for name in names)


def _support(support: Mapping[str, Any], boundary: Boundary) -> dict[str, Any]:
    moved = support.get("displacement")
    fixed = support.get("fix") or [axis for axis, part in zip("xyz", moved or (), strict=False) if part is not None]
    label = f"support {support['region']}: {'moves ' if moved else 'holds '}{', '.join(fixed)}"
    rows = boundary.spread(support["region"], _EACH).tolist()
    return {"kind": "support", "label": label, "rows": rows, "fixed": fixed}


def _surfaces(cavity: Mapping[str, Any]) -> list[str]:
    """Regions of the boundary around a cavity."""
    surface, lid = cavity["surface"], cavity.get("lid")
    region = lid.get("region") if isinstance(lid, Mapping) else None
    return [*([surface] if isinstance(surface, str) else surface), *([region] if region else [])]


def _load(effect: Mapping[str, Any], boundary: Boundary, symbols: Mapping[str, str]) -> dict[str, Any]:
    vector = next((v for v in map(_numbers, map(effect.get, ("acceleration", "traction", "moment"))) if v), None)
    region, is_on_surface = effect.get("region"), "region" in effect
    rows = boundary.spread(region, _EACH).tolist() if region else []
    kind = effects().get(effect["effect"])
    dimensions = quantities_of(kind) if kind else {}
    units = {name: dimension.unit for name, dimension in dimensions.items()}
    given = ", ".join(
        f"{name} {_text(value, units.get(name, ''), symbols)}"
        for name, value in effect.items()
        if name not in _HIDDEN and value
    )
    label = f"{effect['effect']}{f' on {region}' if region else ''}{f': {given}' if given else ''}"
    return {"kind": "load", "label": label, "rows": rows, "vector": vector, "body": not is_on_surface}


def _numbers(value: Any) -> list[float] | None:
    if (
        isinstance(value, Sequence)
        and len(value) == 3
        and all(isinstance(component, int | float) for component in value)
    ):
        length = float(np.linalg.norm(value))
        return [component / length for component in value] if length else None
    return None


def _text(value: Any, unit: str, symbols: Mapping[str, str]) -> str:
    if isinstance(value, Mapping):
        return "by formula" if "source" in value else "varies"
    is_vector = isinstance(value, list | tuple) and all(isinstance(v, int | float) for v in value)
    if (is_vector or isinstance(value, int | float)) and not isinstance(value, bool):
        return as_shown(value, unit, symbols, 4)
    if isinstance(value, list | tuple):
        return f"({', '.join(_text(component, unit, symbols) for component in value)})"
    return str(value)
