"""Section of a job file with interfaces: two surfaces of one mesh that are tied, slide on each other, or touch."""

from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field, ValidationInfo

from hpcinv.base.quantity.schema import Faults, Spec

type Kind = Literal["tied", "sliding", "contact"]


class Interface(Spec):
    """Two surfaces of one mesh that face each other: of two bodies, or of one body with itself."""

    between: Annotated[tuple[str, str], Field(strict=False)]
    """two regions of the boundary; pressures are at the nodes of the first one, whose cells should not be larger"""
    kind: Kind
    """tied: the surfaces stick to each other for ever; their meshes need not match"""

    def _contradictions(self, info: ValidationInfo) -> Faults:
        if self.between[0] == self.between[1]:
            yield ("between",), "names one region twice: name the two surfaces that face each other"


def touching(interfaces: Sequence[Interface]) -> bool:
    """Return whether surfaces of an interface may part."""
    return any(interface.kind == "contact" for interface in interfaces)
