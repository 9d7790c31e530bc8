"""The section 'fibres' of a job: named families of fibres for laws and effects."""

from collections.abc import Mapping
from typing import Any, ClassVar, Self

from pydantic import model_validator

from hpcinv.effects.base import Configuration
from hpcinv.job.fibre_rules import AnyRule
from hpcinv.quantity.component import Ingredient
from hpcinv.quantity.expressions import Expression, faults_with_constants
from hpcinv.quantity.parameter_paths import Number
from hpcinv.quantity.quantity import AnyQuantity
from hpcinv.quantity.schema import Location, Name, Triple, raise_if_any
from hpcinv.quantity.spatial_fields import POSITIONS, ByData, ByFormula, ByRule
from hpcinv.quantity.units import Dimension


class FibreFamily(Ingredient):
    """A direction at each point of the body: formulas or a data array, of any length, or a rule for a kind of wall.

    Formulas can use the reference position X, Y, Z and the current position x, y, z. A direction on the current body is
    pulled back, ``a0 = F⁻¹a / |F⁻¹a|``, inside the residual. A rule is evaluated on the mesh of the job.
    """

    example: ClassVar = {"direction": ["-Y", "X", 0], "given_on": "reference"}

    direction: Triple[Expression] | None = None
    """three formulas of X, Y, Z, x, y, z"""
    data: str | None = None
    """an array of the mesh file with three components, in place of 'direction'"""
    rule: AnyRule | None = None
    """a rule for the wall of a ventricle or a tube, in place of 'direction'"""
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
        formulas = (ByFormula(f, {n: c for n, c in self.constants.items() if n in f.names}) for f in self.direction)
        return {"direction": (tuple(formulas), Dimension())}

    def numbers(self) -> dict[Location, Number | str]:
        return {("constants", name): Number(value, None) for name, value in self.constants.items()}

    @model_validator(mode="after")
    def _check_direction(self) -> Self:
        raise_if_any(self._problems())
        return self

    def _problems(self) -> list[tuple[Location, str]]:
        if sum(given is not None for given in (self.direction, self.data, self.rule)) != 1:
            ways = "'direction' (three formulas), 'data' (an array of the mesh file) and 'rule' (for a kind of wall)"
            return [((), f"needs exactly one of {ways}")]
        if self.direction is None:
            return [(("constants",), "are not valid without 'direction'")] if self.constants else []
        problems = faults_with_constants("direction", self.direction, self.constants, POSITIONS, None)
        if problems or any(f.names & POSITIONS.keys() for f in self.direction):
            return problems
        if all(float(f.evaluate(**{n: self.constants[n] for n in f.names})) == 0 for f in self.direction):
            return [(("direction",), "must not be zero")]
        return []
