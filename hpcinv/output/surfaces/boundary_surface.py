"""The boundary of a body as triangles, with the results there; a small file for pictures, also of large bodies."""

import io
import zipfile
import zlib
from collections.abc import Collection, Mapping
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hpcinv.base.files.atomic import write_output
from hpcinv.base.quantity.arrays import Floats, Ints
from hpcinv.base.quantity.units import readable
from hpcinv.base.reading.door import admitted
from hpcinv.errors import OutputError
from hpcinv.job.body_kinds import KINDS, SOLID

NAME = "surface.npz"
_REGION, _RESULT, _FIBRES = "region:", "result:", "fibres:"
# What reading a damaged .npz raises.
DAMAGE = (OSError, ValueError, TypeError, KeyError, EOFError, NotImplementedError, zipfile.BadZipFile, zlib.error)
_AGAIN = "Run the job again."


@dataclass(frozen=True)
class BoundaryResult:
    """One solution on the boundary.

    Attributes:
        state: name of the state of the body; empty in a job without states.
        direction: of the solve.
        mesh: the points on the mesh of the solve, (n, 3) m.
        others: the points of the computed body, (n, 3) m.
        stress: mean Cauchy stress of the cell behind each triangle, (m, 9) Pa, row by row.
        J: mean volume ratio there, (m,).
        stretches: principal stretches in the middle of that cell, largest first, (m, 3). Of a shell all three are in
            the middle of the facet, on the face.
        crossing: triangles of facets where the computed body passes through itself, (m,); looked for only if the
            certificate says that it does.
        fibres: by family, unit directions in that cell of the loaded body, (m, 3).
    """

    state: str
    direction: str
    mesh: Floats
    others: Floats
    stress: Floats
    J: Floats
    stretches: Floats
    crossing: npt.NDArray[np.bool_]
    fibres: Mapping[str, Floats] = field(default_factory=dict)

    @property
    def displacement(self) -> Floats:
        """Displacement from the reference body to the current one, (n, 3) m."""
        return (self.others - self.mesh) * (1 if self.direction == "forward" else -1)


@dataclass(frozen=True)
class Boundary:
    """Triangles of the boundary of the given mesh, oriented with their normals out of the body.

    Attributes:
        points: (n, 3) m.
        triangles: rows of ``points``, (m, 3).
        regions: for each name, the triangles on facets or cells of that region, (m,).
        results: what was found, for each state of the body; empty before a run.
        error: estimated error of the displacement gradient in the cell behind each triangle, root mean square, (m,).
        fibres: by family, unit directions on the undeformed body in the cell behind each triangle, (m, 3).
        body_kind: name of the kind of the body; if that has faces, stresses and stretches are on them.
    """

    points: Floats
    triangles: Ints
    regions: Mapping[str, npt.NDArray[np.bool_]] = field(default_factory=dict)
    results: tuple[BoundaryResult, ...] = ()
    error: Floats | None = None
    fibres: Mapping[str, Floats] = field(default_factory=dict)
    body_kind: str = SOLID.name

    @property
    def faces(self) -> tuple[str, ...]:
        """Regions of the two faces of a body of cells through its thickness; none of others."""
        return KINDS[self.body_kind].faces

    @property
    def size(self) -> str:
        """Sides of the box around the body, as text."""
        return " x ".join(readable(float(side), "m") for side in np.ptp(self.points, axis=0))

    def region_mask(self, region: str) -> npt.NDArray[np.bool_]:
        """Return which triangles are in a region, (m,); all of them are in ``boundary``."""
        every = np.ones(len(self.triangles), dtype=bool)
        return every if region == "boundary" else self.regions.get(region, ~every)

    def spread(self, region: str, most: int) -> Ints:
        """Return the rows of some triangles of a region, evenly distributed: each is the farthest from those before."""
        rows = np.flatnonzero(self.region_mask(region))
        centres = self.points[self.triangles[rows]].mean(axis=1)
        chosen, distance = [0][: len(rows)], np.full(len(rows), np.inf)
        while len(chosen) < min(most, len(rows)):
            distance = np.minimum(distance, np.linalg.norm(centres - centres[chosen[-1]], axis=1))
            chosen.append(int(distance.argmax()))
        return np.asarray(rows[chosen])


