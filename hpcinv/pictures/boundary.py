"""The boundary of a body as triangles, with the results there; a small file for pictures, also of large bodies."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from hpcinv.certificate.surface import gather_surface
from hpcinv.errors import OutputError
from hpcinv.files.atomic import output_errors, replace
from hpcinv.mesh.cells import jacobians, scalar_element
from hpcinv.mesh.source import Floats, Ints
from hpcinv.parallel.runtime import on_root

if TYPE_CHECKING:
    from dolfinx.fem import Function

    from hpcinv.certificate import Estimate
    from hpcinv.mesh import Body
    from hpcinv.mesh.regions import LocalIndices
    from hpcinv.results.solution import Solution

NAME = "surface.npz"
_ARRAYS = ("points", "others", "triangles", "stress", "J", "error")
_REGION = "region:"
_SIDES = 2  # parts of each side of a curved facet


@dataclass(frozen=True)
class Boundary:
    """Triangles of the boundary, oriented with their normals out of the body.

    Attributes:
        points: of the given mesh, (n, 3) m.
        others: the same points in the body that was found, (n, 3) m; the given ones if there is none.
        triangles: rows of ``points``, (m, 3).
        regions: for each name, the triangles on facets or cells of that region, (m,).
        stress: mean Cauchy stress of the cell behind each triangle, (m, 9) Pa, row by row.
        J: mean volume ratio there, (m,).
        error: estimated error of the displacement gradient there, root mean square over the cell, (m,).
        direction: of the analysis that found ``others``.
    """

    points: Floats
    others: Floats
    triangles: Ints
    regions: Mapping[str, npt.NDArray[np.bool_]] = field(default_factory=dict)
    stress: Floats | None = None
    J: Floats | None = None
    error: Floats | None = None
    direction: str = ""

    @property
    def displacement(self) -> Floats:
        """Displacement from the reference body to the current one, (n, 3) m."""
        return (self.others - self.points) * (1 if self.direction == "forward" else -1)


def boundary_of(body: Body, solution: Solution | None = None, estimate: Estimate | None = None) -> Boundary | None:
    """Gather the boundary of a body and of what was found of it on rank 0, ``None`` on others; collective."""
    regions = {name: region for name, region in body.regions.items() if region.origin != "built in"}
    columns = len(regions) + (10 if solution else 0) + (1 if estimate else 0)

    def evaluate(facets: LocalIndices, cells: LocalIndices) -> Floats:
        found: list[Floats | npt.NDArray[np.bool_]] = [
            np.isin(facets, one.facets) | np.isin(cells, one.cells) for one in regions.values()
        ]
        if solution:
            found.append(_in(solution.J, cells))
            found.extend(_in(solution.cauchy_stress, cells).reshape(-1, 9).T)
        if estimate:
            found.append(np.sqrt(estimate.cells[cells] / _volumes(body, cells)))
        return np.array(found, dtype=float).reshape(columns, len(facets)).T

    nodes = solution.mesh_nodes if solution else body.mesh.geometry.x * body.length_scale
    given = gather_surface(body, nodes, evaluate)
    found = gather_surface(body, solution.other_nodes) if solution else given
    if given is None or found is None:
        return None
    divisions = 1 if given.degree == 1 else _SIDES
    every = np.arange(len(given.nodes))
    cut = given.cut(divisions, every)
    values, n = given.values[cut.facet], len(regions)
    return Boundary(
        points=cut.points,
        others=found.cut(divisions, every).points if solution else cut.points,
        triangles=cut.corners,
        regions={name: values[:, i] > 0 for i, name in enumerate(regions)},
        J=values[:, n] if solution else None,
        stress=values[:, n + 1 : n + 10] if solution else None,
        error=values[:, n + 10] if estimate else None,
        direction=solution.direction if solution else "",
    )


def _in(function: Function, cells: LocalIndices) -> Floats:
    """Values of a piecewise constant function, (cells, components)."""
    space = function.function_space
    values = function.x.array.reshape(-1, space.dofmap.index_map_bs)[space.dofmap.list[cells, 0]]
    return np.asarray(values.squeeze(axis=1) if values.shape[1] == 1 else values)


def _volumes(body: Body, cells: LocalIndices) -> Floats:
    """Volumes of cells in scaled lengths, from the Jacobian in their middle: exact for straight cells."""
    geometry, kind = body.mesh.geometry, body.source.kind
    middle = scalar_element(kind, 1).points.mean(axis=0)[None]
    matrices = jacobians(kind, body.source.degree, geometry.x[geometry.dofmaps[0][cells]], middle)[:, 0]
    return np.asarray(np.abs(np.linalg.det(matrices)) / (6.0 if kind == "tetrahedron" else 1.0))


def write_boundary(path: Path, body: Body, solution: Solution, estimate: Estimate | None) -> None:
    """Write the boundary as compressed NumPy arrays (.npz), completely or not at all; collective.

    Raises:
        OutputError: on every rank, if it cannot be written.
    """
    boundary = boundary_of(body, solution, estimate)

    def save() -> None:
        arrays = {name: getattr(boundary, name) for name in _ARRAYS}
        arrays = {name: values for name, values in arrays.items() if values is not None}
        assert boundary is not None  # on rank 0
        arrays |= {_REGION + name: inside for name, inside in boundary.regions.items()}
        stream = io.BytesIO()
        np.savez_compressed(stream, direction=np.array(boundary.direction), **arrays)
        with output_errors(path, "Is there space left?"):
            replace(path, stream.getvalue())

    on_root(body.mesh.comm, save)


def read_boundary(path: Path) -> Boundary:
    """Read what `write_boundary` wrote.

    Raises:
        OutputError: it is missing, or damaged.
    """
    try:
        with np.load(path) as found:
            arrays = dict(found)
        return Boundary(
            regions={name.removeprefix(_REGION): arrays.pop(name) for name in list(arrays) if name.startswith(_REGION)},
            direction=str(arrays.pop("direction")),
            **arrays,
        )
    except FileNotFoundError:
        raise OutputError(
            f"{path}: no such file", "A run that finds a shape writes it, unless its job has output.fields: false."
        ) from None
    except (OSError, ValueError, TypeError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise OutputError(f"{path}: cannot be read: {error}", "Run the job again.") from error
