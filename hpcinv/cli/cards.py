"""Options ``--from`` and ``--to`` of ``hpcinv laws``: material cards of other programs."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from hpcinv.base.files.names import check_directory_of, escaped_line
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.errors import JobError

if TYPE_CHECKING:
    from hpcinv.formats.cards.card import Card
    from hpcinv.physics.materials import MaterialLaw

PROGRAMS = ("abaqus", "ansys", "febio")


def add_options(parser: argparse.ArgumentParser) -> None:
    ways = parser.add_mutually_exclusive_group()
    ways.add_argument(
        "--from", dest="source", choices=PROGRAMS, help="print a card of this program as a job's sections"
    )
    ways.add_argument("--to", dest="target", choices=PROGRAMS, help="write the material of a job as a card")
    parser.add_argument("--stress-unit", metavar="UNIT", help="unit of stress of the card, such as MPa")
    parser.add_argument(
        "--name", dest="material_name", metavar="NAME", help="material to take, where there are several"
    )
    parser.add_argument("--output", type=Path, metavar="FILE", help="write to a file instead of the terminal")


def convert(options: argparse.Namespace) -> int:
    """Carry out ``--from`` or ``--to``."""
    from hpcinv.base.files.atomic import write_output

    if options.name is None:
        what = "a card or a file with one" if options.source else "a job, or a file with a section material"
        raise JobError(f"hpcinv laws: give {what}")
    text = _read_card(options) if options.source else _write_card(options)
    if options.output is None:
        print(text, end="")
        return 0
    check_directory_of(options.output)
    write_output(options.output, text.encode())
    return 0


def program_module(program: str) -> ModuleType:
    """Return the module that reads and writes cards of a program."""
    from hpcinv.formats.cards import abaqus, ansys, febio

    return {"abaqus": abaqus, "ansys": ansys, "febio": febio}[program]


def _read_card(options: argparse.Namespace) -> str:
    from hpcinv.formats.cards.card import CardError

    module = program_module(options.source)
    place, text = _card_text(options.name)
    try:
        card: Card = module.read(text, options.material_name)
        unit = _unit(options.stress_unit, card.unit)
        sections = checked_sections(card, unit)
    except CardError as error:
        raise CardError(*(f"{place}: {problem}" for problem in error.problems)) from None
    return _as_yaml(card, module.PROGRAM, unit, sections)


def _card_text(argument: str) -> tuple[str, str]:
    """Return place, for messages, and text of a card: of a file, of standard input, or the argument itself."""
    if argument == "-":
        return "standard input", sys.stdin.read()
    text = argument.replace("\\n", "\n")
    if text.lstrip().startswith(("*", "<")) or "\n" in text:
        return "the card", text
    try:
        return argument, file_text(Path(argument))
    except ValueError as error:
        raise JobError(f"{argument}: {error}") from None


def file_text(path: Path) -> str:
    """Return the text of a card's file, with the files that an input file includes; ``ValueError`` if there is none."""
    from hpcinv.base.quantity.csv_rows import text_of
    from hpcinv.base.reading.deck_includes import LONGEST_TEXT
    from hpcinv.base.reading.fault import Fault
    from hpcinv.formats.readers.followed_includes import followed

    text = text_of(path, LONGEST_TEXT)
    if suffix_of(path) != ".inp" or "INPUT" not in text.upper():
        return text
    try:
        included: str = followed("inp-text", path)["text"]
    except Fault as fault:
        raise ValueError(f"{fault.text}. {fault.advice}") from None
    return included


def _unit(option: str | None, stated: str) -> str:
    """Return the unit of stress of a card, which the user or the card states."""
    from hpcinv.base.quantity.units import parse_unit
    from hpcinv.formats.cards.card import STRESS, CardError

    if option is None:
        if not stated:
            raise CardError("does not state its unit of stress; give it, such as --stress-unit MPa")
        return stated
    try:
        size, dimension = parse_unit(option)
    except ValueError as error:
        raise JobError(f"--stress-unit: {error}") from None
    if dimension != STRESS:
        raise JobError(f"--stress-unit {option}: is {dimension}, not a stress")
    if stated and parse_unit(stated)[0] != size:
        raise CardError(f"states {stated} as its unit of stress, --stress-unit {option}; leave the option out")
    return option