def write_boundary(path: Path, boundary: Boundary) -> None:
    """Write a boundary as compressed NumPy arrays (.npz); raises ``OutputError`` if that fails."""
    arrays: dict[str, Any] = {"points": boundary.points, "triangles": boundary.triangles}
    if boundary.error is not None:
        arrays["error"] = boundary.error
    arrays["body_kind"] = np.array(boundary.body_kind)
    arrays |= {_REGION + name: mask for name, mask in boundary.regions.items()}
    arrays |= {_FIBRES + name: directions.astype(np.float32) for name, directions in boundary.fibres.items()}
    for i, result in enumerate(boundary.results):
        head = f"{_RESULT}{i}:"
        own = {name: np.asarray(value) for name, value in vars(result).items() if name != "fibres"}
        own |= {_FIBRES + name: directions.astype(np.float32) for name, directions in result.fibres.items()}
        arrays |= {head + name: value for name, value in own.items()}
    write_arrays(path, arrays)


def write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write compressed NumPy arrays (.npz), completely or not at all; raises ``OutputError`` if that fails."""
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    write_output(path, stream.getvalue(), "Is there space left?")


def _taken(arrays: dict[str, Any], prefix: str) -> dict[str, Any]:
    """Remove the arrays whose names have a prefix; return them by the rest of their names."""
    return {key.removeprefix(prefix): arrays.pop(key) for key in list(arrays) if key.startswith(prefix)}


def _results_in(arrays: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the arguments of each `BoundaryResult` of arrays ``NUMBER:NAME``."""
    results: dict[str, dict[str, Any]] = {}
    for key, value in arrays.items():
        number, name = key.split(":", 1)
        results.setdefault(number, {})[name] = value if value.ndim else str(value)
    for result in results.values():
        result["fibres"] = _taken(result, _FIBRES)
    return [*results.values()]


def read_boundary(path: Path) -> Boundary:
    """Read what `write_boundary` wrote.

    Raises:
        OutputError: it is missing, damaged, or of another version of hpcinv.
    """
    try:
        with np.load(admitted(path)) as stored:
            arrays = dict(stored)
        regions, directions = _taken(arrays, _REGION), _taken(arrays, _FIBRES)
        results = _results_in(_taken(arrays, _RESULT))
        for kind, given in ((Boundary, arrays), *((BoundaryResult, result) for result in results)):
            _check_arrays(path, kind, given.keys())
        each = tuple(BoundaryResult(**result) for result in results)
        arrays["body_kind"] = KINDS[str(arrays.get("body_kind", SOLID.name))].name
        boundary = Boundary(regions=regions, results=each, fibres=directions, **arrays)
    except FileNotFoundError:
        raise OutputError(
            f"{path}: no such file", "A run that finds a shape writes it, unless its job has output.fields: false."
        ) from None
    except DAMAGE as error:
        raise OutputError(f"{path}: cannot be read: {error}", _AGAIN) from error
    _check_sizes(path, boundary)
    return boundary


def _check_arrays(path: Path, kind: type[Boundary | BoundaryResult], given: Collection[str]) -> None:
    """Raise ``OutputError`` unless these are the arrays that ``kind`` has now."""
    known = {field.name: field.default is MISSING and field.default_factory is MISSING for field in fields(kind)}
    missing = ", ".join(name for name, needed in known.items() if needed and name not in given)
    unknown = ", ".join(name for name in given if name not in known)
    faults = [f"has no {missing}"] * bool(missing) + [f"has {unknown}, which this version does not know"] * bool(
        unknown
    )
    if faults:
        raise OutputError(f"{path}: {' and '.join(faults)}: another version of hpcinv wrote it", _AGAIN)


def _check_sizes(path: Path, boundary: Boundary) -> None:
    """Raise ``OutputError`` unless each array has a row for each point or triangle."""
    points, triangles = boundary.points.shape, boundary.triangles.shape
    count = triangles[0] if triangles else 0
    triangle_arrays: list[tuple[npt.NDArray[Any], tuple[int, ...]]] = [(mask, ()) for mask in boundary.regions.values()]
    triangle_arrays += [(mask, (3,)) for mask in boundary.fibres.values()]
    triangle_arrays += [(boundary.error, ())] if boundary.error is not None else []
    fits = points[1:] == triangles[1:] == (3,)
    for result in boundary.results:
        fits &= result.mesh.shape == result.others.shape == points
        triangle_arrays += [(result.stress, (9,)), (result.J, ()), (result.stretches, (3,)), (result.crossing, ())]
        triangle_arrays += [(mask, (3,)) for mask in result.fibres.values()]
    fits = fits and all(array.shape == (count, *row) for array, row in triangle_arrays)
    if not fits or not (
        0 <= boundary.triangles.min(initial=0) <= boundary.triangles.max(initial=0) < max(points[0], 1)
    ):
        raise OutputError(f"{path}: is damaged: its arrays do not fit together", _AGAIN)
