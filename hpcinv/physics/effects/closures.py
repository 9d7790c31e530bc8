"""What a job may assume and know of contact on a given deformed shape, which does not determine the pressure."""

from typing import Annotated, Any, Literal

from pydantic import Field, ValidationInfo

from hpcinv.base.quantity import Force, Length
from hpcinv.base.quantity.quantity import Stress
from hpcinv.base.quantity.schema import Faults, Spec

type Closure = Literal["touching", "conforming", "gap", "stick", "coulomb", "given"]
GAP_CLOSURES = ("conforming", "gap", "stick", "coulomb")
"""closures by which the gap of the unloaded body determines the pressure"""
_MOST_FRICTION = 2.0
"""Largest coefficient of friction: dry rubber on rough ground. Raised, mistyped ones pass."""


class Known(Spec):
    """What is known of an interface in contact; it narrows the interval of `uncertainty: contact`."""

    greatest_pressure: Stress | None = None
    """bound of the pressure"""
    greatest_rest_gap: Length | None = None
    """bound of the gap of the unloaded bodies, where their surfaces face each other"""
    force: Annotated[tuple[Force, Force], Field(strict=False)] | None = None
    """least and greatest force by which the bodies press on each other: ``∫ p dA``"""

    def _contradictions(self, info: ValidationInfo) -> Faults:
        for name in ("greatest_pressure", "greatest_rest_gap"):
            if (bound := getattr(self, name)) is not None and bound <= 0:
                yield (name,), "must be positive"
        if self.force is not None and not 0 <= self.force[0] <= self.force[1]:
            yield ("force",), "must be a least and a greatest force, both not negative"


def contradicting_closure(contact: Any) -> Faults:
    """Yield the faults of the keys that an interface and a contact with an obstacle have in common."""
    if not 0 <= contact.friction <= _MOST_FRICTION:
        yield ("friction",), f"must be from 0 to {_MOST_FRICTION:g}"
    if contact.touches_within is not None and contact.closure is None:
        yield ("touches_within",), "is not valid without a 'closure'"
    if contact.touches_within is not None and contact.touches_within <= 0:
        yield ("touches_within",), "must be positive"
    if contact.closure is None and contact.known.model_fields_set:
        yield ("known",), "is not valid without a 'closure': it bounds what that assumes"
    if (contact.closure == "gap") != (contact.rest_gap is not None):
        yield ("rest_gap",), "must be given with 'closure: gap', and only then"
