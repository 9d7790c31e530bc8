"""Elastic laws of FEBio as sections of a job, with what only a whole model states: directions by element, prestrain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hpcinv.formats.cards.card import UnknownLaw
from hpcinv.formats.cards.entry import Entry
from hpcinv.formats.cards.febio import LAWS, counterpart

from .feb_reader import ElementBlock, Floats, Model

RELAXED = 30.0
"""Relaxation times under the same load after which a viscoelastic body is elastic: 1e-13 is left of the rest."""


@dataclass(frozen=True)
class Law:
    """Sections of a job for a law.

    Attributes:
        fibres: constant directions, or the name of an array of the mesh, by family.
        definitions: the job's section ``let``.
        arrays: values (elements, components) by name.
    """

    material: Mapping[str, Any]
    fibres: Mapping[str, Floats | str] = field(default_factory=dict)
    definitions: Mapping[str, str] = field(default_factory=dict)
    effects: tuple[Mapping[str, Any], ...] = ()
    arrays: Mapping[str, Floats] = field(default_factory=dict)


def law_of(model: Model, block: ElementBlock) -> Law:
    """Return the law of a block of elements.

    Raises:
        UnknownLaw: it has no counterpart.
    """
    material = model.materials.get(block.material)
    if material is None:
        raise UnknownLaw(f"elements '{block.name}' without a material")
    return _law(material, model, block)


def _law(material: Entry, model: Model, block: ElementBlock) -> Law:
    match material.type:
        case "prestrain elastic":
            return _prestrained(material, model, block)
        case "viscoelastic":
            return _viscoelastic(material, model, block)
    converted = counterpart(material)
    if "k" in material.values and {"kappa", "d1"} & converted.material.keys():
        raise UnknownLaw(f"law {material.type} on cells with a volume of their own")
    if (fibre := material.part("fiber")) is not None and converted.fibres:
        (family,) = converted.fibres
        arrays = {family: _directions(fibre, model, block)}
        return Law(converted.section("Pa"), {family: family}, converted.definitions, arrays=arrays)
    if converted.fibres and block.name in model.mat_axes:
        raise UnknownLaw(f"law {material.type} with axes that are not constant")
    axes = {family: np.array(axis) for family, axis in converted.fibres.items()}
    return Law(converted.section("Pa"), axes, converted.definitions)


def _prestrained(law: Entry, model: Model, block: ElementBlock) -> Law:
    elastic, prestrain = law.part("elastic"), law.part("prestrain")
    if elastic is None or prestrain is None or elastic.type not in LAWS:
        raise UnknownLaw(f"law {law.type} of {elastic.type if elastic else 'nothing'}")
    inner = _law(elastic, model, block)
    directions = inner.arrays["f"]
    if prestrain.type == "in-situ stretch":
        stretch = _mapped(prestrain, "stretch", model, len(block.nodes))[:, :, None]
        lateral = 1 / np.sqrt(stretch) if prestrain.values.get("isochoric", "1") == "1" else np.ones_like(stretch)
        dyads = directions[:, :, None] * directions[:, None, :]
        gradient = stretch * dyads + lateral * (np.eye(3) - dyads)
    elif prestrain.type == "prestrain gradient":
        scale = prestrain.number("ramp", 1.0)
        gradient = np.eye(3) + scale * (_mapped(prestrain, "F0", model, len(block.nodes)).reshape(-1, 3, 3) - np.eye(3))
    else:
        raise UnknownLaw(f"prestrain {prestrain.type}")
    # their tensor leads from the relaxed piece to the body, ours back; their fibres lie in the relaxed piece
    carried = np.einsum("eij,ej->ei", gradient, directions)
    arrays = {"F0": np.linalg.inv(gradient).reshape(-1, 9), "f": carried}
    effects = ({"effect": "prestrain", "given_on": "reference", "tensor": {"data": "F0"}},)
    return Law(inner.material, inner.fibres, inner.definitions, effects, arrays)


def _viscoelastic(law: Entry, model: Model, block: ElementBlock) -> Law:
    """The elastic law that is left at the end."""
    elastic, long_term = law.part("elastic"), law.number("g0", 1.0)
    times = [law.number(f"t{i}", 1.0) for i in range(1, 7) if law.number(f"g{i}", 0.0)]
    if elastic is None or elastic.type not in LAWS or long_term != 1 or model.rest < RELAXED * max(times, default=0):
        raise UnknownLaw(f"law {law.type} before it is at rest")
    return _law(elastic, model, block)


def _mapped(entry: Entry, name: str, model: Model, count: int) -> Floats:
    """Values (elements, components) of a parameter that a map or one number gives."""
    if name in entry.maps:
        return model.element_data[entry.maps[name]][1]
    return np.full((count, 1), entry.number(name))


def _directions(fibre: Entry, model: Model, block: ElementBlock) -> Floats:
    """Unit directions (elements, 3) of fibres."""
    if fibre.type == "vector":
        directions = np.tile(fibre.vector("vector"), (len(block.nodes), 1))
    elif fibre.type == "local":
        start, end = (int(number) - 1 for number in fibre.values["local"].split(","))
        order = np.argsort(model.numbers)
        rows = order[np.searchsorted(model.numbers, block.nodes[:, [start, end]], sorter=order)]
        directions = model.points[rows[:, 1]] - model.points[rows[:, 0]]
    else:
        raise UnknownLaw(f"fibres {fibre.type}")
    units: Floats = directions / np.linalg.norm(directions, axis=1)[:, None]
    return units
