"""Sections of the bodies of a result across an axis, for pictures."""

from dataclasses import dataclass

import numpy as np

from hpcinv.base.quantity.arrays import Floats, Ints
from hpcinv.base.quantity.units import readable
from hpcinv.errors import OutputError
from hpcinv.output.surfaces.boundary_surface import BoundaryResult
from hpcinv.output.surfaces.interior import Interior, cut_tetrahedra

_BESIDE = 1e-5  # of the body, from a plane that often has nodes; if it is raised, sections are not in the middle


@dataclass(frozen=True)
class PictureBody:
    """One body of a picture.

    Attributes:
        points: of the boundary, (n, 3) m.
        result: whose values it shows.
        number: of that result.
        is_mesh: whether it is the mesh of that result, not the computed body.
    """

    title: str
    points: Floats
    result: BoundaryResult
    number: int
    is_mesh: bool


@dataclass(frozen=True)
class BodySection:
    """The section of one body.

    Attributes:
        points: (n, 3) m; ``triangles`` are rows of them, (m, 3).
        rows: the tetrahedron of each triangle, (m,).
        values: the result in the body, with a row for each tetrahedron.
        tetrahedra: rows of the points of ``values``, (k, 4).
        normal, place: of the plane ``normal · x = place``.
    """

    points: Floats
    triangles: Ints
    rows: Ints
    values: BoundaryResult
    tetrahedra: Ints
    normal: Floats
    place: float

    def spread(self, values: Floats | None) -> Floats:
        """Return the values of the triangles, from values of tetrahedra, or of points, whose mean is taken."""
        assert values is not None  # the one field without values within the body is refused
        cell_values = values if len(values) == len(self.tetrahedra) else values[self.tetrahedra].mean(axis=1)
        return np.asarray(cell_values[self.rows])

    def plane(self, front: Floats) -> tuple[Floats, float]:
        """Return the plane, oriented so that the half of the body behind it is kept in a direction of view."""
        sign = 1.0 if front @ self.normal > 0 else -1.0
        return sign * self.normal, sign * self.place


@dataclass(frozen=True)
class Cut:
    """A plane across an axis through the interior of a body.

    Attributes:
        axis: x, y or z.
        place: m; left out, the middle of each body.
    """

    interior: Interior
    axis: str
    place: float | None = None

    def section(self, shape: PictureBody) -> BodySection:
        """Return the section of one body; raises ``OutputError`` if the plane misses it."""
        result, k = self.interior.results[shape.number], "xyz".index(self.axis)
        low, high = float(shape.points[:, k].min()), float(shape.points[:, k].max())
        place = (low + high) / 2 + _BESIDE * (high - low) if self.place is None else self.place
        if not low < place < high:
            rounding = 1e-9 * (high - low)
            extent = " to ".join(readable(end if abs(end) > rounding else 0.0, "m") for end in (low, high))
            raise OutputError(f"the section {self.axis} = {readable(place, 'm')} misses a body from {extent}")
        points, normal = result.mesh if shape.is_mesh else result.others, np.eye(3)[k]
        section = cut_tetrahedra(points, self.interior.tetrahedra, normal, place)
        values = BoundaryResult(
            shape.result.state,
            shape.result.direction,
            result.mesh,
            result.others,
            stress=result.full_stress,
            J=result.J,
            stretches=result.stretches,
            crossing=np.zeros(len(result.J), dtype=bool),
        )
        tetrahedra = self.interior.tetrahedra
        return BodySection(section.points, section.triangles, section.rows, values, tetrahedra, normal, place)
