"""Rules by which fibres follow the wall of a ventricle or a tube, as they stand in the section 'fibres' of a job."""

from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field, ValidationInfo, WithJsonSchema

from hpcinv.base.quantity.quantity import Quantity
from hpcinv.base.quantity.schema import Faults, OneOf, Spec, Triple

_REMEDY = "a plain number is in radians; write degrees as '60 deg'"
Angle = Annotated[float, Quantity("", at_least=-1.5707963267948968, at_most=1.5707963267948968, remedy=_REMEDY)]


_PAIR = BeforeValidator(lambda given: given if isinstance(given, list | tuple) else (given, given))
_ANGLE = {"anyOf": [{"type": "number"}, {"type": "string"}]}
_ANGLES = {"anyOf": [_ANGLE, {"type": "array", "items": _ANGLE, "minItems": 2, "maxItems": 2}]}
Angles = Annotated[tuple[Angle, Angle], Field(strict=False), _PAIR, WithJsonSchema(_ANGLES)]
"""Angles at the inner and at the outer surface of a wall; one angle stands for both."""
LocalAxis = Literal["fibre", "sheet", "normal"]


class FibreRule(Spec):
    """A rule that gives an orthonormal frame of fibre, sheet normal and sheet at each point of a wall."""

    example: ClassVar[dict[str, Any]]

    helix: Angles
    """angle of the fibres to the circumference at the inner and at the outer surface, such as [60 deg, -60 deg];
    positive towards the base or the outlet"""
    transmural: Literal["linear", "cubic"] = "linear"
    """how angles change with the depth e between the surfaces, 0 to 1: linear, or as (1 - 2 e)³, which turns fibres
    near the surfaces most (Potse et al. 2006, doi:10.1109/TBME.2006.880875)"""
    gives: LocalAxis = "fibre"
    """axis of the frame that this family has: the fibre, the sheet (across the wall), or the normal of both"""

    @property
    def surfaces(self) -> dict[str, str]:
        """Names of the regions of the boundary by field."""
        names = ("endo", "rv", "epi", "base", "apex", "inner", "outer", "inlet", "outlet")
        return {name: region for name in names if (region := getattr(self, name, None)) is not None}

    def _contradictions(self, info: ValidationInfo) -> Faults:
        owners = dict[str, str]()
        for field, region in self.surfaces.items():
            if region in owners:
                yield (field,), f"'{region}' is already the region of '{owners[region]}'"
            owners.setdefault(region, field)


class VentricleRule(FibreRule):
    """The Laplace–Dirichlet rule for one ventricle, or for both.

    Source: Bayer, Blake, Plank & Trayanova, Ann. Biomed. Eng. 40, 2243–2254, 2012, doi:10.1007/s10439-012-0593-5.
    """

    example: ClassVar = {
        "kind": "ventricle",
        "endo": "endo",
        "epi": "epi",
        "base": "base",
        "helix": ["60 deg", "-60 deg"],
    }

    kind: Literal["ventricle"]
    endo: str
    """region of the boundary: the cavity of the left ventricle"""
    rv: str | None = None
    """region of the boundary: the cavity of the right ventricle, in a body with both"""
    epi: str
    """region of the boundary: the outer surface"""
    base: str
    """region of the boundary: where the ventricle is cut at its base"""
    apex: str | None = None
    """region of the boundary at the apex; by default the node of 'epi' that is farthest from the base"""
    sheet: Angles = (0.0, 0.0)
    """angle of the sheets to the direction across the wall at the inner and at the outer surface"""


class TubeRule(FibreRule):
    """Directions of a vessel or another tube: around it, along it, and across its wall.

    The direction across the wall is the gradient of a Laplace solution between the surfaces; that along the tube is the
    gradient of one between inlet and outlet, or a fixed axis.
    """

    example: ClassVar = {"kind": "tube", "inner": "inner", "outer": "outer", "axis": [0, 0, 1], "helix": "20 deg"}

    kind: Literal["tube"]
    inner: str
    """region of the boundary: the lumen"""
    outer: str
    """region of the boundary: the outer surface"""
    inlet: str | None = None
    """region of the boundary: one end"""
    outlet: str | None = None
    """region of the boundary: the other end"""
    axis: Triple[Annotated[float, Quantity("")]] | None = None
    """direction of a straight tube, instead of 'inlet' and 'outlet'"""

    def _contradictions(self, info: ValidationInfo) -> Faults:
        yield from super()._contradictions(info)
        ends = [name for name in ("inlet", "outlet") if getattr(self, name) is not None]
        if self.axis is not None and ends:
            yield ("axis",), f"is not valid with '{ends[0]}': the direction of a tube is one or the other"
        if self.axis is None and len(ends) < 2:
            yield (), "needs 'inlet' and 'outlet' (regions at the ends of the tube), or an 'axis'"
        if self.axis is not None and not any(self.axis):
            yield ("axis",), "must not be zero"


AnyRule = Annotated[FibreRule, OneOf("kind")]
