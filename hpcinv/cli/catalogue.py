"""Text on the laws and effects: parameters, sources and examples."""

import inspect
import textwrap
from collections.abc import Mapping
from typing import Any, Literal, get_args, get_origin

import yaml
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined
from rich.table import Table

from hpcinv.base.quantity.component import Ingredient, Refers
from hpcinv.base.quantity.docstrings import meanings
from hpcinv.base.quantity.quantity import Quantity
from hpcinv.base.quantity.schema import metadata_in
from hpcinv.base.quantity.spatial_fields import VaryingQuantity
from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.errors import JobError
from hpcinv.output.console import Console
from hpcinv.physics.materials.material_law import MaterialLaw
from hpcinv.physics.materials.moduli import Moduli


def overview(members: Mapping[str, type[Ingredient]]) -> None:
    """Print the names with one line on each."""
    table = Table(box=None, show_header=False, pad_edge=False)
    for name, kind in members.items():
        table.add_row(name, _paragraphs(kind)[0])
    Console(highlight=False).print(table)


def describe(members: Mapping[str, type[Ingredient]], tag: str, name: str) -> None:
    """Print the description of one law or effect.

    Raises:
        JobError: there is no law or effect of that name.
    """
    if name not in members:
        raise JobError(f"unknown {tag} '{name}'.{did_you_mean(name, members)}")
    kind = members[name]
    console = Console(highlight=False, markup=False)
    for paragraph in _paragraphs(kind):
        console.print(paragraph)
        console.print()
    example = kind.model_validate(kind.example)
    if formula := getattr(example, "energy_formula", None):
        console.print(f"energy: {formula}")
        console.print()
    table = Table("key", "unit", "default", "meaning", box=None, pad_edge=False, header_style="")
    for key in sorted(kind.model_fields, key=lambda key: key not in kind.__annotations__):  # inherited ones last
        if key != tag:
            info = kind.model_fields[key]
            table.add_row(key, _unit(info), _default(info), _meaning(info, meanings(kind).get(key, "")))
    console.print(table)
    console.print()
    if issubclass(kind, MaterialLaw):
        _describe_moduli(console, kind)
        _describe_starting_values(console, kind)
    section = {"material": kind.example} if tag == "law" else {"effects": [kind.example]}
    console.print(yaml.safe_dump(section, sort_keys=False, default_flow_style=None, width=110).rstrip())


def _describe_moduli(console: Console, law: type[MaterialLaw]) -> None:
    match law.replaceable:
        case (str(shear), bulk):
            offered, text = list(Moduli.model_fields), f"Instead of {shear} and {bulk} a job may give any two of:"
        case (None, bulk):
            offered, text = ["poisson", "lame"], f"Instead of {bulk} a job may give one of:"
        case _:
            return
    console.print(text)
    table = Table(box=None, pad_edge=False, show_header=False)
    for key in offered:
        table.add_row(key, _unit(Moduli.model_fields[key]), meanings(Moduli)[key])
    console.print(table)
    console.print()


def _describe_starting_values(console: Console, law: type[MaterialLaw]) -> None:
    for name, values in law.starting_values.items():
        section = {"material": {"law": law.example["law"], **values.parameters}}
        console.print(f"Starting values for {name} ({values.of}); source: {values.source}.")
        text = yaml.safe_dump(section, sort_keys=False, default_flow_style=None, width=110).rstrip()
        console.print(textwrap.indent(text, "  "), soft_wrap=True)
        console.print()


def _paragraphs(kind: type[Ingredient]) -> list[str]:
    return [" ".join(p.split()) for p in (inspect.getdoc(kind) or "").replace("``", "").split("\n\n")]


def _unit(info: FieldInfo) -> str:
    quantity = metadata_in(Quantity, info.annotation, *info.metadata)
    if quantity is None:
        return ""
    return quantity.unit or "1"


def _default(info: FieldInfo) -> str:
    if info.default is PydanticUndefined:
        return "needed"
    return "none" if info.default is None else str(info.default)


def _meaning(info: FieldInfo, text: str) -> str:
    notes = []
    if choices := _choices(info.annotation):
        notes.append(" | ".join(choices))
    quantity = metadata_in(Quantity, info.annotation, *info.metadata)
    if quantity is not None and quantity.bounds:
        notes.append(quantity.bounds)
    if isinstance(quantity, VaryingQuantity):
        notes.append("may vary over the body")
    mark = metadata_in(Refers, info.annotation, *info.metadata)
    if mark is not None and mark.kind == "fibres":
        notes.append("a name from 'fibres'")
    return text + (f" ({'; '.join(notes)})" if notes else "")


def _choices(annotation: Any) -> tuple[str, ...]:
    annotation = getattr(annotation, "__value__", annotation)
    return get_args(annotation) if get_origin(annotation) is Literal else ()
