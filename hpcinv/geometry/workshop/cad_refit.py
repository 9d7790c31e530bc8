"""The shape of a run as CAD: the faces of its CAD file, refitted to where the run has moved them.

A smooth map, a tricubic B-spline by least squares through all nodes, takes the CAD model to the moved mesh. Faces and
edges are fitted to their images by this one map, so that they meet. Each keeps its parameters, neighbours and
trimming; its surface is a bicubic B-spline, whose spans are halved until it is within the tolerance.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hpcinv.base.parallel.standard_output import muted_output
from hpcinv.base.quantity.arrays import Floats
from hpcinv.base.reading.door import admitted
from hpcinv.geometry.workshop.brep_text import BrepText, UnknownForm
from hpcinv.geometry.workshop.splines import DEGREE, Spline, even_knots, fitted, values_of
from hpcinv.mesh.io.gmsh_model import session
from hpcinv.mesh.source import MeshSource
from hpcinv.mesh.surface import surface_of

_SPANS = (8, 16, 32, 48)
"""numbers of spans along the longest side that are tried; more follow shorter waves, at four times the cost"""
_LEAST_SPANS = 6  # of a parameter; fewer do not follow a full turn
_SAMPLES = 8  # points on an edge for each span; fewer let the fit swing between them
_EDGE_WEIGHT = 100.0  # of points on edges; larger brings faces nearer to edges, and farther from points inside
_LEAST = 1e-7  # tolerance of exact edges in OpenCASCADE
_CLOSED = 1e-7  # distance of the ends of a parameter, relative to the size, that are one place
_VOLUME = 1e-3
"""difference of the volumes of the solid and of the mesh, relative, beyond which the solid is taken for inside out"""

_MAP_SPANS = (4, 8, 12, 16, 24, 32)
"""numbers of spans of the map along the longest side that are tried"""
_MOST_CONTROLS = 20_000  # of the map; more take minutes to factorize
_MARGIN = 0.02  # of the box of the map, around the body: surfaces reach beyond their edges
_SHARE = 0.8  # of the tolerance that the map may use


class NotRefitted(Exception):
    """The faces could not be refitted; the text says why."""


@dataclass(frozen=True)
class Movement:
    """Map from points of a CAD file (its unit) to moved points (mm), a tricubic B-spline.

    Attributes:
        error: largest distance of the moved nodes on the surface of the mesh from their images, in mm.
        is_straight: whether the cells of the mesh are straight, so that its faces differ from the CAD file.
    """

    spline: Spline
    error: float
    is_straight: bool = False

    @property
    def finer(self) -> str:
        """The remedy of a mesh that is too coarse."""
        curved = " or with 'mesh: {geometry_degree: 2}'" if self.is_straight else ""
        return f"run with a smaller mesh.size{curved}"

    def __call__(self, points: Floats) -> Floats:
        return values_of(self.spline, points)


@dataclass(frozen=True)
class Refitted:
    """A STEP file of refitted faces.

    Attributes:
        faces: number of faces.
        deviation: error of the map and largest distance of points of faces and edges from their images, in mm.
        points: number of these points.
        volume: of the solid, in mm³.
    """

    content: bytes
    faces: int
    deviation: float
    points: int
    volume: float


def movement(given: MeshSource, found: MeshSource, metres: float, scale: float, tolerance: float) -> Movement:
    """Return the smooth map from the CAD file to where a run has moved it, within a tolerance (mm) if it can be.

    Args:
        given: the mesh of the CAD file, and ``found`` the same mesh in the other body.
        metres: unit of the CAD file.
        scale: factor of the moved lengths.

    Raises:
        NotRefitted: the meshes differ, or have too few nodes.
    """
    if not np.array_equal(given.cells, found.cells):
        raise NotRefitted("the mesh of the run is not the one that its CAD file gives now")
    before, after = given.points / metres, found.points * (1e3 * scale)
    skin = np.unique(surface_of(given).tags)
    low, high = before.min(axis=0), before.max(axis=0)
    low, high = low - _MARGIN * (high - low), high + _MARGIN * (high - low)
    best: Movement | None = None
    for spans in _MAP_SPANS:
        counts = np.maximum(np.rint(spans * (high - low) / (high - low).max()), 2).astype(int)
        if np.prod(counts + DEGREE) > min(_MOST_CONTROLS, 2 * len(before)):
            break
        knots = [even_knots(*ends) for ends in zip(low, high, counts.tolist(), strict=True)]
        spline, values = fitted(knots, before, after, np.ones(len(before)), [False] * 3)
        error = float(np.linalg.norm(values - after, axis=1)[skin].max())
        if best is None or error < best.error:
            best = Movement(spline, error, given.degree == 1)
        if error <= _SHARE * tolerance:
            break
    if best is None:
        raise NotRefitted(f"its mesh has {len(before)} nodes, too few for a smooth map: take smaller cells (mesh.size)")
    return best


def refit(path: Path, move: Movement, tolerance: float, volume: float) -> Refitted:
    """Refit the faces of a CAD file with one solid.

    Args:
        move: the map from the file, whose error counts as deviation.
        tolerance: largest deviation, in mm.
        volume: of the moved body, in mm³.

    Raises:
        NotRefitted: it is not possible within the tolerance.
    """
    if move.error > tolerance:
        raise NotRefitted(f"no smooth map is nearer than {move.error:.3g} mm: give a larger --refit, or {move.finer}")
    with tempfile.TemporaryDirectory() as place:
        try:
            for spans in _SPANS:
                refitted = _tried(path, move, spans, Path(place))
                if refitted.deviation <= tolerance:
                    break
            else:
                text = f"{refitted.deviation:.3g} mm is the smallest deviation, with {_SPANS[-1]} spans"
                raise NotRefitted(f"{text}: give a larger --refit")
        except UnknownForm as fault:
            raise NotRefitted(f"the CAD file has a form that is not read: {fault}") from None
        except NotRefitted:
            raise
        except Exception as error:  # gmsh raises nothing narrower
            raise NotRefitted(f"gmsh could not do it: {error}") from error
    if abs(refitted.volume / volume - 1) > _VOLUME + tolerance / volume ** (1 / 3):
        text = f"the solid of the faces has {refitted.volume:.6g} mm³, and the body of the run {volume:.6g} mm³"
        raise NotRefitted(f"{text}, since its cells are coarse: {move.finer}")
    return refitted


def _tried(path: Path, move: Movement, spans: int, place: Path) -> Refitted:
    brep, step = place / "shape.brep", place / "shape.step"
    with session("given") as gmsh:
        gmsh.model.occ.importShapes(str(admitted(path)))
        gmsh.model.occ.synchronize()
        if not gmsh.model.getEntities(3):
            gmsh.model.occ.healShapes()
            gmsh.model.occ.synchronize()
        if (count := len(gmsh.model.getEntities(3))) != 1:
            raise NotRefitted(f"it has {count} solids, and one can be refitted")
        gmsh.write(str(brep))
    with session("refit") as gmsh:
        gmsh.model.occ.importShapes(str(brep))
        gmsh.model.occ.synchronize()
        text = BrepText(brep.read_text())
        if tuple(len(gmsh.model.getEntities(dim)) for dim in range(3)) != text.counts:
            raise UnknownForm("its topology has another order")
        deviation, points = _Refit(gmsh, text, move, spans).all()
        faces = text.counts[2]
    brep.write_text(text.text())
    with session("write") as gmsh:
        gmsh.model.occ.importShapes(str(brep))
        gmsh.model.occ.synchronize()
        with muted_output():  # OpenCASCADE prints there
            gmsh.write(str(step))
    with session("check") as gmsh:
        gmsh.model.occ.importShapes(str(step))
        gmsh.model.occ.synchronize()
        solids, surfaces = gmsh.model.getEntities(3), gmsh.model.getEntities(2)
        if len(solids) != 1 or len(surfaces) != faces:
            raise NotRefitted(f"its faces do not close: {len(solids)} solids with {len(surfaces)} of {faces} faces")
        volume = float(gmsh.model.occ.getMass(*solids[0]))
    return Refitted(step.read_bytes(), faces, move.error + deviation, points, volume)


class _Refit:
    """Fits of the curves and surfaces of gmsh's model, written into its text."""

    def __init__(self, gmsh: Any, text: BrepText, move: Movement, spans: int) -> None:
        self._model, self._text, self._move, self._spans = gmsh.model, text, move, spans
        box = np.array(gmsh.model.getBoundingBox(-1, -1))
        self._size = float((box[3:] - box[:3]).max())
        # Some three points along each span, and as many as follow the geometry.
        gmsh.option.setNumber("Mesh.MeshSizeMax", self._size / max(30, 3 * spans))
        gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", 24)
        gmsh.model.mesh.generate(2)
        self._curves: dict[int, Spline] = {}
        self._missed: dict[int, float] = {}
        self._largest, self._points = 0.0, 0

    def all(self) -> tuple[float, int]:
        """Fit edges, faces and vertices; return the largest deviation and the number of points."""
        edges = [tag for _, tag in self._model.getEntities(1)]
        for edge in edges:
            self._fit_edge(edge)
        for _, face in self._model.getEntities(2):
            self._fit_face(face)
        reach: dict[int, float] = {}
        for edge in edges:
            tolerance = max(1.2 * self._missed[edge], _LEAST)
            self._text.set_tolerance(edge, tolerance)
            for _, vertex in self._model.getBoundary([(1, edge)], oriented=False):
                reach[vertex] = max(reach.get(vertex, 0.0), 1.1 * tolerance)
        for vertex, tolerance in reach.items():
            (place,) = self._move(np.array(self._model.getValue(0, vertex, [])).reshape(1, 3))
            self._text.set_vertex(vertex, place, tolerance)
        return self._largest, self._points

    def _fit_edge(self, edge: int) -> None:
        self._missed[edge] = 0.0
        if (ends := self._text.edge_range(edge)) is None:
            return
        low, high = ends
        at = np.linspace(low, high, 3 * _SAMPLES * self._spans)
        points = self._move(self._places(1, edge, at))
        curve, _ = fitted([even_knots(low, high, 3 * self._spans)], at[:, None], points, np.ones(len(at)), [False])
        curve.controls[[0, -1]] = points[[0, -1]]
        self._note(values_of(curve, at[:, None]), points)
        self._curves[edge] = curve
        self._text.set_curve(edge, curve.knots[0], curve.controls)

    def _fit_face(self, face: int) -> None:
        inner = np.reshape(self._model.mesh.getNodes(2, face, False, True)[2], (-1, 2))
        low, high = (np.array(ends, dtype=float) for ends in self._model.getParametrizationBounds(2, face))
        sides = [*self._sides(face)]
        for axis in range(2):  # nodes of a period before or after
            for turn in (-2 * np.pi, 2 * np.pi):
                moved = inner[:, axis] + turn
                is_outside = (inner[:, axis] < low[axis] - 1e-6) | (inner[:, axis] > high[axis] + 1e-6)
                fits = is_outside & (moved > low[axis] - 1e-6) & (moved < high[axis] + 1e-6)
                inner[fits, axis] = moved[fits]
        uv = np.concatenate([inner, *(side for _, _, side in sides)])
        low, high = np.minimum(low, uv.min(axis=0)), np.maximum(high, uv.max(axis=0))
        closed = self._closed(face, low, high)
        points = self._move(self._places(2, face, uv.ravel()))
        weights = np.where(np.arange(len(uv)) < len(inner), 1.0, _EDGE_WEIGHT)
        weights[: len(inner) : 5] = 0.0  # they judge the fit
        knots = [even_knots(*ends) for ends in zip(low, high, self._face_spans(face, low, high), strict=True)]
        surface, values = fitted(knots, uv, points, weights, closed, self._poles(face, low, high))
        self._note(values, points)
        start = len(inner)
        for edge, at, side in sides:
            end = start + len(side)
            there = values_of(self._curves[edge], at[:, None]) if edge in self._curves else points[start:end]
            missed = float(np.linalg.norm(values[start:end] - there, axis=1).max())
            self._missed[edge] = max(self._missed[edge], missed)
            start = end
        self._text.set_surface(face, surface.knots, surface.controls)

    def _sides(self, face: int) -> Any:
        """Yield the edges of a face with parameters on them and on the face; seams twice."""
        edges = self._model.getBoundary([(2, face)], oriented=False)
        for edge in dict.fromkeys(tag for _, tag in edges):
            (low,), (high,) = self._model.getParametrizationBounds(1, edge)
            at = np.linspace(low, high, _SAMPLES * self._spans)
            first, second = (
                np.reshape(self._model.reparametrizeOnSurface(1, edge, at, face, which), (-1, 2)) for which in (0, 1)
            )
            if edge in self._curves and not self._text.has_plane_curve(edge, face):
                knots = [even_knots(low, high, 3 * self._spans)]
                curve, _ = fitted(knots, at[:, None], first, np.ones(len(at)), [False])
                curve.controls[[0, -1]] = first[[0, -1]]
                self._text.add_plane_curve(edge, face, curve.knots[0], curve.controls)
            yield edge, at, first
            if not np.allclose(first, second):
                yield edge, at, second

    def _face_spans(self, face: int, low: Floats, high: Floats) -> list[int]:
        """Return the number of spans along each parameter: the spans of all faces are about as long."""
        counts = []
        for axis in range(2):
            uv = np.array([(low + high) / 2] * 33)
            uv[:, axis] = np.linspace(low[axis], high[axis], 33)
            length = float(np.linalg.norm(np.diff(self._places(2, face, uv.ravel()), axis=0), axis=1).sum())
            counts.append(max(_LEAST_SPANS, round(self._spans * length / self._size)))
        return counts

    def _closed(self, face: int, low: Floats, high: Floats) -> Sequence[bool]:
        """Return of each parameter whether both its ends are the same places."""
        closed = []
        for axis in range(2):
            ends = np.array([(low + high) / 2] * 2)
            ends[:, axis] = low[axis], high[axis]
            first, last = self._places(2, face, ends.ravel())
            closed.append(bool(np.linalg.norm(first - last) < _CLOSED * self._size))
        return closed

    def _poles(self, face: int, low: Floats, high: Floats) -> list[tuple[int, int]]:
        """Return the ends (axis, 0 or -1) of parameters at which the face is one place."""
        poles = []
        for axis in range(2):
            for end, value in ((0, low[axis]), (-1, high[axis])):
                uv = np.linspace(low, high, 5)
                uv[:, axis] = value
                places = self._places(2, face, uv.ravel())
                if np.ptp(places, axis=0).max() < _CLOSED * self._size:
                    poles.append((axis, end))
        return poles

    def _places(self, dim: int, tag: int, parameters: Floats) -> Floats:
        return np.reshape(self._model.getValue(dim, tag, parameters), (-1, 3))

    def _note(self, values: Floats, points: Floats) -> None:
        self._largest = max(self._largest, float(np.linalg.norm(values - points, axis=1).max()))
        self._points += len(points)
