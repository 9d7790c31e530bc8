"""The section 'fibres' of a job: named families of fibres for laws and effects."""

from collections.abc import Mapping
from typing import Any, ClassVar

from pydantic import ValidationInfo

from hpcinv.base.quantity.component import Ingredient
from hpcinv.base.quantity.expressions import Expression, faults_with_constants
from hpcinv.base.quantity.parameter_paths import Number
from hpcinv.base.quantity.quantity import AnyQuantity
from hpcinv.base.quantity.schema import Faults, KeyPath, Name, Triple
from hpcinv.base.quantity.spatial_fields import POSITIONS, ByData, ByFormula, ByRule
from hpcinv.base.quantity.units import Dimension
from hpcinv.job.fibre_rules import AnyRule
from hpcinv.physics.effects.effect import Configuration


class FibreFamily(Ingredient):
    """A direction at each point of the body: formulas or a data array, of any length, or a rule for a kind of wall.

    Formulas can use the reference position X, Y, Z and the current position x, y, z. A direction on the current body is
    pulled back, ``a0 = F⁻¹a / |F⁻¹a|``, inside the residual. A rule is evaluated on the mesh of the job.
    """

    alternatives: ClassVar[tuple[str, ...]] = ("direction", "data", "rule")
    example: ClassVar = {"direction": ["-Y", "X", 0], "given_on": "reference"}

    direction: Triple[Expression] | None = None
    """three formulas of X, Y, Z, x, y, z"""
    data: str | None = None
    """an array of the mesh file with three components, instead of 'direction'"""
    rule: AnyRule | None = None
    """a rule for the wall of a ventricle or a tube, instead of 'direction'"""
    given_on: Configuration
    """body on which the direction is given: the reference (undeformed) or the current (deformed) one"""
    constants: Mapping[Name, AnyQuantity] = {}
    """values of further names in the formulas"""

    def quantities(self) -> dict[str, tuple[Any, Dimension]]:
        """The direction, which is dimensionless."""
        if self.rule is not None:
            return {"direction": (ByRule(self.rule), Dimension())}
        if self.direction is None:
            return {"direction": (ByData(str(self.data), components=3), Dimension())}
        formulas = (
            ByFormula(f, numbers={n: c for n, c in self.constants.items() if n in f.names}) for f in self.direction
        )
        return {"direction": (tuple(formulas), Dimension())}

    def numbers(self) -> dict[KeyPath, Number | str]:
        return {("constants", name): Number(value, None) for name, value in self.constants.items()}

    def _contradictions(self, info: ValidationInfo) -> Faults:
        if sum(given is not None for given in (self.direction, self.data, self.rule)) != 1:
            ways = "'direction' (three formulas), 'data' (an array of the mesh file) and 'rule' (for a kind of wall)"
            yield (), f"needs exactly one of {ways}"
        elif self.direction is None:
            if self.constants:
                yield ("constants",), "are not valid without 'direction'"
        elif problems := faults_with_constants("direction", self.direction, self.constants, POSITIONS, None):
            yield from problems
        elif not any(
            f.names & POSITIONS.keys() or float(f.evaluate(**{n: self.constants[n] for n in f.names}))
            for f in self.direction
        ):
            yield ("direction",), "must not be zero"
