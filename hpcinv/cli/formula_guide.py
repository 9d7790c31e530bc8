"""Text on formulas: functions, and the names that may be used at each place of a job."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from rich.table import Table

from hpcinv.base.quantity.component import Ingredient
from hpcinv.base.quantity.functions import CONSTANTS, FUNCTIONS
from hpcinv.base.quantity.schema import metadata_in
from hpcinv.base.quantity.spatial_fields import POSITIONS, VaryingQuantity
from hpcinv.job.vocabulary import COORDINATES, FIELDS, REGION_NAMES
from hpcinv.job.vocabulary import POSITIONS as OF_QUANTITIES
from hpcinv.output.console import Console
from hpcinv.physics.effects import effects
from hpcinv.physics.materials import laws
from hpcinv.physics.materials.formula_law.invariants import ISOTROPIC

OPERATORS = "+ - * / ** (or ^), and in conditions < <= > >= and or not"


@dataclass(frozen=True)
class FormulaPlace:
    """A field of a job that holds formulas."""

    field: str
    value: str
    names: tuple[str, ...]


PLACES = (
    FormulaPlace("let", "anything, for use in the other places", ("the names of the place that uses it",)),
    FormulaPlace("regions", "a condition", tuple(REGION_NAMES)),
    FormulaPlace("supports[].displacement", "three lengths", (*COORDINATES, "names in its 'constants'")),
    FormulaPlace("supports[].surface", "zero on the surface", (*COORDINATES, "names in its 'constants'")),
    FormulaPlace("fibres.NAME.direction", "a vector of any length", (*POSITIONS, "names in its 'constants'")),
    FormulaPlace("material and effects", "the quantity; those that may vary are listed below", tuple(POSITIONS)),
    FormulaPlace(
        "material.energy (law: formula)",
        "an energy per volume",
        (*ISOTROPIC, "I4_f", "I5_f", "I8_f_s of families f, s of fibres", "names in its 'parameters'"),
    ),
    FormulaPlace("quantities[].of", "the quantity", (*OF_QUANTITIES, *FIELDS)),
)


def varying(members: Mapping[str, type[Ingredient]]) -> Iterator[tuple[str, list[str]]]:
    """Return laws or effects with their fields that accept a formula of position."""
    for name, kind in members.items():
        fields = [
            field
            for field, info in kind.model_fields.items()
            if isinstance(metadata_in(VaryingQuantity, info.annotation, *info.metadata), VaryingQuantity)
        ]
        if fields:
            yield name, fields


def show() -> None:
    console = Console(highlight=False, markup=False)
    console.print(f"operators: {OPERATORS}")
    console.print("numbers: SI, or with a unit each, such as 4.25 mm or 963 kg/m^3")
    console.print(f"constants: {', '.join(f'{name} = {value:.16g}' for name, value in CONSTANTS.items())}")
    console.print()
    functions = Table("function", "values", "meaning", box=None, pad_edge=False, header_style="")
    for name, function in FUNCTIONS.items():
        functions.add_row(f"{name}()", str(function.arguments or "2 or more"), function.meaning)
    console.print(functions)
    console.print()
    places = Table("place", "its value", "names", box=None, pad_edge=False, header_style="")
    for place in PLACES:
        places.add_row(place.field, place.value, ", ".join(place.names))
    console.print(places)
    console.print()
    console.print("quantities of laws and effects that may vary over the body:")
    fields = Table(box=None, show_header=False, pad_edge=False)
    for kind, members in (("law", laws()), ("effect", effects())):
        for name, names in varying(members):
            fields.add_row(kind, name, ", ".join(names))
    console.print(fields)
