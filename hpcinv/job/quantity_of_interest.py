"""Section ``quantities`` of a job: numbers that are of interest."""

import re
from collections.abc import Mapping
from typing import Any, ClassVar, Literal

from pydantic import (
    Field,
    GetJsonSchemaHandler,
    ValidationInfo,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import core_schema

from hpcinv.base.quantity.expressions import Expression, faults
from hpcinv.base.quantity.quantity import Length
from hpcinv.base.quantity.schema import (
    Faults,
    Name,
    Problems,
    Spec,
    Triple,
)
from hpcinv.base.quantity.stress_measures import PRESTRAIN_COMPONENTS, PRESTRAIN_STRESSES
from hpcinv.base.quantity.units import Dimension
from hpcinv.job.vocabulary import CAVITY_QUANTITIES, CONTACTS, FIELDS, LENGTH, NORMALS, POSITIONS, REACTIONS


def is_of_nodes(quantity: Mapping[str, Any], let: Mapping[str, Any]) -> bool:
    """Return whether a quantity in a summary is a mean or rms of nodes, which depends on where a mesh has them.

    Args:
        let: definitions of names in its formula.
    """
    if quantity.get("on") is None or quantity.get("over") is not None or quantity.get("reduce") not in ("mean", "rms"):
        return False
    words, texts = set[str](), [str(quantity["of"])]
    while texts:
        new_words = set(re.findall(r"[A-Za-z_]\w*", texts.pop())) - words
        words |= new_words
        texts += [str(let[name]) for name in new_words & let.keys()]
    return words.isdisjoint(FIELDS)


type QuantityValue = float | list[float]
"""value (SI) of a quantity of interest: a number or three components"""


class QuantityOfInterest(Spec):
    """A reported result: the displacement or a formula at a point, a formula reduced over a region, the volume of a
    cavity, or the force or moment of the supports of a region.

    Formulas can use the reference position X, Y, Z, the current position x, y, z, the displacement ux, uy, uz, the
    volume ratio J, the Cauchy stress sxx, syy, szz, sxy, syz, sxz, stress measures such as p = -(sxx + syy + szz)/3 and
    von_mises, and the energy per reference volume; on a surface also its outward unit normal nx, ny, nz in the current
    body; with prestrain its stress-free stretch F0xx, F0xy, … F0zz, and the stress that it causes alone in the
    reference shape, prestrain_sxx, …, prestrain_p, prestrain_von_mises.
    """

    alternatives: ClassVar[tuple[str, ...]] = ("at", "on", "region", "cavity")

    name: Name
    """its name in the summary"""
    of: Expression
    """'displacement' (the vector, at a point), 'reaction' (the force that the supports of a region exert on the body),
    'reaction_moment' (its moment), 'contact_force', 'contact_area', 'contact_penetration' (of contact on a region),
    'volume' (of a cavity), 'pressure' (of a cavity where it is unknown), or a formula"""
    at: Triple[Length] | None = None
    """a point in the given mesh"""
    on: str | None = None
    """region over which the formula is reduced: positions over its nodes, other fields over its cells or, if it has
    none, facets; or the region of a support for a reaction"""
    cavity: Name | None = Field(default=None, exclude_if=lambda cavity: cavity is None)
    """cavity (a name from 'cavities') of a volume or pressure"""
    reduce: Literal["max", "min", "mean", "max_abs", "rms", "integral"] | None = None
    """reduction of the values on a region to one value; mean and rms of positions are of the nodes, all with the same
    weight, unless 'over' makes them means over volume or area; max and min of stresses, J and energy are over the
    quadrature points, which lie inside the cells or facets"""
    over: Literal["reference", "current"] | None = None
    """body over whose volume or area an integral, mean or rms is taken; by default the reference body for means and rms
    of stresses. Body of a cavity's volume; by default the current one"""
    state: Name | None = Field(default=None, exclude_if=lambda state: state is None)
    """state of the body in which it is evaluated; by default each loaded one, under names such as NAME-STATE"""
    from_state: Name | None = Field(default=None, exclude_if=lambda state: state is None)
    """loaded state whose value is subtracted: a displacement is then the way of the point from that state; 'from' is
    the same key"""
    about: Triple[Length] | None = Field(default=None, exclude_if=lambda about: about is None)
    """reference point of a reaction_moment; by default the origin"""

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        json_schema = super().__get_pydantic_json_schema__(schema, handler)
        properties = handler.resolve_ref_schema(json_schema)["properties"]
        properties["region"] = {"type": "string", "description": "the same as 'on', which YAML 1.1 reads as true"}
        properties["from"] = {"type": "string", "description": "the same as 'from_state'"}
        return json_schema

    @model_validator(mode="before")
    @classmethod
    def _take_other_names(cls, data: Any) -> Any:
        """Accept ``region`` for ``on``, which programs for YAML 1.1 read as true, and ``from`` for ``from_state``."""
        if not isinstance(data, Mapping):
            return data
        same = {"region": "on", "from": "from_state"}
        for other, key in same.items():
            if other in data and key in data:
                raise Problems(((other,), f"is the same key as '{key}'; give one of them"))
        return {same.get(key, key): value for key, value in data.items()}

    @property
    def unit(self) -> str:
        """SI unit of its values; empty for pure numbers, for integrals, and where only the mesh defines it."""
        if self.is_reaction:
            return REACTIONS[self.of.source.strip()]
        return "" if (dimension := self.dimension) is None else dimension.unit

    def unit_of_integral(self, dimensions: int) -> str:
        """Return the SI unit of an integral over a volume (3 ``dimensions``) or an area (2)."""
        dimension = self.of.check(POSITIONS | FIELDS)
        length, *others = dimension if isinstance(dimension, Dimension) else Dimension()
        return Dimension(length + dimensions, *others).unit

    @property
    def is_displacement(self) -> bool:
        return self.of.source.strip() == "displacement"

    @property
    def is_of_cavity(self) -> bool:
        """True if it is the volume or the pressure of a cavity."""
        return self.of.source.strip() in CAVITY_QUANTITIES

    @property
    def is_reaction(self) -> bool:
        """True if it is the force or the moment of supports, or a result of a contact."""
        return self.of.source.strip() in REACTIONS

    @property
    def is_contact(self) -> bool:
        """True if it is the force, the area or the largest penetration of a contact."""
        return self.of.source.strip() in CONTACTS

    @property
    def is_moment(self) -> bool:
        return self.of.source.strip() == "reaction_moment"

    @property
    def is_vector(self) -> bool:
        return self.is_displacement or (
            self.is_reaction and not self.of.source.strip().endswith(("area", "penetration"))
        )

    @property
    def fields(self) -> frozenset[str]:
        """Names of solution fields in the formula."""
        return self.of.names & FIELDS.keys()

    @property
    def needs_surface(self) -> bool:
        """True if the formula has the normal of a surface."""
        return not self.of.names.isdisjoint(NORMALS)

    @property
    def prestrain_names(self) -> list[str]:
        """Names in the formula that only bodies with prestrain have."""
        return [name for name in (*PRESTRAIN_STRESSES, *PRESTRAIN_COMPONENTS) if name in self.of.names]

    @property
    def dimension(self) -> Dimension | None:
        """Dimension of a displacement or formula; ``None`` if numbers leave it open, or only the mesh defines it."""
        if self.is_displacement:
            return LENGTH
        if self.is_of_cavity:
            return CAVITY_QUANTITIES[self.of.source.strip()]
        dimension = self.of.check(POSITIONS | FIELDS)
        # The dimension of an integral depends on whether its region is a volume or a surface.
        return dimension if isinstance(dimension, Dimension) and self.reduce != "integral" else None

    @property
    def uses_quadrature(self) -> bool:
        """True if it is reduced over the volume or area of a region, rather than over its nodes."""
        return self.on is not None and (self.over is not None or bool(self.fields))

    def _contradictions(self, info: ValidationInfo) -> Faults:
        if self.about is not None and not self.is_moment:
            yield ("about",), "is valid only with 'of: reaction_moment'"
        if self.is_of_cavity:
            yield from self._faults_of_cavity()
        elif self.cavity is not None:
            yield ("cavity",), "is valid only with 'of: volume' and 'of: pressure'"
        elif self.is_reaction:
            yield from self._faults_of_reaction()
        else:
            yield from self._faults_of_formula()

    def _faults_of_cavity(self) -> Faults:
        source = self.of.source.strip()
        if self.cavity is None:
            yield ("cavity",), f"is needed for a {source}: a name from 'cavities'"
        for field in ("at", "on", "reduce", *(["over"] if source == "pressure" else [])):
            if getattr(self, field) is not None:
                yield (field,), f"is not valid with the {source} of a cavity"

    def _faults_of_reaction(self) -> Faults:
        if self.on is None:
            yield ("on",), f"is needed for a reaction: the region of {'a contact' if self.is_contact else 'a support'}"
        for field in ("at", "reduce", "over"):
            if getattr(self, field) is not None:
                yield (field,), "is not valid with a reaction, which is a sum over the region of a support"

    def _faults_of_place(self) -> Faults:
        is_on_region = self.on is not None
        if (self.at is not None) == is_on_region:
            yield (), "needs exactly one of 'at' (a point) and 'on' (a region)"
        elif is_on_region and self.reduce is None:
            yield ("reduce",), "is needed on a region: max, min, mean, max_abs, rms or integral"
        elif not is_on_region and self.reduce is not None:
            yield ("reduce",), "is not valid at a point"
        if self.over is None and is_on_region and self.reduce == "integral":
            yield ("over",), "is needed for an integral: over the 'reference' or the 'current' body"
        elif self.over is not None and (not is_on_region or self.reduce in ("max", "min", "max_abs")):
            yield ("over",), "is valid only with an integral, a mean or rms on a region"

    def _faults_of_formula(self) -> Faults:
        yield from self._faults_of_place()
        if self.at is not None and self.needs_surface:
            yield ("of",), "has the normal of a surface: name a region of the boundary with 'on', not 'at'"
        if self.is_displacement and self.on is not None:
            yield ("of",), "is a vector; use a formula on a region, such as norm(ux, uy, uz)"
        elif not self.is_displacement:
            yield from faults([(("of",), self.of)], POSITIONS | FIELDS, None)
