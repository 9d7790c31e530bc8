"""Commands ``laws``, ``effects`` and ``formulas``: catalogues of what a job may contain."""

import argparse
from collections.abc import Mapping
from typing import Any

from hpcinv.quantity.component import Ingredient


def add_laws(commands: Any) -> None:
    for name, command in (("laws", _laws), ("effects", _effects)):
        catalogue = commands.add_parser(name, help=f"list the {name}, or show all about one")
        catalogue.add_argument("name", nargs="?", help="its name in job files")
        catalogue.set_defaults(command=command)
    formulas = commands.add_parser(
        "formulas", help="list the functions and names of formulas, and where each may be used"
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
