"""Observations: what was measured, and what a run predicts for it, with derivatives.

Data are on rank 0. A landmark or node has three numbers, its coordinates. A point of a surface has one, its distance
from the computed surface along the normal there. Its derivative is the nearest point's derivative along the normal.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hpcinv.base.parallel.runtime import on_root
from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.base.quantity.csv_rows import Row, below_titles
from hpcinv.base.quantity.quantity import Measured
from hpcinv.base.quantity.table_files import readings_of
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.errors import MeshError, naming_field
from hpcinv.job.filling_points import filling_points
from hpcinv.job.identification import TABLES, Observation
from hpcinv.job.job import Job
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.job.vocabulary import CUBIC
from hpcinv.mesh import Body, reorder_to_source
from hpcinv.mesh.extent import diagonal
from hpcinv.mesh.location import PointLocation, locate, position
from hpcinv.mesh.source import Floats
from hpcinv.mesh.surface import gather_surface
from hpcinv.model.surface_distance import barycentric
from hpcinv.output.result import Result
from hpcinv.results.shape_distance import read_same_cells
from hpcinv.studies.identification.filling_curves import filling_curve

_REMEDY = "What is observed is on the surface of the body: name a region of the boundary."
_LARGEST_TABLE = 50_000_000
"""bytes of a table of points; a larger one is refused, since reading it takes minutes"""
_SIZE = 5.0  # factor by which the size of what was observed may differ from the body's
_DIVISIONS = (1, 2, 4, 8, 16)  # of each side of a curved facet into triangles
_FLAT = 0.02  # distance of these from the facet that is allowed, in standard deviations


@dataclass(frozen=True)
class PredictedObservation:
    """Differences of computed and observed values, (n,), and their derivatives by the parameters, (n, k), in SI."""

    differences: Floats
    jacobian: Floats

    @property
    def is_finite(self) -> bool:
        return bool(np.isfinite(self.differences).all() and np.isfinite(self.jacobian).all())


class Observed(ABC):
    """One observation of a job.

    Attributes:
        deviation: standard deviation of each of its numbers, in SI.
        count: number of its numbers; on rank 0.
    """

    count: int

    def __init__(self, spec: Observation, deviation: float) -> None:
        self.spec, self.deviation = spec, deviation

    @abstractmethod
    def predict(self, result: Result, keys: Sequence[str]) -> PredictedObservation | None:
        """Compare with a run, on rank 0; ``None`` on others; collective."""

    def _nodes(self, result: Result, keys: Sequence[str]) -> list[Floats]:
        """Return the local nodes (n, 3) m in the observed state, and their derivatives by the parameters."""
        sensitivities = result.sensitivities
        assert sensitivities is not None
        state = self.spec.state
        state_sensitivities = sensitivities if state is None else sensitivities.shapes.get(state, sensitivities)
        nodes = result.shape if state is None else result.shapes[state]
        return [nodes, *(state_sensitivities.nodes[key] for key in keys)]


class ObservedQuantity(Observed):
    """A quantity of interest."""

    def __init__(self, spec: Observation) -> None:
        super().__init__(spec, spec.sd.value)
        value = spec.value.value if isinstance(spec.value, Measured) else spec.value
        self._value = np.atleast_1d(np.array(value, dtype=float))
        self.count = len(self._value)

    def predict(self, result: Result, keys: Sequence[str]) -> PredictedObservation | None:
        assert result.sensitivities is not None
        name = str(self.spec.quantity)
        slopes = result.sensitivities.slopes[name]
        jacobian = np.stack([np.atleast_1d(np.array(slopes[key])) for key in keys], axis=1)
        return PredictedObservation(np.atleast_1d(np.array(result.quantities[name])) - self._value, jacobian)


class ObservedMesh(Observed):
    """A mesh with the nodes of the given one at their observed positions."""

    def __init__(self, spec: Observation, deviation: float, job: Job, body: Body) -> None:
        super().__init__(spec, deviation)
        mesh: dict[str, Any] = {"file": spec.mesh, "geometry_degree": body.source.degree}
        if "unit" in spec.model_fields_set:
            mesh["unit"] = spec.unit
        source = read_same_cells(MeshSpec.model_construct(**mesh), job, body, "The observed mesh")
        self._points = gather_rows(body, source.points)
        self.count = 0 if self._points is None else self._points.size

    def predict(self, result: Result, keys: Sequence[str]) -> PredictedObservation | None:
        arrays = [gather_rows(result.body, reorder_to_source(result.body, n)) for n in self._nodes(result, keys)]
        if self._points is None:
            return None
        nodes, *slopes = (array.ravel() for array in arrays if array is not None)
        return PredictedObservation(nodes - self._points.ravel(), np.stack(slopes, axis=1))


class ObservedLandmarks(Observed):
    """Material points by their position in the given mesh."""

    def __init__(self, spec: Observation, deviation: float, job: Job, body: Body) -> None:
        super().__init__(spec, deviation)
        if isinstance(spec.landmarks, str):
            path = job.resolve(spec.landmarks)
            rows = on_root(body.mesh.comm, lambda: read_table(path, 6)) * spec.unit
        else:
            rows = np.array([[*landmark.at, *landmark.observed] for landmark in spec.landmarks or ()])
        self._observed = rows[:, 3:]
        self.count = self._observed.size
        self._places = _located(body, rows[:, :3], "landmark {}: its position", "Landmarks begin with")

    def predict(self, result: Result, keys: Sequence[str]) -> PredictedObservation | None:
        arrays = [
            np.concatenate([position(result.body, place, nodes) for place in self._places])
            for nodes in self._nodes(result, keys)
        ]
        return PredictedObservation(arrays[0] - self._observed.ravel(), np.stack(arrays[1:], axis=1))


class ObservedStrains(Observed):
    """Relative changes of the lengths of lines from the given body."""

    def __init__(self, spec: Observation, body: Body) -> None:
        super().__init__(spec, spec.sd.value)
        self._strains = np.array([entry.strain for entry in spec.strains or ()])
        self.count = len(self._strains)
        lines = [np.array(entry.line) for entry in spec.strains or ()]
        self._lengths = np.array([np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line in lines])
        self._lines = [
            _located(body, np.array(line), f"strains[{i}]: point {{}}", "Lines are given by")
            for i, line in enumerate(lines)
        ]

    def predict(self, result: Result, keys: Sequence[str]) -> PredictedObservation | None:
        nodes = self._nodes(result, keys)
        strains, slopes = [], []
        for places, length in zip(self._lines, self._lengths, strict=True):
            sides, *changes = (
                np.diff([position(result.body, place, array) for place in places], axis=0) for array in nodes
            )
            sizes = np.linalg.norm(sides, axis=1)
            strains.append(sizes.sum() / length - 1)
            slopes.append([((sides * change).sum(axis=1) / sizes).sum() / length for change in changes])
        jacobian = np.array(slopes).reshape(len(strains), len(keys))
        return PredictedObservation(np.array(strains) - self._strains, jacobian)


class ObservedSurface(Observed):
    """Points on a region of the boundary."""

    def __init__(self, spec: Observation, deviation: float, job: Job, body: Body) -> None:
        super().__init__(spec, deviation)
        path = job.resolve(str(spec.surface))

        def read() -> Floats:
            from hpcinv.mesh.io.surface_files import read_points  # loads VTK

            return read_table(path, 3) if suffix_of(path) in TABLES else read_points(path)

        self._points = on_root(body.mesh.comm, read) * spec.unit
        self._facets = None if spec.on is None else body.boundary_facets(spec.on, _REMEDY)
        self.count = len(self._points)

    def predict(self, result: Result, keys: Sequence[str]) -> PredictedObservation | None:
        def chosen(facets: LocalIndices, _cells: LocalIndices, _middles: Floats) -> Floats:
            mine = np.ones(len(facets)) if self._facets is None else np.isin(facets, self._facets).astype(float)
            return mine[:, None]

        surfaces = [gather_surface(result.body, nodes, chosen) for nodes in self._nodes(result, keys)]
        known = [surface for surface in surfaces if surface is not None]
        if not known:
            return None
        fine = (n for n in _DIVISIONS if known[0].chord_error(n) <= _FLAT * self.deviation)
        divisions = next(fine, _DIVISIONS[-1])
        facets = np.flatnonzero(known[0].values[:, 0] > 0)
        cuts = [surface.cut(divisions, facets) for surface in known]
        import pyvista

        corners = cuts[0].corners
        cells, nearest = pyvista.PolyData.from_regular_faces(cuts[0].points, corners).find_closest_cell(
            self._points, return_closest_point=True
        )
        triangles = cuts[0].points[corners[cells]]
        weights = barycentric(triangles, np.asarray(nearest))
        normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        offsets = np.einsum("nv,nvi->ni", weights, triangles) - self._points
        moved = [np.einsum("nv,nvi->ni", weights, cut.points[corners[cells]]) for cut in cuts[1:]]
        jacobian = np.stack([np.einsum("ni,ni->n", normals, m) for m in moved], axis=1)
        # Along the normal alone: at the rim of a region errors along the surface say nothing.
        return PredictedObservation(np.einsum("ni,ni->n", normals, offsets), jacobian)


def observations_of(job: Job, body: Body) -> list[Observed]:
    """Read the observations of a job; collective.

    Raises:
        MeshError: on all ranks, if one does not fit the mesh.
    """
    section = job.identify
    assert section is not None
    observations: list[Observed] = []
    for i, spec in enumerate(section.observations):
        deviation = float(np.hypot(spec.sd.value, section.given_sd or 0.0))
        with naming_field(f"{job.path}: identify.observations[{i}] ({spec.name})"):
            match spec.kind:
                case "quantity":
                    observations.append(ObservedQuantity(spec))
                case "curve" | "klotz":
                    observations += [ObservedQuantity(point) for point in _points_of_curve(spec, job, body)]
                case "mesh":
                    observations.append(ObservedMesh(spec, deviation, job, body))
                case "landmarks":
                    observations.append(ObservedLandmarks(spec, deviation, job, body))
                case "strains":
                    observations.append(ObservedStrains(spec, body))
                case _:
                    observations.append(ObservedSurface(spec, deviation, job, body))
                    check_size(observations[-1]._points, body)  # type: ignore[attr-defined]
    return observations


def _located(body: Body, points: Floats, name: str, advice: str) -> list[PointLocation]:
    """Return where points (n, 3) m of the given mesh lie; collective.

    Args:
        name: of a point, with braces for its number.
        advice: begin of what to do about a point outside of the body.

    Raises:
        MeshError: on all ranks, if one is outside of the body.
    """
    places, found = locate(body, map(tuple, points.tolist())), list[PointLocation]()
    for number, point in enumerate(map(tuple, points.tolist())):
        if (place := places[point]) is None:
            coordinates = ", ".join(f"{c:g}" for c in point)
            raise MeshError(
                f"{name.format(number)} ({coordinates}) m in the given mesh is outside of the body",
                f"{advice} positions in the given mesh; check their unit.",
            )
        found.append(place)
    return found


def _points_of_curve(spec: Observation, job: Job, body: Body) -> list[Observation]:
    """Return the observation of a curve as observations of volumes; collective."""
    curve = filling_curve(spec, job, body)
    points = filling_points(str(spec.cavity), job.cavities, job.quantities, job.states)
    return [
        spec.model_copy(
            update={
                "name": f"{spec.name}: {point.quantity}",
                "quantity": point.quantity,
                "value": Measured(curve.volume(point.pressure), CUBIC),
                **dict.fromkeys(("curve", "klotz", "cavity")),
            }
        )
        for point in points
    ]


def check_size(points: Floats, body: Body) -> None:
    """Check that points have about the size of the body; collective.

    Raises:
        MeshError: on all ranks, if not.
    """
    size = diagonal(body.mesh.comm, body.given_nodes)
    extent = float(np.linalg.norm(np.ptp(points, axis=0)))
    if extent > _SIZE * size or (len(points) > 3 and extent < size / _SIZE / 10):
        raise MeshError(
            f"its points extend over {extent:.3g} m, and the body over {size:.3g} m",
            "Give the length unit of the file as 'unit'.",
        )


def gather_rows(body: Body, rows: Floats) -> Floats | None:
    """Return the rows of all ranks on rank 0, ``None`` on others; collective."""
    parts = body.mesh.comm.gather(rows)
    return None if parts is None else np.concatenate(parts)


def read_table(path: Path, columns: int) -> Floats:
    """Read numbers (n, columns) from a table, with or without lines of titles and a first column of labels.

    Raises:
        MeshError: it cannot be read, or has other columns.
    """
    wanted = "x, y, z of the point in the given mesh, and as observed" if columns == 6 else "x, y, z"
    advice = f"Each line has {columns} numbers, {wanted}; give their length unit as 'unit'."
    table: list[list[float]] = []
    try:
        ways = [_points(way.rows, columns) for way in readings_of(path, _LARGEST_TABLE)]
    except ValueError as error:
        raise MeshError(f"{path}: {error}", advice) from None
    rows = max(ways, key=lambda rows: sum(len(row.entries) == columns and row.has_only_numbers for row in rows))
    for row in rows:
        if len(row.entries) != columns:
            raise MeshError(f"{path}: line {row.line}: has {len(row.entries)} entries, not {columns}", advice)
        try:
            table.append([row.number(i) for i in range(columns)])
        except ValueError as error:
            raise MeshError(f"{path}: line {row.line}: {error}", advice) from None
        if not np.isfinite(table[-1]).all():
            raise MeshError(f"{path}: line {row.line}: has a number that is too large", advice)
    if not table:
        raise MeshError(f"{path}: has no points", advice)
    return np.array(table)


def _points(rows: Iterable[Row | tuple[int, str]], columns: int) -> list[Row]:
    """Return the rows below the titles, without labels ahead of their numbers."""
    points = below_titles([row for row in rows if isinstance(row, Row)], (columns, columns + 1))
    return [row.without_first() if len(row.entries) == columns + 1 and not row.is_number(0) else row for row in points]
