"""The length unit that a mesh file says its coordinates are in, where its format has a place for that.

MSH files have it in a section ``$Comments``, which gmsh passes on; VTU files in a field array; partitioned meshes in
their header, which is about the file that they were made of, since their own coordinates are in metres.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

from hpcinv.errors import MeshError
from hpcinv.quantity.units import length_symbol

FIELD = "length unit (m)"
_SECTION = "Comments"
_FOUND = re.compile(r"hpcinv: coordinates in units of (\S{1,30}) m")


def state_in_model(gmsh: Any, unit: float) -> None:
    """Let gmsh state the unit (m) in the MSH file of its current model."""
    gmsh.model.setAttribute(_SECTION, [f"hpcinv: coordinates in units of {unit!r} m"])


def stated_in_model(gmsh: Any) -> float | None:
    """The unit (m) that the MSH file of gmsh's current model states, ``None`` if it states none."""
    if _SECTION not in gmsh.model.getAttributeNames():
        return None
    found = filter(None, map(_FOUND.fullmatch, map(str.strip, gmsh.model.getAttribute(_SECTION))))
    return next((as_unit(match[1]) for match in found), None)


def as_unit(value: str | float) -> float | None:
    """A unit (m) as a file has it, ``None`` if it cannot be one."""
    try:
        unit = float(value)
    except (TypeError, ValueError):
        return None
    return unit if 0 < unit < math.inf else None


def check_unit(path: Path, stated: float | None, unit: float) -> None:
    """Raise ``MeshError`` if a file states another unit (m) than the job does."""
    if stated is not None and not math.isclose(stated, unit, rel_tol=1e-12):
        said, given = length_symbol(stated), length_symbol(unit)
        default = ", which is the default" if unit == 1.0 else ""
        raise MeshError(
            f"{path}: its coordinates are in {said}, as it says itself, but the unit given for it is {given}{default}",
            f"Write 'unit: {said}' beside the file's name (mesh.unit, expected_shape.unit, or --unit). If its"
            " coordinates were scaled since, remove that: in .msh the section $Comments, in .vtu the field array.",
        )
