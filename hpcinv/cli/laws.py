"""Commands ``laws``, ``effects`` and ``formulas``: catalogues of what a job may contain."""

import argparse
from collections.abc import Mapping
from typing import Any

from hpcinv.cli.help import add_command
from hpcinv.quantity.component import Ingredient


def add_laws(commands: Any) -> None:
    for name, said, example, command in (
        ("laws", "material laws", "yeoh", _laws),
        ("effects", "loads and inelastic strains", "gravity", _effects),
    ):
        catalogue = add_command(
            commands,
            name,
            f"List the {said}, or show formula, parameters, units, sources and an example of one.",
            examples=f"hpcinv {name}\nhpcinv {name} {example}",
            page=f"reference/{name}.md",
        )
        catalogue.add_argument("name", nargs="?", help="name, as in job files")
        catalogue.set_defaults(command=command)
    formulas = add_command(
        commands,
        "formulas",
        "List the functions and names of formulas, and where each may be used.",
        examples="hpcinv formulas",
        page="reference/functions.md",
    )
    formulas.set_defaults(command=_formulas)


def _laws(options: argparse.Namespace) -> int:
    from hpcinv.materials import laws

    return _catalogue(laws(), "law", options.name)


def _effects(options: argparse.Namespace) -> int:
    from hpcinv.effects import effects

    return _catalogue(effects(), "effect", options.name)


def _formulas(_options: argparse.Namespace) -> int:
    from hpcinv.cli.formula_guide import show

    show()
    return 0


def _catalogue(members: Mapping[str, type[Ingredient]], tag: str, name: str | None) -> int:
    from hpcinv.cli.catalogue import describe, overview

    if name is None:
        overview(members)
    else:
        describe(members, tag, name)
    return 0
