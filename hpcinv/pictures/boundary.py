"""The boundary of a body as triangles, with the results there; a small file for pictures, also of large bodies."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from hpcinv.certificate.surface import Surface, Triangles, gather_surface
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
_REGION, _RESULT = "region:", "result:"
_SIDES = 2  # parts of each side of a curved facet


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
    """

    state: str
    direction: str
    mesh: Floats
    others: Floats
    stress: Floats
    J: Floats

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
    """

    points: Floats
    triangles: Ints
    regions: Mapping[str, npt.NDArray[np.bool_]] = field(default_factory=dict)
    results: tuple[BoundaryResult, ...] = ()
    error: Floats | None = None


def boundary_of(body: Body, solutions: Sequence[Solution] = (), estimate: Estimate | None = None) -> Boundary | None:
    """Gather the boundary of a body and of what was found of it on rank 0, ``None`` on others; collective.

    Args:
        solutions: the first, and those of further states of the body; others, such as the way back of a round trip,
            are left out.
        estimate: of the first solution.
    """
    solutions = [*solutions[:1], *(one for one in solutions[1:] if one.state)]
    regions = {name: region for name, region in body.regions.items() if region.origin != "built in"}

    def evaluate(facets: LocalIndices, cells: LocalIndices) -> Floats:
        found: list[Floats | npt.NDArray[np.bool_]] = [
            np.isin(facets, one.facets) | np.isin(cells, one.cells) for one in regions.values()
        ]
        for solution in solutions:
            found.extend([_in(solution.J, cells), *_in(solution.cauchy_stress, cells).reshape(-1, 9).T])
        if estimate:
            found.append(np.sqrt(estimate.cells[cells] / _volumes(body, cells)))
        return np.array(found, dtype=float).reshape(len(found), len(facets)).T

    nodes = solutions[0].mesh_nodes if solutions else body.mesh.geometry.x * body.length_scale
    given = gather_surface(body, nodes, evaluate)
    others = [gather_surface(body, one.other_nodes) for one in solutions]
    rest = gather_surface(body, solutions[1].mesh_nodes) if len(solutions) > 1 else given
    if given is None or rest is None:
        return None
    cut, n = _cut(given), len(regions)
    meshes = [cut.points, *[_cut(rest).points] * (len(solutions) - 1)]  # further states are solved from one shape
    values = given.values[cut.facet]
    results = []
    for i, (solution, surface) in enumerate(zip(solutions, others, strict=True)):
        assert surface is not None  # on rank 0
        mesh, found = meshes[i], _cut(surface).points
        of_cells = values[:, n + 10 * i : n + 10 * i + 10]
        results.append(
            BoundaryResult(solution.state, solution.direction, mesh, found, stress=of_cells[:, 1:], J=of_cells[:, 0])
        )
    return Boundary(
        points=cut.points,
        triangles=cut.corners,
        regions={name: values[:, i] > 0 for i, name in enumerate(regions)},
        results=tuple(results),
        error=values[:, -1] if estimate else None,
    )


def _cut(surface: Surface) -> Triangles:
    return surface.cut(1 if surface.degree == 1 else _SIDES, np.arange(len(surface.nodes)))


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


def write_boundary(path: Path, body: Body, solutions: Sequence[Solution], estimate: Estimate | None) -> None:
    """Write the boundary as compressed NumPy arrays (.npz), completely or not at all; collective.

    Raises:
        OutputError: on every rank, if it cannot be written.
    """
    boundary = boundary_of(body, solutions, estimate)

    def save() -> None:
        assert boundary is not None  # on rank 0
        arrays: dict[str, Any] = {"points": boundary.points, "triangles": boundary.triangles}
        if boundary.error is not None:
            arrays["error"] = boundary.error
        arrays |= {_REGION + name: inside for name, inside in boundary.regions.items()}
        for i, result in enumerate(boundary.results):
            arrays |= {f"{_RESULT}{i}:{name}": np.asarray(value) for name, value in vars(result).items()}
        stream = io.BytesIO()
        np.savez_compressed(stream, **arrays)
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
        results: dict[str, dict[str, Any]] = {}
        regions = {}
        for key in list(arrays):
            if key.startswith(_REGION):
                regions[key.removeprefix(_REGION)] = arrays.pop(key)
            elif key.startswith(_RESULT):
                _, number, name = key.split(":")
                value = arrays.pop(key)
                results.setdefault(number, {})[name] = value if value.ndim else str(value)
        each = tuple(BoundaryResult(**result) for result in results.values())
        return Boundary(regions=regions, results=each, **arrays)
    except FileNotFoundError:
        raise OutputError(
            f"{path}: no such file", "A run that finds a shape writes it, unless its job has output.fields: false."
        ) from None
    except (OSError, ValueError, TypeError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise OutputError(f"{path}: cannot be read: {error}", "Run the job again.") from error
