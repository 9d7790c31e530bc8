"""Length unit of the coordinates that a mesh file states, in formats that can store it.

MSH files state it in a section ``$Comments``, VTU files in a field array, and partitioned meshes in their header: there
it is the unit of the original file, since partitioned meshes themselves are in metres.
"""

import math
import re
from pathlib import Path
from typing import Any

from hpcinv.base.quantity.units import length_symbol
from hpcinv.errors import MeshError

FIELD = "length unit (m)"
_SECTION = "Comments"
_FOUND = re.compile(r"hpcinv: coordinates in units of (\S{1,30}) m")


def store_unit(gmsh: Any, unit: float) -> None:
    """Add the unit (m) to gmsh's current model, which writes it to an MSH file."""
    gmsh.model.setAttribute(_SECTION, [f"hpcinv: coordinates in units of {unit!r} m"])


def stored_unit(gmsh: Any) -> float | None:
    """The unit (m) that the MSH file of gmsh's current model states, or ``None``."""
    if _SECTION not in gmsh.model.getAttributeNames():
        return None
    matches = filter(None, map(_FOUND.fullmatch, map(str.strip, gmsh.model.getAttribute(_SECTION))))
    return next((as_unit(match[1]) for match in matches), None)


def as_unit(value: str | float) -> float | None:
    """A unit (m) as stated by a file, ``None`` if it is not a valid one."""
    try:
        unit = float(value)
    except (TypeError, ValueError):
        return None
    return unit if 0 < unit < math.inf else None


def check_unit(path: Path, stated: float | None, unit: float) -> None:
    """Raise ``MeshError`` if a file states another unit (m) than the job does."""
    if stated is not None and not math.isclose(stated, unit, rel_tol=1e-12):
        file_symbol, given = length_symbol(stated), length_symbol(unit)
        raise MeshError(
            f"{path}: states that it is in {file_symbol}, but the unit given for it is {given}",
            f"Write 'unit: {file_symbol}', or leave 'unit' out; or remove its statement ($Comments in .msh, field array"
            " in .vtu).",
        )
