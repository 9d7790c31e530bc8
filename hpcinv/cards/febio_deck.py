"""Materials of parts, supports and loads of model files of FEBio (formats 2.5 to 4.0)."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping

from hpcinv.cards.card import number
from hpcinv.cards.deck import Deck, Measure
from hpcinv.cards.febio import root_of


def read_deck(text: str, nodes_of_sets: Mapping[str, frozenset[int]]) -> Deck:
    """Return what the model says; load curves are not used, but their end is 1 as a rule.

    Raises:
        CardError: it is not XML, or a number is damaged.
    """
    root = root_of(text)
    deck = Deck()
    names = {entry.get("id", ""): entry.get("name", entry.get("id", "")) for entry in root.iter("material")}
    for domain in root.iter("SolidDomain"):
        deck.materials[domain.get("name", "")] = names.get(domain.get("mat", ""), domain.get("mat", ""))
    for part in root.iter("Elements"):
        if part.get("mat") and part.get("name"):
            deck.materials[part.get("name", "")] = names.get(part.get("mat", ""), part.get("mat", ""))
    held: dict[str, dict[str, float]] = {}
    for condition in root.findall("Boundary/*"):
        _read_condition(condition, held, deck)
    for name, values in held.items():
        deck.support(name, values)
    for load in root.findall("Loads/*"):
        pressure = load.find("pressure")
        if load.get("type") == "pressure" and pressure is not None:
            value = Measure(number(pressure.text or "", "pressure"), stress=1)
            deck.effects.append({"effect": "pressure", "region": load.get("surface", ""), "pressure": value})
            if pressure.get("lc"):
                deck.unused.append(f"load curve {pressure.get('lc')} of the pressure on {load.get('surface')}")
        else:
            deck.unused.append(f"<{load.tag} type='{load.get('type')}'>")
    for tag in ("Contact", "Constraints", "Rigid", "Step", "MeshData"):
        if len(root.findall(f"{tag}/*")):
            deck.unused.append(f"<{tag}>")
    return deck


def _read_condition(condition: ET.Element, held: dict[str, dict[str, float]], deck: Deck) -> None:
    region = (condition.get("node_set") or condition.get("surface") or "").removeprefix("@surface:")
    kind = condition.get("type", condition.tag)
    values: dict[str, float] = {}
    if kind == "zero displacement":
        values = {axis: 0.0 for axis in "xyz" if (condition.findtext(f"{axis}_dof") or "0").strip() == "1"}
    elif kind == "fix":
        axes = condition.findtext("dofs") or condition.get("bc") or ""
        values = {axis.strip(): 0.0 for axis in axes.split(",") if axis.strip() in tuple("xyz")}
    elif kind in ("prescribed displacement", "prescribe"):
        axis = condition.findtext("dof") or condition.get("bc") or ""
        amount = condition.findtext("value") or condition.findtext("scale") or "0"
        values = {axis.strip(): number(amount, "displacement")} if axis.strip() in tuple("xyz") else {}
    if values and region:
        held.setdefault(region, {}).update(values)
    else:
        deck.unused.append(f"<{condition.tag} type='{kind}'>")
