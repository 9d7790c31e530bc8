"""Base class of material laws, effects and fibres: their quantities, and the regions and fibres that they refer to."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, ClassVar, Self

from hpcinv.base.quantity.parameter_paths import Number, rate, replace_scalar, scalars, vanishes
from hpcinv.base.quantity.quantity import quantities_of
from hpcinv.base.quantity.schema import KeyPath, Name, Spec, metadata_in
from hpcinv.base.quantity.units import Dimension


@dataclass(frozen=True)
class Refers:
    """Mark of a field that refers to a part of the job by name."""

    kind: str


Family = Annotated[Name, Refers("fibres")]
"""Name of a family of fibres in the section 'fibres' of the job."""
Surface = Annotated[str, Refers("surface")]
"""Name of a region of the boundary."""


class Ingredient(Spec):
    """A law, an effect or a family of fibres; a weak form has its quantities, scaled, by the same names."""

    example: ClassVar[dict[str, Any]]
    """Content of its section in a job file, complete and with plausible numbers."""

    def quantities(self) -> dict[str, tuple[Any, Dimension]]:
        """Value and dimension of each quantity by name: a number (SI), a `Field`, or a tuple of these."""
        return {name: (getattr(self, name), d) for name, d in quantities_of(type(self)).items()}

    def structure(self) -> Any:
        """Return what decides about terms of its forms, besides its text and the kinds of its quantities (JSON data).

        Equal structures have equal forms, with the numbers as entries of their constant.
        """
        return None

    def is_attached(self, name: str) -> bool:
        """Return whether a quantity stays with the material from one state of the body to another."""
        return True

    def numbers(self) -> dict[KeyPath, Number | str]:
        """The numbers in its quantities by place, such as ``("acceleration", 1)``; for others the reason."""
        return {
            place: scalar if isinstance(scalar, str) else Number(scalar, dimension)
            for name, dimension in quantities_of(type(self)).items()
            for place, scalar in scalars(getattr(self, name), (name,))
        }

    def unset_number(self, place: KeyPath) -> str:
        """Return why a job cannot set the number at a place, but only be differentiated by it; else empty."""
        return ""

    def number_replaced(self, place: KeyPath, number: float) -> Self:
        """A copy with another number (SI), which is not checked, at one of the places of `numbers`."""
        name, *rest = place
        return self.model_copy(update={str(name): replace_scalar(getattr(self, str(name)), tuple(rest), number)})

    def rates(self, place: KeyPath) -> dict[str, tuple[Any, Dimension]]:
        """Nonzero derivatives (SI) of the `quantities` by the number at a place, and dimensions of the quantities."""
        number = self.numbers()[place]
        assert isinstance(number, Number)
        derivatives = rate(
            lambda x: {n: v for n, (v, _) in self.number_replaced(place, x).quantities().items()}, number.value
        )
        return {
            n: (derivatives[n], dimension)
            for n, (_, dimension) in self.quantities().items()
            if not vanishes(derivatives[n])
        }

    @property
    def files(self) -> tuple[str, ...]:
        """Paths, relative to the job file, of the files that it reads."""
        return ()

    @property
    def families(self) -> dict[str, str]:
        """Names of the families of fibres that it needs, with the field that contains each name."""
        return self._named("fibres")

    @property
    def surfaces(self) -> dict[str, str]:
        """Names of the boundary regions that it acts on, with the field that contains each name."""
        return self._named("surface")

    def _named(self, kind: str) -> dict[str, str]:
        named: dict[str, str] = {}
        for field, refers_to in _references(type(self)).items():
            value = getattr(self, field)
            if refers_to == kind and value is not None:
                named |= dict.fromkeys(value if isinstance(value, tuple) else (value,), field)
        return named


@cache
def _references(kind: type[Ingredient]) -> Mapping[str, str]:
    """Fields that refer to a part of the job by name, with the kind of part."""
    marks = {f: metadata_in(Refers, info.annotation, *info.metadata) for f, info in kind.model_fields.items()}
    return {field: mark.kind for field, mark in marks.items() if mark is not None}
