"""The formats 2.5 and 3.0 of ``.feb`` files in the layout of 4.0, which is the only one that the reader knows."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable

FORMATS = ("2.5", "3.0", "4.0")
_DISPLACEMENTS = {"x", "y", "z"}


def in_format_4(root: ET.Element) -> None:
    """Rewrite a model of one of the ``FORMATS``; what it has no rule for stays, and is not known to the reader."""
    if root.get("version") == "2.5":
        _rewrite_geometry(root)
        _rewrite_control(root)
    for node_set in root.iter("NodeSet"):
        if len(node_set):
            node_set.text = ",".join(node.get("id", "") for node in node_set)
            node_set[:] = []
    for condition in root.findall("Boundary/*"):
        _rewrite_condition(condition)
    for curve in root.findall("LoadData/*"):
        _rewrite_curve(curve)
    for load in root.findall("Loads/surface_load[@type='pressure']/value"):
        load.tag = "pressure"


def _rewrite_geometry(root: ET.Element) -> None:
    """2.5 names the material of elements where they are, by its name or number."""
    if (mesh := root.find("Geometry")) is None:
        return
    mesh.tag = "Mesh"
    names = {item.get("name", ""): item.get("name", "") for item in root.findall("Material/material")}
    numbers = {item.get("id", ""): item.get("name", "") for item in root.findall("Material/material")}
    domains = ET.SubElement(root, "MeshDomains")
    for i, block in enumerate(mesh.findall("Elements")):
        block.set("name", block.get("name") or f"block{i + 1}")
        material = block.get("mat", "")
        ET.SubElement(
            domains,
            "SolidDomain",
            name=block.get("name", ""),
            mat=names.get(material) or numbers.get(material, material),
        )


def _rewrite_control(root: ET.Element) -> None:
    for analysis in root.findall("Control/analysis[@type]"):
        analysis.text = analysis.get("type", "").upper()


def _rewrite_condition(condition: ET.Element) -> None:
    """Rewrite ``<fix bc="x,y">`` (2.5), ``<bc type="fix">`` (3.0), and the same with ``prescribe``."""
    kind = condition.get("type", "") if condition.tag == "bc" else condition.tag
    if kind not in ("fix", "prescribe"):
        return
    tag = "dofs" if kind == "fix" else "dof"
    components = [part.strip() for part in (condition.get("bc") or condition.findtext(tag) or "").split(",")]
    if not _DISPLACEMENTS.issuperset(components):
        return
    if surface := condition.get("surface"):
        condition.set("node_set", f"@surface:{surface}")
    condition.tag = "bc"
    if kind == "fix":
        condition.set("type", "zero displacement")
        condition[:] = [_text(f"{axis}_dof", "1") for axis in components]
        return
    condition.set("type", "prescribed displacement")
    for value in condition.findall("scale"):
        value.tag = "value"
    condition[:] = [child for child in condition if child.tag != "dof"] + [_text("dof", components[0])]


def _rewrite_curve(curve: ET.Element) -> None:
    """Rewrite ``<loadcurve type="smooth">`` (2.5), and name the points of both."""
    points: Iterable[ET.Element] = curve.iter("point")
    if curve.tag == "loadcurve":
        points = list(curve)
        curve.tag = "load_controller"
        for name, attribute, default in (("interpolate", "type", "linear"), ("extend", "extend", "constant")):
            curve.append(_text(name, curve.get(attribute, default).upper()))
        curve.set("type", "loadcurve")
    for point in points:
        point.tag = "pt"


def _text(tag: str, text: str) -> ET.Element:
    item = ET.Element(tag)
    item.text = text
    return item
