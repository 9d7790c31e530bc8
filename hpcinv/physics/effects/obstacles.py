"""Rigid obstacles of contact: shapes with a signed distance, positive where a body may be."""

from abc import abstractmethod
from collections.abc import Mapping
from math import hypot
from typing import Annotated, Any, Literal

from pydantic import ValidationInfo, field_validator

from hpcinv.base.files.names import FilePath
from hpcinv.base.quantity import Length, Triple
from hpcinv.base.quantity.expressions import Expression
from hpcinv.base.quantity.quantity import Dimensionless, LengthUnit, Size
from hpcinv.base.quantity.schema import OneOf, Spec
from hpcinv.base.quantity.surface_files import checked_surface_file
from hpcinv.base.quantity.units import Dimension

LENGTH, NUMBER = Dimension(length=1), Dimension()
_DIFFERENCE = 1e-6
"""Step of differences of a formula, in its farthest coordinate; larger ones blur edges of the obstacle."""


class Obstacle(Spec):
    """A rigid body; a subclass with a literal field ``shape`` is registered under that name."""

    shape: str

    def quantities(self) -> dict[str, tuple[Any, Dimension]]:
        """Values (SI) and dimensions of the numbers that `distance` uses."""
        return {}

    def functions(self, degree: int) -> Mapping[str, tuple[int, int]]:
        """Functions that `distance` uses, as `Effect.functions`."""
        return {}

    @property
    def files(self) -> tuple[str, ...]:
        """Paths, relative to the job file, of files that define the shape."""
        return ()

    @property
    def can_be_passed(self) -> bool:
        """True if a point can come out of it on another side."""
        return True

    @abstractmethod
    def distance(self, x: Any, par: Any) -> tuple[Any, Any]:
        """Return the signed distance of points ``x`` (scaled lengths) and its gradient, a unit vector.

        Points and gradients are vectors of UFL, or arrays (3, n); vectors in ``par`` are then arrays (3, 1).
        """


def _inner(a: Any, b: Any) -> Any:
    if not _is_of_ufl(a):
        return (a * b).sum(axis=0)
    import ufl

    return ufl.inner(a, b)


def _size(a: Any) -> Any:
    if not _is_of_ufl(a):
        return (a * a).sum(axis=0) ** 0.5
    import ufl

    return ufl.sqrt(ufl.inner(a, a))


def _is_of_ufl(a: Any) -> bool:
    return hasattr(a, "ufl_shape")


def _unit(vector: Any) -> tuple[float, ...]:
    return tuple(c / hypot(*vector) for c in vector)


def _is_direction(vector: tuple[float, ...]) -> tuple[float, ...]:
    if not any(vector):
        raise ValueError("must not be zero: it is a direction")
    return vector


class Plane(Obstacle):
    """The half-space behind a plane."""

    shape: Literal["plane"]
    point: Triple[Length]
    """a point on the plane"""
    normal: Triple[Dimensionless]
    """direction out of the obstacle, towards the body, of any length"""

    _check_normal = field_validator("normal")(_is_direction)

    def quantities(self) -> dict[str, tuple[Any, Dimension]]:
        return {"point": (self.point, LENGTH), "normal": (_unit(self.normal), NUMBER)}

    @property
    def can_be_passed(self) -> bool:
        return False

    def distance(self, x: Any, par: Any) -> tuple[Any, Any]:
        return _inner(x - par.point, par.normal), par.normal


class Sphere(Obstacle):
    """A ball, or all that is outside of it."""

    shape: Literal["sphere"]
    centre: Triple[Length]
    """its centre"""
    radius: Size
    """its radius"""
    hollow: bool = False
    """whether the body is inside of it, as in a mould"""

    def quantities(self) -> dict[str, tuple[Any, Dimension]]:
        return {"centre": (self.centre, LENGTH), "radius": (self.radius, LENGTH)}

    @property
    def can_be_passed(self) -> bool:
        return not self.hollow

    def distance(self, x: Any, par: Any) -> tuple[Any, Any]:
        return _round(x - par.centre, par.radius, self.hollow)


