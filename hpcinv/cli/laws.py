"""Commands ``laws``, ``effects`` and ``formulas``: catalogues of what a job may contain."""

import argparse
from collections.abc import Mapping
from typing import Any

from hpcinv.base.files.untrusted import add_option
from hpcinv.base.quantity.component import Ingredient
from hpcinv.cli.cards import add_options, convert
from hpcinv.cli.help import add_command

_CARDS = """
hpcinv laws --from abaqus "*HYPERELASTIC, MOONEY-RIVLIN\\n0.1, 0.15, 0.001" --stress-unit MPa
hpcinv laws --from febio model.feb --name wall --stress-unit kPa
hpcinv laws --to ansys job.yaml --stress-unit MPa --output card.inp"""


def add_laws(commands: Any) -> None:
    for name, said, example in (
        ("laws", "material laws", "yeoh"),
        ("effects", "loads and inelastic strains", "gravity"),
    ):
        catalogue = add_command(
            commands,
            name,
            f"List the {said}, or show formula, parameters, units, sources and an example of one.",
            examples=f"hpcinv {name}\nhpcinv {name} {example}{_CARDS if name == 'laws' else ''}",
            page=f"reference/{name}.md",
        )
        if name == "laws":
            catalogue.add_argument("name", nargs="?", help="name, as in job files; a card; or a file")
            add_options(catalogue)
            add_option(catalogue)
        else:
            catalogue.add_argument("name", nargs="?", help="name, as in job files")
        catalogue.set_defaults(command=_catalogue, catalogue=name)
    formulas = add_command(
        commands,
        "formulas",
        "List the functions and names of formulas, and where each may be used.",
        examples="hpcinv formulas",
        page="reference/functions.md",
    )
    formulas.set_defaults(command=_formulas)


def _catalogue(options: argparse.Namespace) -> int:
    from hpcinv.cli.catalogue import describe, overview
    from hpcinv.physics.effects import effects
    from hpcinv.physics.materials import laws

    if options.catalogue == "laws" and (options.source or options.target):
        return convert(options)
    members: Mapping[str, type[Ingredient]] = laws() if options.catalogue == "laws" else effects()
    if options.name is None:
        overview(members)
    else:
        describe(members, options.catalogue.removesuffix("s"), options.name)
    return 0


def _formulas(_options: argparse.Namespace) -> int:
    from hpcinv.cli.formula_guide import show

    show()
    return 0
