"""What material laws and effects have in common: quantities, regions and fibres that a scene must provide."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, ClassVar, Self

from hpcinv.quantity.parameter_paths import Number, rate, scalars, vanishes, with_scalar
from hpcinv.quantity.quantity import quantities_of
from hpcinv.quantity.schema import Location, Name, Spec, metadata_in
from hpcinv.quantity.units import Dimension


@dataclass(frozen=True)
class Refers:
    """Mark of a field that names something of the job."""

    to: str


Family = Annotated[Name, Refers("fibres")]
"""Name of a family of fibres, from the job's section 'fibres'."""
Surface = Annotated[str, Refers("surface")]
"""Name of a region of the boundary."""


class Ingredient(Spec):
    """A law or an effect: its quantities are fields, which a scene reads, scaled, under the same names."""

    example: ClassVar[dict[str, Any]]
    """What a job file may say, complete and with plausible numbers."""

    def quantities(self) -> dict[str, tuple[Any, Dimension]]:
        """Value and dimension of each quantity: a number (SI), a field (`Varying`), or a tuple of them."""
        return {name: (getattr(self, name), d) for name, d in quantities_of(type(self)).items()}

    def numbers(self) -> dict[Location, Number | str]:
        """The numbers that its quantities are made of, by place, as ``("acceleration", 1)``; of no number, why not."""
        return {
            place: found if isinstance(found, str) else Number(found, dimension)
            for name, dimension in quantities_of(type(self)).items()
            for place, found in scalars(getattr(self, name), (name,))
        }

    def with_number(self, place: Location, number: float) -> Self:
        """The same with another number (SI) at one of the places of `numbers`, which need not be admissible."""
        name, *rest = place
        return self.model_copy(update={str(name): with_scalar(getattr(self, str(name)), tuple(rest), number)})

    def rates(self, place: Location) -> dict[str, tuple[Any, Dimension]]:
        """Derivatives (SI) of those `quantities` that change with the number at a place, and dimensions of these."""
        number = self.numbers()[place]
        assert isinstance(number, Number)
        found = rate(lambda x: {n: v for n, (v, _) in self.with_number(place, x).quantities().items()}, number.value)
        return {n: (found[n], dimension) for n, (_, dimension) in self.quantities().items() if not vanishes(found[n])}

    @property
    def families(self) -> dict[str, str]:
        """Families of fibres that it needs, and the field that names each."""
        return self._named("fibres")

    @property
    def surfaces(self) -> dict[str, str]:
        """Regions of the boundary that it acts on, and the field that names each."""
        return self._named("surface")

    def _named(self, kind: str) -> dict[str, str]:
        found: dict[str, str] = {}
        for field, refers_to in _references(type(self)).items():
            value = getattr(self, field)
            if refers_to == kind and value is not None:
                found |= dict.fromkeys(value if isinstance(value, tuple) else (value,), field)
        return found


@cache
def _references(kind: type[Ingredient]) -> Mapping[str, str]:
    """The fields that name something of the job, with what they refer to."""
    marks = {f: metadata_in(Refers, info.annotation, *info.metadata) for f, info in kind.model_fields.items()}
    return {field: mark.to for field, mark in marks.items() if mark is not None}