class Cylinder(Obstacle):
    """A round bar without ends, or all that is outside of it."""

    shape: Literal["cylinder"]
    point: Triple[Length]
    """a point on its axis"""
    axis: Triple[Dimensionless]
    """direction of its axis, of any length"""
    radius: Size
    """its radius"""
    hollow: bool = False
    """whether the body is inside of it, as in a tube"""

    _check_axis = field_validator("axis")(_is_direction)

    def quantities(self) -> dict[str, tuple[Any, Dimension]]:
        return {
            "point": (self.point, LENGTH),
            "axis": (_unit(self.axis), NUMBER),
            "radius": (self.radius, LENGTH),
        }

    @property
    def can_be_passed(self) -> bool:
        return not self.hollow

    def distance(self, x: Any, par: Any) -> tuple[Any, Any]:
        arm = x - par.point
        return _round(arm - _inner(arm, par.axis) * par.axis, par.radius, self.hollow)


def _round(arm: Any, radius: Any, hollow: bool) -> tuple[Any, Any]:
    size = _size(arm)
    return (radius - size, -arm / size) if hollow else (size - radius, arm / size)


class LevelSet(Obstacle):
    """The points where a formula φ of position is negative; its distance is ``φ/|∇φ|``, exact to first order."""

    shape: Literal["level-set"]
    formula: Expression
    """a formula of x, y, z of any dimension: negative inside of the obstacle, positive where the body may be"""

    @field_validator("formula")
    @classmethod
    def _check_formula(cls, formula: Expression) -> Expression:
        if formula.check(dict.fromkeys("xyz", LENGTH)) is True:
            raise ValueError(f"must be a number, negative inside of the obstacle, but '{formula}' is a condition")
        if not formula.names:
            raise ValueError(f"must depend on x, y or z, but '{formula}' does not")
        return formula

    def quantities(self) -> dict[str, tuple[Any, Dimension]]:
        return {"metre": (1.0, LENGTH)}

    def distance(self, x: Any, par: Any) -> tuple[Any, Any]:
        if not _is_of_ufl(x):
            value, slope = self._value_and_gradient(x / par.metre)
        else:
            from hpcinv.physics.kinematics.ufl_formulas import value_and_gradient

            value, slope = value_and_gradient(self.formula, x / par.metre)
        size = _size(slope)
        return par.metre * value / size, slope / size

    def _value_and_gradient(self, x: Any) -> tuple[Any, Any]:
        """Return the formula at points (3, n) in m, and its gradient by central differences."""
        import numpy as np

        def value(points: Any) -> Any:
            return self.formula.evaluate(**dict(zip("xyz", points, strict=True)))

        step = _DIFFERENCE * float(np.abs(x).max(initial=0.0))
        steps = step * np.eye(3)[:, :, None]
        return value(x), np.stack([(value(x + shift) - value(x - shift)) / (2 * step) for shift in steps])


class SurfaceObstacle(Obstacle):
    """A triangulated surface.

    Before each solve the nearest point of the surface to each node of the body's region is found. During the solve the
    distance of a node is that from the plane through this point, which is normal to the surface; planes and solves are
    repeated until they agree. Normals vary continuously over triangles that meet at less than 30°.
    """

    shape: Literal["surface"]
    file: FilePath
    """path from the job file to triangles (.stl, .ply, .obj, .vtp) whose normals point towards the body"""
    unit: LengthUnit = 1.0
    """length unit of the coordinates in the file, such as mm"""
    flip: bool = False
    """whether the normals in the file point away from the body"""

    @field_validator("file")
    @classmethod
    def _check_file(cls, file: str, info: ValidationInfo) -> str:
        return checked_surface_file(file, info)

    @property
    def files(self) -> tuple[str, ...]:
        return (self.file,)

    def functions(self, degree: int) -> Mapping[str, tuple[int, int]]:
        return {"distance": (1, degree), "direction": (3, degree), "position": (3, degree)}

    def distance(self, x: Any, par: Any) -> tuple[Any, Any]:
        import ufl

        return par.distance + ufl.inner(par.direction, x - par.position), par.direction


AnyObstacle = Annotated[Obstacle, OneOf("shape")]
