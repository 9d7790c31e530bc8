"""What a job may know of contact on a given deformed shape, which does not determine the pressure."""

from typing import Annotated

from pydantic import Field, ValidationInfo

from hpcinv.base.quantity import Force, Length
from hpcinv.base.quantity.quantity import Stress
from hpcinv.base.quantity.schema import Faults, Spec


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
