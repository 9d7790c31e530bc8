"""Text of a BREP file of OpenCASCADE: its topology is kept, its curves and surfaces are replaced.

Source: Open CASCADE Technology, "BRep Format" (user guide).
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from hpcinv.base.quantity.arrays import Floats
from hpcinv.geometry.workshop.splines import DEGREE

_FLAGS = re.compile(r"^[01]{7}$", re.MULTILINE)
_CURVE = re.compile(r"^1  ?\d+ (\d+) (\S+) (\S+)$", re.MULTILINE)


class UnknownForm(Exception):
    """The text has a form that is not read here."""


class BrepText:
    """Vertices, edges and faces in the order in which gmsh numbers them from 1 when it reads the text."""

    def __init__(self, text: str) -> None:
        head, _, shapes = text.partition("\nTShapes ")
        count, _, body = shapes.partition("\n")
        blocks = body.split("*\n")
        self._records, self._end = blocks[: int(count)], "*\n".join(blocks[int(count) :])
        if re.search(r"^Locations 0$", head, re.MULTILINE) is None:
            raise UnknownForm("its parts are placed by motions")
        curves, _, _ = head.partition("\nCurves ")
        self._plane_head, self._plane_curves = curves, list[str]()
        self._first_plane_curve = int(self._found(r"^Curve2ds (\d+)$", head)[1])
        self._surface_count = int(self._found(r"^Surfaces (\d+)$", head)[1])
        self._curves: list[str] = []
        self._surfaces: dict[int, str] = {}
        self._shapes: dict[str, list[int]] = {"Ve": [], "Ed": [], "Fa": []}
        self._visit(int(self._found(r"^[+-](\d+) ", self._end)[1]))

    @staticmethod
    def _found(pattern: str, text: str) -> re.Match[str]:
        match = re.search(pattern, text, re.MULTILINE)
        if match is None:
            raise UnknownForm("its text has no known form")
        return match

    def _visit(self, number: int) -> None:
        record = self._records[-number]
        kind = record.split(maxsplit=1)[0]
        if kind in self._shapes:
            if number in self._shapes[kind]:
                return
            self._shapes[kind].append(number)
        *_, flags = _FLAGS.finditer(record)
        for part in record[flags.end() :].split()[::2]:
            self._visit(abs(int(part)))

    @property
    def counts(self) -> tuple[int, int, int]:
        """Numbers of vertices, edges and faces."""
        vertices, edges, faces = (len(shapes) for shapes in self._shapes.values())
        return vertices, edges, faces

    def edge_range(self, edge: int) -> tuple[float, float] | None:
        """Return the parameters at the ends of an edge; ``None`` if it is a point."""
        match = _CURVE.search(self._record("Ed", edge))
        return None if match is None else (float(match[2]), float(match[3]))

    def surface_of(self, face: int) -> int:
        """Return the number of the surface of a face, which several may share."""
        return int(self._found(r"^[01]  ?\S+ (\d+) \d+$", self._record("Fa", face))[1])

    def has_plane_curve(self, edge: int, face: int) -> bool:
        """Return whether an edge has a curve in the parameters of a face; on planes it may have none."""
        pattern = rf"^[23]  ?\d+ (?:\d+C\S )?{self.surface_of(face)} \d+ "
        return re.search(pattern, self._record("Ed", edge), re.MULTILINE) is not None

    def add_plane_curve(self, edge: int, face: int, knots: Floats, controls: Floats) -> None:
        """Give an edge a curve in the parameters of a face."""
        self._plane_curves.append(_curve(knots, controls))
        number = self._first_plane_curve + len(self._plane_curves)
        line = f"2  {number} {self.surface_of(face)} 0 {knots[0]:.17g} {knots[-1]:.17g}"
        record = self._record("Ed", edge)
        self._set("Ed", edge, record.replace("\n0\n\n", f"\n{line}\n0\n\n", 1))

    def set_curve(self, edge: int, knots: Floats, controls: Floats) -> None:
        """Replace the curve of an edge, whose parameters stay."""
        self._curves.append(_curve(knots, controls))
        line = rf"1  {len(self._curves)} \1 \2 \3"
        self._set("Ed", edge, _CURVE.sub(line, self._record("Ed", edge), count=1))

    def set_surface(self, face: int, knots: Sequence[Floats], controls: Floats) -> None:
        """Replace the surface of a face, whose parameters stay."""
        u, v = knots
        sizes = f"9 0 0 0 0 {DEGREE} {DEGREE} {len(controls)} {len(controls[0])} {len(u)} {len(v)} "
        rows = "".join(f"{_points(row)}  \n" for row in controls)
        self._surfaces[self.surface_of(face)] = f"{sizes}{rows}\n{_knots(u, chr(10))}\n\n{_knots(v, chr(10))}\n\n"

    def set_vertex(self, vertex: int, place: Floats, tolerance: float) -> None:
        """Move a vertex; edges and faces may miss it by a tolerance."""
        text = f"Ve\n{tolerance:.9g}\n{_points([place])}"
        record = re.sub(r"^Ve\n\S+\n.*$", text, self._record("Ve", vertex), count=1, flags=re.MULTILINE)
        self._set("Ve", vertex, record)

    def set_tolerance(self, edge: int, tolerance: float) -> None:
        """Let faces miss an edge by a tolerance."""
        record = re.sub(r"^ \S+ (\d \d \d)$", rf" {tolerance:.9g} \1", self._record("Ed", edge), count=1, flags=re.M)
        self._set("Ed", edge, record)

    def text(self) -> str:
        """Return the text; all faces must have new surfaces."""
        if sorted(self._surfaces) != list(range(1, self._surface_count + 1)):
            raise UnknownForm("faces share surfaces with others")
        count = self._first_plane_curve
        title = f"Curve2ds {count + len(self._plane_curves)}"  # which ends the head if all faces are flat
        head = re.sub(r"^Curve2ds \d+$", title, self._plane_head, count=1, flags=re.MULTILINE)
        surfaces = "".join(self._surfaces[number] for number in sorted(self._surfaces))
        return "".join(
            (
                f"{head}\n{''.join(self._plane_curves)}Curves {len(self._curves)}\n{''.join(self._curves)}",
                f"Polygon3D 0\nPolygonOnTriangulations 0\nSurfaces {len(self._surfaces)}\n{surfaces}",
                "Triangulations 0\n\n",
                f"TShapes {len(self._records)}\n" + "*\n".join((*self._records, self._end)),
            )
        )

    def _record(self, kind: str, number: int) -> str:
        return self._records[-self._shapes[kind][number - 1]]

    def _set(self, kind: str, number: int, record: str) -> None:
        self._records[-self._shapes[kind][number - 1]] = record


def _points(points: Sequence[Floats] | Floats) -> str:
    return "  ".join(" ".join(f"{x:.17g}" for x in point) for point in points)


def _knots(knots: Floats, between: str) -> str:
    """Return knots with their multiplicities, of a B-spline that begins and ends in its first and last point."""
    ends = (0, len(knots) - 1)
    return between.join(f"{knot:.17g} {DEGREE + 1 if i in ends else 1}" for i, knot in enumerate(knots))


def _curve(knots: Floats, controls: Floats) -> str:
    return f"7 0 0  {DEGREE} {len(controls)} {len(knots)}  {_points(controls)} \n {_knots(knots, ' ')}\n"
