"""What material laws and effects have in common: quantities, regions and fibres that a scene must provide."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from hpcinv.quantities import quantities_of
from hpcinv.schema import Name, Spec, metadata_in
from hpcinv.units import Dimension


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
        for field, info in type(self).model_fields.items():
            mark = metadata_in(Refers, info.annotation, *info.metadata)
            value = getattr(self, field)
            if mark is not None and mark.to == kind and value is not None:
                found |= dict.fromkeys(value if isinstance(value, tuple) else (value,), field)
        return found
