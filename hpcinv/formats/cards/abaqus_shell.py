"""Sections of shells and membranes in input files of Abaqus and CalculiX.

Sources: *Abaqus Keywords Guide*, ``*SHELL SECTION``; Dhondt, *CalculiX CrunchiX User's Manual*, ``*SHELL SECTION``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any, ClassVar

from hpcinv.base.reading.abaqus_keywords import Keyword
from hpcinv.base.reading.standing_conditions import EDGE_LOAD
from hpcinv.formats.cards.abaqus_file import SolidElements
from hpcinv.formats.cards.card import CardError, UnknownLaw, number
from hpcinv.formats.cards.deck import Measure, ShellSection
from hpcinv.job.body_kinds import SHELL

SECTIONS = ("SHELL SECTION", "SHELL GENERAL SECTION", "MEMBRANE SECTION")
_TYPES = re.compile(r"(S|STRI|M3D)[34689][A-Z0-9]*", re.ASCII)
_OTHERS = ("SOLID SECTION", "BEAM SECTION", "BEAM GENERAL SECTION", "FRAME SECTION")
_OFFSETS = {"SPOS": 0.5, "SNEG": -0.5}
_NOT_READ = {
    "SYMMETRIC": "list all layers",
    "SHELL THICKNESS": "give the thickness by *NODAL THICKNESS",
    "LAYUP": "list the layers of one section",
}
_NODAL = "nodal_thickness"  # array that the reader of the mesh makes


class ShellElements(SolidElements):
    """Elements of shells and membranes."""

    body_kind: ClassVar[str] = SHELL.name
    has_rotations: ClassVar[bool] = True

    def has_type(self, name: str) -> bool:
        return _TYPES.fullmatch(name) is not None

    def can_bear(self, load: str) -> bool:
        return load == "P" or EDGE_LOAD.fullmatch(load) is not None or super().can_bear(load)

    def pressure(self, keyword: str, name: str, load: str, size: float) -> dict[str, Any] | None:
        pressure: dict[str, Any] = {"effect": "pressure", "region": name, "pressure": Measure(size, stress=1)}
        if load == "P":
            return pressure | {"face": "surface" if keyword == "DSLOAD" else "back"}
        if EDGE_LOAD.fullmatch(load) if keyword == "DLOAD" else load == "EDNOR":
            edge = f"{name}-{load}" if keyword == "DLOAD" else name
            return pressure | {"region": edge, "pressure": Measure(size, length=1, stress=1), "face": "edge"}
        return super().pressure(keyword, name, load, size)

    def face(self, *, is_edge: bool) -> dict[str, str]:
        return {"face": "edge" if is_edge else "back"}


def elements_of(file: Iterable[Keyword]) -> SolidElements:
    """Return the elements of a file.

    Raises:
        UnknownLaw: there are shells, and solids or beams.
    """
    names = {keyword.name: None for keyword in file}
    shells, others = ([name for name in names if name in kinds] for kinds in (SECTIONS, _OTHERS))
    if shells and others:
        text = f"has *{shells[0]} and *{others[0]}: shells tied to solids or beams have no counterpart"
        raise UnknownLaw(f"{text}; delete the elements and the section of what bears no load, or mesh all as a solid")
    return ShellElements() if shells else SolidElements()


def section_of(keyword: Keyword) -> ShellSection:
    """Return a section; its layers have the names of their materials.

    Raises:
        CardError: it is damaged, or has what is not read.
    """
    parameters = keyword.options
    title = f"*{keyword.name}"
    for name, remedy in _NOT_READ.items():
        if name in parameters:
            raise UnknownLaw(f"{title}, {name} has no counterpart; {remedy}")
    region, axes = (parameters.get(name, "") for name in ("ELSET", "ORIENTATION"))
    offset = parameters.get("OFFSET", "0").upper() or "0"
    place = _OFFSETS[offset] if offset in _OFFSETS else number(offset, f"{title}, OFFSET")
    layers, orientations = _layers(keyword, region, axes)
    if any(thickness < 0 for _, thickness in layers):
        raise CardError(f"{title} of {region}: a thickness is negative")
    is_uniform = all(thickness for _, thickness in layers)
    is_membrane = keyword.name == SECTIONS[-1]
    return ShellSection(region, layers, place, "" if is_uniform else _NODAL, is_membrane, orientations)


def _layers(keyword: Keyword, region: str, axes: str) -> tuple[tuple[tuple[str, float], ...], tuple[str, ...]]:
    """Return materials and thicknesses of the layers, 0 where nodes have them, and the names of their axes."""
    options, title, lines = keyword.options, f"*{keyword.name}", keyword.lines
    if "COMPOSITE" in options:
        if min(map(len, lines), default=0) < 3:
            raise CardError(f"{title}, COMPOSITE: a layer needs its thickness, integration points and material")
        layers = tuple((line[2], number(line[0], title)) for line in lines)
        return layers, tuple([*line, ""][3] or axes for line in lines)
    if not options.get("MATERIAL"):
        raise UnknownLaw(f"{title} of {region} has stiffnesses instead of MATERIAL=; name its material")
    text = lines[0][0] if lines else ""
    thickness = 0.0 if "NODAL THICKNESS" in options else number(text, f"{title} of {region}")
    return ((options["MATERIAL"], thickness),), (axes,)
