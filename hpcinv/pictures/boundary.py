"""The boundary of a body as triangles, with the results there; a small file for pictures, also of large bodies."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from hpcinv.errors import OutputError
from hpcinv.files.atomic import output_errors, replace

if TYPE_CHECKING:  # importing the mesh takes seconds
    from hpcinv.mesh.source import Floats, Ints

NAME = "surface.npz"
_REGION, _RESULT, _FIBRES = "region:", "result:", "fibres:"


@dataclass(frozen=True)
class BoundaryResult:
    """One solution on the boundary.

    Attributes:
        state: name of the state of the body; empty in a job without states.
        direction: of the solve.
        mesh: the points on the mesh of the solve, (n, 3) m.
        others: the points of the body that was found, (n, 3) m.
        stress: mean Cauchy stress of the cell behind each triangle, (m, 9) Pa, row by row.
        J: mean volume ratio there, (m,).
        stretches: principal stretches in the middle of that cell, largest first, (m, 3).
        crossing: triangles of facets where the body that was found passes through itself, (m,); looked for only if the
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
    """

    points: Floats
    triangles: Ints
    regions: Mapping[str, npt.NDArray[np.bool_]] = field(default_factory=dict)
    results: tuple[BoundaryResult, ...] = ()
    error: Floats | None = None
    fibres: Mapping[str, Floats] = field(default_factory=dict)


def write_boundary(path: Path, boundary: Boundary) -> None:
    """Write a boundary as compressed NumPy arrays (.npz); raises ``OutputError`` if that fails."""
    arrays: dict[str, Any] = {"points": boundary.points, "triangles": boundary.triangles}
    if boundary.error is not None:
        arrays["error"] = boundary.error
    arrays |= {_REGION + name: inside for name, inside in boundary.regions.items()}
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
    with output_errors(path, "Is there space left?"):
        replace(path, stream.getvalue())


def read_boundary(path: Path) -> Boundary:
    """Read what `write_boundary` wrote.

    Raises:
        OutputError: it is missing, or damaged.
    """
    try:
        with np.load(path) as found:
            arrays = dict(found)
        results: dict[str, dict[str, Any]] = {}
        regions, directions = {}, {}
        for key in list(arrays):
            if key.startswith(_REGION):
                regions[key.removeprefix(_REGION)] = arrays.pop(key)
            elif key.startswith(_FIBRES):
                directions[key.removeprefix(_FIBRES)] = arrays.pop(key)
            elif key.startswith(_RESULT):
                _, number, name = key.split(":", 2)
                value, result = arrays.pop(key), results.setdefault(number, {"fibres": {}})
                if name.startswith(_FIBRES):
                    result["fibres"][name.removeprefix(_FIBRES)] = value
                else:
                    result[name] = value if value.ndim else str(value)
        each = tuple(BoundaryResult(**result) for result in results.values())
        return Boundary(regions=regions, results=each, fibres=directions, **arrays)
    except FileNotFoundError:
        raise OutputError(
            f"{path}: no such file", "A run that finds a shape writes it, unless its job has output.fields: false."
        ) from None
    except (OSError, ValueError, TypeError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise OutputError(f"{path}: cannot be read: {error}", "Run the job again.") from error
