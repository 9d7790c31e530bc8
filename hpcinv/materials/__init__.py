"""Material laws: one file each, registered by subclassing `MaterialLaw`."""

from __future__ import annotations

from typing import Annotated

from hpcinv.materials.base import MaterialLaw
from hpcinv.schema import OneOf, import_modules, members_of

import_modules(__name__, __path__)

Material = Annotated[MaterialLaw, OneOf("law")]


def laws() -> dict[str, type[MaterialLaw]]:
    """Every known law by name."""
    return members_of(MaterialLaw, "law")


__all__ = ["Material", "MaterialLaw", "laws"]
