"""Gathering of the boundary of a body and of results from all ranks."""

from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.job.fibres import FibreFamily
from hpcinv.mesh import Body
from hpcinv.mesh.cells import jacobians, scalar_element
from hpcinv.mesh.crossing_facets import find_overlap
from hpcinv.mesh.regions import Region
from hpcinv.mesh.source import Floats
from hpcinv.mesh.surface import Surface, Triangles, gather_surface
from hpcinv.output.surfaces.boundary_surface import Boundary, BoundaryResult
from hpcinv.results.cell_fields import cell_fields
from hpcinv.results.cell_middles import deformation_gradients, fibres, unit_vectors
from hpcinv.results.solution import Solution
from hpcinv.trust.certificate import Estimate

_SIDES = 2  # parts of each side of a curved facet


def _named_regions(body: Body) -> dict[str, Region]:
    return {name: region for name, region in body.regions.items() if region.origin != "built in"}


def _in_regions(regions: Mapping[str, Region], facets: LocalIndices, cells: LocalIndices) -> dict[str, Floats]:
    """Return by ``region:NAME`` whether facets, or the cells behind them, are in a region (n, 1)."""
    return {
        f"region:{name}": (np.isin(facets, region.facets) | np.isin(cells, region.cells)).astype(float)[:, None]
        for name, region in regions.items()
    }


def boundary_of(
    body: Body,
    solutions: Sequence[Solution] = (),
    estimate: Estimate | None = None,
    families: Mapping[str, FibreFamily] = MappingProxyType({}),
    *,
    overlapping: Collection[str] = (),
) -> Boundary | None:
    """Gather the boundary of a body and of what was found of it on rank 0, ``None`` on others; collective.

    Args:
        solutions: the first, and one of each further state of the body; others, such as the second one of a round trip,
            are left out.
        estimate: of the first solution.
        families: fibres of the job.
        overlapping: states in which the computed body passes through itself, by the certificate.
    """
    solutions = of_states(solutions)
    regions = _named_regions(body)

    widths = dict[str, int]()  # numbers of each field in a cell

    def evaluate(facets: LocalIndices, cells: LocalIndices, middles: Floats) -> Floats:
        columns = _in_regions(regions, facets, cells) | _fields(body, solutions, families, cells, middles)
        if estimate:
            columns["error"] = error_in(body, solutions[0], estimate, cells)[:, None]
        widths.update({name: values.shape[1] for name, values in columns.items()})
        return np.concatenate([np.zeros((len(facets), 0)), *columns.values()], axis=1)

    nodes = solutions[0].mesh_nodes if solutions else body.given_nodes
    given = gather_surface(body, nodes, evaluate)
    others = [gather_surface(body, solution.other_nodes) for solution in solutions]
    rest = gather_surface(body, solutions[1].mesh_nodes) if len(solutions) > 1 else given
    if given is None or rest is None:
        return None
    cut = cut_of(given)
    values = _columns(given.values[cut.facet], widths)
    meshes = [cut, *[cut_of(rest)] * (len(solutions) - 1)]  # further states are solved from one shape
    return Boundary(
        points=cut.points,
        triangles=cut.corners,
        regions={name: values[f"region:{name}"][:, 0] > 0 for name in regions},
        results=tuple(
            _result(meshes[i], surface, solution, values, i, families, solution.state in overlapping)
            for i, (solution, surface) in enumerate(zip(solutions, filter(None, others), strict=True))
        ),
        fibres={name: values[f"fibre:{name}"] for name in families} if solutions else {},
        error=values["error"][:, 0] if estimate else None,
        body_kind=body.source.body_kind,
    )


def of_states(solutions: Sequence[Solution]) -> list[Solution]:
    """Return the first solution and one of each further state, without the second one of a round trip."""
    return [*solutions[:1], *(solution for solution in solutions[1:] if solution.state)]


def _columns(values: Floats, widths: Mapping[str, int]) -> dict[str, Floats]:
    """Return the columns of each name; ``widths`` are their numbers."""
    ends = np.cumsum([*widths.values()], dtype=np.int64)
    return {name: values[:, end - width : end] for (name, width), end in zip(widths.items(), ends, strict=True)}


def _result(
    mesh: Triangles,
    surface: Surface,
    solution: Solution,
    values: Mapping[str, Floats],
    number: int,
    families: Collection[str],
    is_overlapping: bool,
) -> BoundaryResult:
    """Return the boundary of a solution from the values that `_fields` returns.

    Args:
        mesh: triangles of the shape that it was solved from; surface: of the one that it found.
    """
    crossed = find_overlap(surface).facets if is_overlapping else ()
    return BoundaryResult(
        solution.state,
        solution.direction,
        mesh.points,
        cut_of(surface).points,
        J=values[f"J {number}"][:, 0],
        stress=values[f"stress {number}"],
        stretches=values[f"stretches {number}"],
        crossing=np.isin(mesh.facet, list(crossed)),
        fibres={name: values[f"fibre {number}:{name}"] for name in families},
    )


def _fields(
    body: Body,
    solutions: Sequence[Solution],
    families: Mapping[str, FibreFamily],
    cells: LocalIndices,
    middles: Floats,
) -> dict[str, Floats]:
    """Return the values in local cells of the fields of each solution, and of the undeformed fibres, by name."""
    columns, undeformed = dict[str, Floats](), dict[str, Floats]()
    for number, solution in enumerate(solutions):
        fields = cell_fields(body, solution, cells, middles)
        columns[f"J {number}"] = fields.J[:, None]
        columns[f"stress {number}"] = fields.stress
        columns[f"stretches {number}"] = fields.stretches
        if not families:
            continue
        gradients = deformation_gradients(body, solution, cells)
        if number == 0:
            undeformed = fibres(body, families, solution, gradients, cells)
            columns |= {f"fibre:{name}": directions for name, directions in undeformed.items()}
        for name, directions in undeformed.items():
            columns[f"fibre {number}:{name}"] = unit_vectors(np.einsum("cij,cj->ci", gradients, directions))
    return columns


def cut_of(surface: Surface) -> Triangles:
    """Return the triangles of pictures of a boundary."""
    return surface.cut(1 if surface.degree == 1 else _SIDES, np.arange(len(surface.nodes)))


def error_in(body: Body, solution: Solution, estimate: Estimate, cells: LocalIndices) -> Floats:
    """Return the estimated error of the displacement gradient in local cells, root mean square, (cells,).

    Volumes are by the Jacobian in the middle: exact for straight cells.
    """
    kind, nodes = body.source.kind, solution.mesh_nodes / body.length_scale
    middle = scalar_element(kind, 1).points.mean(axis=0)[None]
    matrices = jacobians(kind, body.degree, nodes[body.mesh.geometry.dofmaps[0][cells]], middle)[:, 0]
    volumes = np.abs(np.linalg.det(matrices)) / (6.0 if kind == "tetrahedron" else 1.0)
    return np.asarray(np.sqrt(estimate.cells[cells] / volumes))
