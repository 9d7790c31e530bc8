"""Section of a job file with interfaces: two surfaces of one mesh that are tied, slide on each other, or touch."""

from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field, ValidationInfo

from hpcinv.base.quantity.schema import Faults, Spec

type Kind = Literal["tied", "sliding", "contact"]


class Interface(Spec):
    """Two surfaces of one mesh that face each other: of two bodies, or of one body with itself."""

    between: Annotated[tuple[str, str], Field(strict=False)]
    """two regions of the boundary; of 'contact', pressures are at the vertices of the first one"""
    kind: Kind
    """tied: the surfaces stick to each other for ever; sliding: they slide on each other without friction, and never
    part; contact, in a forward analysis: they press on each other where they touch, without friction"""

    def _contradictions(self, info: ValidationInfo) -> Faults:
        if self.between[0] == self.between[1]:
            yield ("between",), "names one region twice: name the two surfaces that face each other"


def faults_of_interfaces(interfaces: Sequence[Interface], directions: Sequence[str]) -> Faults:
    """Yield the faults of interfaces, with their places among them, for the directions of a job."""
    for i, interface in enumerate(interfaces):
        if interface.kind == "contact" and "inverse" in directions:
            text = (
                "'contact' needs 'analysis: forward': a given deformed shape does not determine the pressure between"
                " its bodies, since their gap is 0; 'tied' and 'sliding' are possible"
            )
            yield (i, "kind"), text
