"""What a job may know of contact on a given deformed shape, which does not determine the pressure."""

from typing import Annotated

from pydantic import Field, ValidationInfo, field_validator

from hpcinv.base.files.names import FilePath
from hpcinv.base.quantity import Force, Length
from hpcinv.base.quantity.component import Surface
from hpcinv.base.quantity.quantity import LengthUnit, Size, Stress
from hpcinv.base.quantity.schema import Faults, Spec
from hpcinv.base.quantity.surface_files import checked_surface_file


class RestSurface(Spec):
    """A surface on which a region of the unloaded bodies lies, as from a scan of a body before contact."""

    region: Surface
    """region of the boundary of one of the bodies in contact"""
    file: FilePath
    """path from the job file to triangles (.stl, .ply, .obj, .vtp) that cover the unloaded region"""
    unit: LengthUnit = 1.0
    """length unit of the coordinates in the file, such as mm"""
    within: Size
    """largest distance of a node of the region from the surface"""

    @field_validator("file")
    @classmethod
    def _check_file(cls, file: str, info: ValidationInfo) -> str:
        return checked_surface_file(file, info)


class Known(Spec):
    """What is known of an interface in contact; it narrows the interval of `uncertainty: contact`."""

    greatest_pressure: Stress | None = None
    """bound of the pressure"""
    greatest_rest_gap: Length | None = None
    """bound of the gap of the unloaded bodies, where their surfaces face each other"""
    force: Annotated[tuple[Force, Force], Field(strict=False)] | None = None
    """least and greatest force by which the bodies press on each other: ``∫ p dA``"""
    rest_surface: RestSurface | None = None
    """where a region of the unloaded bodies lies"""

    def _contradictions(self, info: ValidationInfo) -> Faults:
        for name in ("greatest_pressure", "greatest_rest_gap"):
            if (bound := getattr(self, name)) is not None and bound <= 0:
                yield (name,), "must be positive"
        if self.force is not None and not 0 <= self.force[0] <= self.force[1]:
            yield ("force",), "must be a least and a greatest force, both not negative"
