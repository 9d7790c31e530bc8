"""Section ``mesh.shell`` of a job: thickness and directors of a body that is given as a surface."""

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import (
    BeforeValidator,
    Field,
    ValidationInfo,
)

from hpcinv.base.quantity.parameter_paths import Number
from hpcinv.base.quantity.schema import (
    Faults,
    KeyPath,
    Name,
    Spec,
)
from hpcinv.base.quantity.spatial_fields import ByRegion, ThicknessField
from hpcinv.job.mesh_file import RESERVED
from hpcinv.job.vocabulary import LENGTH


def _not_membrane(value: object) -> object:
    """Return a kind of shell unless it is a membrane."""
    if value == "membrane":
        raise ValueError("must be 'director': for a membrane, give a small thickness; bending has no effect then")
    return value


class Shell(Spec):
    """A shell whose surface is the mesh: triangles and quadrilaterals, in a file or by a generator of gmsh.

    The displacement is quadratic through each layer, and any law of three dimensions holds there.
    """

    thickness: ThicknessField | None = None
    """thickness of the given body along its director: a number, a formula of x, y, z on the surface, or an array at
    the nodes of the file, such as {data: wall, unit: mm}"""
    surface: Literal["middle", "outer", "inner"] = "middle"
    """where the mesh is in the shell: half way through the thickness, or one of the faces"""
    layers: Annotated[Mapping[Name, float], Field(exclude_if=lambda layers: not layers)] = {}
    """layers from the inner to the outer face, which are regions of cells, with their relative thicknesses, such as
    {core: 3, coat: 1}; by default one"""
    director: Literal["normal", "data"] = "normal"
    """of the given body: the normal of the surface; or data: the arrays 'outer' and 'inner' of the file, vectors (m)
    from its nodes to both faces, which give the thickness too, as shape files of runs have them"""
    kind: Annotated[Literal["director"], BeforeValidator(_not_membrane)] = "director"
    """director: with bending, and with shear and strain through the thickness"""

    @property
    def levels(self) -> tuple[float, ...]:
        """Distances of the nodes of a column from the inner face, by the thickness: three in each layer."""
        shares = tuple(self.layers.values()) or (1.0,)
        ends = [sum(shares[:i]) / sum(shares) for i in range(len(shares) + 1)]
        return (0.0, *(p for low, high in pairwise(ends) for p in ((low + high) / 2, high)))

    @property
    def surface_place(self) -> float:
        """Distance of the given surface from the inner face, by the thickness."""
        return {"inner": 0.0, "middle": 0.5, "outer": 1.0}[self.surface]

    @property
    def surface_level(self) -> int | None:
        """Number of the level at which the given surface is, ``None`` between levels."""
        return next((i for i, place in enumerate(self.levels) if abs(place - self.surface_place) < 1e-9), None)

    def numbers(self) -> dict[KeyPath, Number | str]:
        """The thickness, if it is one number; else the reason why it is not."""
        if self.thickness is None:
            return {}
        is_number = isinstance(self.thickness, float)
        return {("thickness",): Number(self.thickness, LENGTH) if is_number else "varies over the surface"}

    def unset_number(self, place: KeyPath) -> str:
        """Return why a number can only be differentiated by: a run has one mesh."""
        return "changes the mesh: vary it in a sweep"

    def _contradictions(self, info: ValidationInfo) -> Faults:
        if self.director == "normal" and self.thickness is None:
            yield ("thickness",), "is needed, unless the file has the faces ('director: data')"
        elif self.director == "data" and self.thickness is not None:
            yield ("thickness",), "is not valid with 'director: data', which gives it"
        if isinstance(self.thickness, ByRegion):
            yield ("thickness",), "cannot be by region, since it would jump: give a formula or an array at the nodes"
        for name, share in self.layers.items():
            if name in (*RESERVED, "outer", "inner"):
                yield ("layers", name), "is the name of another region; choose another"
            if not 0 < share < math.inf:
                yield ("layers", name), f"must be a positive number, the relative thickness, not {share:g}"