def checked_sections(card: Card, unit: str) -> dict[str, Any]:
    """Return the sections of a job, after a job's checks."""
    from pydantic import ValidationError

    from hpcinv.base.quantity.expressions import LET, Expression
    from hpcinv.base.quantity.schema import dotted_key, problems_in
    from hpcinv.formats.cards.card import CardError
    from hpcinv.job.preamble import resolve
    from hpcinv.physics.materials import laws

    law = card.law
    material = law.section(unit)
    context = {LET: resolve({name: Expression(text) for name, text in law.definitions.items()})}
    kind = laws()[material["law"]]
    try:
        kind.model_validate(material, context=context)
    except ValidationError as error:
        faults = [
            f"{card.title}: {dotted_key(place) or 'material'}: {text}" for place, text in problems_in(error, kind)
        ]
        raise CardError(*faults) from None
    fibres = {
        name: {
            **({"data": direction} if isinstance(direction, str) else {"direction": list(direction)}),
            "given_on": "reference",
        }
        for name, direction in law.fibres.items()
        if direction is not None
    }
    sections = {"let": dict(law.definitions), "fibres": fibres, "material": material}
    return {key: value for key, value in sections.items() if value}


def _as_yaml(card: Card, program: str, unit: str, sections: Mapping[str, Any]) -> str:
    import yaml

    name = f" of material {card.name}" if card.name else ""
    comments = [f"{card.title}{name} ({program}), stresses in {unit}", *card.law.notes]
    if unknown := [family for family, direction in card.law.fibres.items() if direction is None]:
        comments.append(f"the card does not state the directions of fibres: give {', '.join(unknown)} in 'fibres'")
    lines = [f"# {escaped_line(comment)}\n" for comment in comments]
    body = yaml.safe_dump(dict(sections), sort_keys=False, allow_unicode=True, width=120, default_flow_style=None)
    return "".join([*lines, body])


def _write_card(options: argparse.Namespace) -> str:
    from hpcinv.base.quantity.units import as_float, parse_unit
    from hpcinv.formats.cards.card import Values

    if options.stress_unit is None:
        raise JobError("hpcinv laws --to: give the unit of stress of the card, such as --stress-unit MPa")
    unit = _unit(options.stress_unit, "")
    size = as_float(parse_unit(unit)[0])
    module = program_module(options.target)
    path = Path(options.name)
    laws = _laws(path)
    if options.material_name is not None and options.material_name not in laws:
        raise JobError(f"{path}: has no material '{options.material_name}'; it has {', '.join(laws)}")
    selected = {options.material_name: laws[options.material_name]} if options.material_name else laws
    texts = []
    for name, law in selected.items():
        try:
            texts.append(module.write(Values(law, module.PROGRAM, size), name))
        except JobError as error:
            raise JobError(*(f"{path}: material: {problem}" for problem in error.problems)) from None
    return "".join(texts)


def _laws(path: Path) -> dict[str, MaterialLaw]:
    """Return the laws in the section ``material`` of a file by region; one for the whole body has the file's name."""
    from pydantic import TypeAdapter, ValidationError

    from hpcinv.base.quantity.expressions import LET, Expression
    from hpcinv.base.quantity.schema import dotted_key, problems_in
    from hpcinv.job.preamble import resolve
    from hpcinv.job.yaml_reader import read_yaml
    from hpcinv.physics.materials import Material, MaterialLaw

    data = read_yaml(path)
    if "material" not in data:
        raise JobError(f"{path}: has no section material")
    definitions = data.get("let") or {}
    try:
        context = {LET: resolve({name: Expression(str(text)) for name, text in definitions.items()})}
        material = TypeAdapter(Material).validate_python(data["material"], context=context)
    except ValidationError as error:
        raise JobError(
            *(f"{path}: {dotted_key(('material', *place))}: {text}" for place, text in problems_in(error))
        ) from None
    except (ValueError, AttributeError) as error:
        raise JobError(f"{path}: let: {error}") from None
    return {path.stem: material} if isinstance(material, MaterialLaw) else dict(material)
