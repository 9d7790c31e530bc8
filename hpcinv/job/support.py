"""Section ``supports`` of a job: which displacements are held, and where to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar, Literal, Self

from pydantic import (
    Field,
    ValidationInfo,
)

from hpcinv.base.quantity.expressions import Expression, faults_with_constants
from hpcinv.base.quantity.parameter_paths import Number, replace_scalar
from hpcinv.base.quantity.quantity import AnyQuantity, Length, Quantity, quantities_of
from hpcinv.base.quantity.schema import (
    Faults,
    KeyPath,
    ListOf,
    Name,
    Spec,
    Triple,
)
from hpcinv.base.quantity.units import Dimension
from hpcinv.job.vocabulary import AXES, COORDINATES, FITTED_SURFACES, LENGTH, AxisName

Turn = Annotated[
    float,
    Quantity("", at_least=-1.5707963267948968, at_most=1.5707963267948968, remedy="write degrees as '60 deg'"),
]


class RemoteLoad(Spec):
    """Force and moment on a region that moves as a rigid body, by an unknown motion.

    Both keep their direction in space.
    """

    force: Triple[Annotated[float, Quantity("N")]] = (0.0, 0.0, 0.0)
    """force on the region, along x, y and z, at the point 'about'"""
    moment: Triple[Annotated[float, Quantity("N m")]] = (0.0, 0.0, 0.0)
    """moment on the region about the point 'about', about x, y and z"""
    about: Triple[Length]
    """point in the given mesh, inside or outside of the body, which moves with the region"""

    def numbers(self) -> dict[KeyPath, Number | str]:
        """All numbers by place."""
        return {
            (name, i): Number(x, dimension)
            for name, dimension in quantities_of(type(self)).items()
            for i, x in enumerate(getattr(self, name))
        }


class Motion(Spec):
    """A rigid motion: a rotation about an axis, then a displacement."""

    rotate: Turn = 0.0
    """angle, by the right-hand rule"""
    axis: Triple[float] = (0.0, 0.0, 1.0)
    """direction of the axis, of any length"""
    about: Triple[Length] = (0.0, 0.0, 0.0)
    """a point on the axis, in the unloaded body"""
    move: Triple[Length] = (0.0, 0.0, 0.0)
    """displacement of that point"""

    def _contradictions(self, info: ValidationInfo) -> Faults:
        if not any(self.axis):
            yield ("axis",), "must not be zero"


class Support(Spec):
    """Prescribed displacement on a region: zero for the components in ``fix``, by formulas, or a rigid motion, which is
    given or follows from a force and a moment.

    ``fix: [normal]`` lets a region slide: no motion along the normal of the given mesh, at each node; with 'surface'
    its nodes stay on a curved surface, however far they move.
    """

    alternatives: ClassVar[tuple[str, ...]] = ("fix", "displacement", "motion", "remote")

    region: str
    """physical group of the mesh, a name from 'regions', or 'boundary' for the whole of it"""
    fix: ListOf[Literal["x", "y", "z", "normal"]] | None = None
    """fixed components, some of x, y, z and normal, the normal of the given mesh"""
    normal: Triple[float] | None = None
    """direction that 'normal' stands for, of any length; by default the normal of each node's surface"""
    surface: Expression | None = Field(default=None, exclude_if=lambda surface: surface is None)
    """smooth surface on which the nodes stay with 'fix: [normal]', in both bodies: a formula of x, y, z in the given
    mesh that is zero on it, or 'sphere' or 'cylinder' for the one nearest to the region's nodes"""
    displacement: Triple[Expression | None] | None = None
    """three formulas of x, y, z in the given mesh, with null for a free component"""
    motion: Motion | None = None
    """rigid motion of the region from the unloaded to the loaded body, in all three components"""
    remote: RemoteLoad | None = Field(default=None, exclude_if=lambda remote: remote is None)
    """force and moment on the region, which moves as a rigid body"""
    constants: Mapping[str, AnyQuantity] = {}
    """values of further names in the formulas"""
    case: Name | None = None
    """load case (a name from 'load_cases') of the displacement; by default the first"""
    hinge: bool = Field(default=False, exclude_if=lambda hinge: not hinge)
    """of the edge of a shell: hold its midsurface only, about which the shell may turn"""

    @property
    def moves(self) -> bool:
        """True if the region is moved, not only held."""
        return self.fix is None

    @property
    def held(self) -> frozenset[AxisName]:
        """The components that the support determines."""
        if self.motion is not None or self.remote is not None:
            return frozenset(AXES)
        if self.displacement is None:
            return frozenset(axis for axis in AXES if axis in (self.fix or ()))
        return frozenset(a for a, formula in zip(AXES, self.displacement, strict=True) if formula is not None)

    @property
    def slides(self) -> bool:
        """True if the region is fixed along its normal, which need not be an axis."""
        return "normal" in (self.fix or ())

    @property
    def fitted_surface(self) -> str | None:
        """Name of the kind of surface that is fitted to the region; ``None`` for others."""
        name = self.surface.source.strip() if self.surface is not None else ""
        return name if name in FITTED_SURFACES else None

    @property
    def components(self) -> list[str]:
        """Names of what is prescribed, for messages."""
        return [*sorted(self.held), *(["normal"] if self.slides else [])]

    def numbers(self) -> dict[KeyPath, Number | str]:
        """The constants of the formulas, or the numbers of a motion or a remote load, by place.

        Constants of a surface do not vary.
        """
        if self.surface is not None:
            return {}
        if self.remote is not None:
            return {("remote", *place): number for place, number in self.remote.numbers().items()}
        if self.motion is not None:
            vectors = (("about", self.motion.about), ("move", self.motion.move))
            numbers: dict[KeyPath, Number | str] = {("motion", "rotate"): Number(self.motion.rotate, Dimension())}
            for key, vector in vectors:
                numbers |= {("motion", key, i): Number(x, LENGTH) for i, x in enumerate(vector)}
            return numbers
        return {("constants", name): Number(value, None) for name, value in self.constants.items()}

    def number_replaced(self, place: KeyPath, number: float) -> Self:
        """A copy with another number (SI) at one of the places of `numbers`."""
        if self.motion is not None:
            key = str(place[1])
            moved = replace_scalar(getattr(self.motion, key), place[2:], number)
            return self.model_copy(update={"motion": self.motion.model_copy(update={key: moved})})
        return self.model_copy(update={"constants": replace_scalar(self.constants, place[1:], number)})

    def _contradictions(self, info: ValidationInfo) -> Faults:
        if [self.fix, self.displacement, self.motion, self.remote].count(None) != 3:
            parts = "'fix' (components), 'displacement' (formulas), 'motion' (rigid) and 'remote' (force and moment)"
            yield (), f"needs exactly one of {parts}"
        elif not self.components:
            yield (), "prescribes no component; remove it or name some of x, y, z, normal"
        elif self.displacement is not None:
            yield from faults_with_constants("displacement", self.displacement, self.constants, COORDINATES, LENGTH)
        else:
            if self.case is not None and not self.moves:
                yield ("case",), "is not valid without 'displacement': what is fixed is fixed in every load case"
            if self.constants and (self.surface is None or self.fitted_surface):
                yield ("constants",), "are not valid without a formula: 'displacement' or 'surface'"
        if self.surface is not None:
            yield from self._surface_faults()
        if self.normal is not None:
            yield from self._normal_faults(self.normal)

    def _normal_faults(self, normal: Sequence[float]) -> Faults:
        if not self.slides:
            yield ("normal",), "is valid with 'fix: [normal]' only"
        elif not any(normal):
            yield ("normal",), "must not be zero"

    def _surface_faults(self) -> Faults:
        if not self.slides:
            yield ("surface",), "is valid with 'fix: [normal]' only"
        elif self.normal is not None:
            yield ("surface",), "has its own normals: leave 'normal' out"
        elif self.surface is not None and not self.fitted_surface:
            problems = faults_with_constants("surface", [self.surface], self.constants, COORDINATES, None)
            yield from ((where[:1] if where[0] == "surface" else where, text) for where, text in problems)
            if self.surface.names.isdisjoint(AXES):
                yield ("surface",), f"'{self.surface}' does not depend on x, y or z; or name a sphere or cylinder"
