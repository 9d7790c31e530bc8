"""True geometry of a body: the same cells with a geometry of higher degree.

It is known for generators, which put the nodes of a higher degree on the CAD surfaces, and for mesh files of degree 2
that a job reads as degree 1.
"""

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import basix
import basix.cell
import numpy as np
from dolfinx import fem

from hpcinv.errors import MeshError
from hpcinv.mesh.cells import jacobians, scalar_element, vertex_count
from hpcinv.mesh.checks import CHUNK, determinants
from hpcinv.mesh.regions import Mesh
from hpcinv.mesh.source import Floats, Ints, MeshSource
from hpcinv.mesh.topology import FacetTable

SAME = (
    1e-6  # distance of nodes, relative to the cell size, up to which they count as the same (rounding of the generator)
)
NO_CAD = "the mesh file contains no geometry beyond its cells"
EDGE = 0.0025  # smallest ratio of eigenvalues of the sum of n⊗n at an edge: about 0.1 rad between normals
OTHER_CELLS = "its generator or file gives other cells"


@dataclass(frozen=True)
class FinerGeometry:
    """The same cells with a geometry of a higher degree.

    Attributes:
        unknown: reason why the true geometry is unknown; empty if it is known.
        source: the cells; ``None`` if the geometry of the mesh is the true one, or if that is unknown.
    """

    unknown: str = ""
    source: MeshSource | None = None


def of_file(source: MeshSource, read: Callable[[], MeshSource]) -> FinerGeometry:
    """Geometry of a mesh file, which ``read`` returns, beyond the degree of ``source``; not collective."""
    try:
        whole = read()
    except MeshError as error:
        return FinerGeometry(f"the mesh file could not be read again: {error}")
    if whole.degree <= source.degree:
        return FinerGeometry(NO_CAD)
    return _compared(source, whole, lambda: whole)


def of_generator(source: MeshSource, generate: Callable[[int], MeshSource]) -> FinerGeometry:
    """Geometry of the CAD model of a generator for a mesh that it made, or a refinement of it; not collective.

    Cells of degree 1 become cells of degree 2, and cells of degree 2 become cells of degree 4.

    Args:
        generate: returns the generated mesh with a geometry of this degree.
    """
    try:
        finer = generate(2 * source.degree)
    except MeshError as error:
        return FinerGeometry(f"the mesh could not be made with a geometry of degree {2 * source.degree}: {error}")
    if not finer.on_cad or finer.kind != source.kind:
        return FinerGeometry(NO_CAD)
    return _compared(source, finer, lambda: finer if source.degree == 1 else _along_normals(source, finer))


def _compared(source: MeshSource, finer: MeshSource, take: Callable[[], MeshSource]) -> FinerGeometry:
    """Result of ``take()`` if ``finer`` has the same cells with nodes at other places, otherwise none.

    A refined mesh has other cells; its geometry is then the true one only if all faces of the body are flat.
    """
    corners = [s.points[s.cells[:, : vertex_count(s.kind)]] for s in (source, finer)]
    alike = corners[0].shape == corners[1].shape
    if not alike or np.abs(corners[0] - corners[1]).max() > SAME * _sizes(corners[0]).min():
        return FinerGeometry("" if _agrees(1, corners[1], finer) else OTHER_CELLS)
    if _agrees(source.degree, source.points[source.cells], finer):
        return FinerGeometry()
    taken = take()
    least, most = determinants(taken)
    if least.min() <= 0 <= most.max():
        return FinerGeometry(f"cells with a geometry of degree {taken.degree} would be inverted")
    return FinerGeometry(source=taken)


def _agrees(degree: int, nodes: Floats, finer: MeshSource) -> bool:
    """Return whether cells of this ``degree`` with ``nodes`` (c, n, 3) have the geometry of ``finer``."""
    shapes = _shapes(finer.kind, degree, scalar_element(finer.kind, finer.degree).points)
    for start in range(0, len(nodes), CHUNK):
        part = slice(start, start + CHUNK)
        offsets = finer.points[finer.cells[part]] - shapes @ nodes[part]
        if (np.linalg.norm(offsets, axis=2).max(axis=1) > SAME * _sizes(nodes[part])).any():
            return False
    return True


def _sizes(nodes: Floats) -> Floats:
    """Diagonals (c,) of the bounding boxes of cells with nodes (c, n, 3)."""
    return np.asarray(np.linalg.norm(np.ptp(nodes, axis=1), axis=1))


def _shapes(kind: str, degree: int, at: Floats) -> Floats:
    """Shape functions (points, nodes) of the coordinate element at points of the reference cell."""
    return np.asarray(scalar_element(kind, degree).tabulate(0, at)[0, :, :, 0])


def _along_normals(quadratic: MeshSource, quartic: MeshSource) -> MeshSource:
    """The cells of degree 2 with degree 4: surface nodes move along the normals onto the surface of ``quartic``.

    Degree 3 would be no better than degree 2, because interpolation at equidistant nodes gains an order at even
    degrees. Nodes do not move along the surface, and inner nodes stay where cells of degree 2 have them: otherwise
    finite-element spaces would approximate smooth functions on the cells of degree 2 less well.
    """
    kind, nodes = quadratic.kind, scalar_element(quadratic.kind, 4)
    before = np.empty_like(quartic.points)
    shapes = _shapes(kind, 2, nodes.points)
    for part in _chunks(np.arange(len(quartic.cells))):
        before[quartic.cells[part]] = shapes @ quadratic.points[quadratic.cells[part]]
    normals = np.zeros((len(before), 3, 3))
    outward = basix.cell.facet_outward_normals(basix.CellType[kind])
    for facet, cells in enumerate(_surface(quadratic)):
        dofs = nodes.entity_closure_dofs[2][facet]
        for part in _chunks(cells):
            gradients = jacobians(kind, 4, quartic.points[quartic.cells[part]], nodes.points[dofs])
            normal = np.linalg.solve(gradients.swapaxes(2, 3), outward[facet][:, None])[..., 0]
            normal /= np.linalg.norm(normal, axis=2, keepdims=True)
            np.add.at(normals, quartic.cells[part][:, dofs], normal[..., :, None] * normal[..., None, :])
    return dataclasses.replace(quartic, points=before + _along(normals, quartic.points - before))


def _chunks(cells: Ints) -> list[Ints]:
    return np.array_split(cells, 1 + len(cells) // CHUNK)


def _surface(source: MeshSource) -> Iterator[Ints]:
    """For each facet of the reference cell, the cells where it is on the boundary or between two volume groups."""
    table = FacetTable.of(source.kind, source.cells[:, : vertex_count(source.kind)])
    on_surface = (table.sharing == 1) | table.separates(source.labels(3))
    for facets in table.of_cell.T:
        yield np.flatnonzero(on_surface[facets])


def _along(normals: Floats, offset: Floats) -> Floats:
    """Component of each ``offset`` (n, 3) in the span of its normals, given the sums of their dyads (n, 3, 3)."""
    share, directions = np.linalg.eigh(normals)
    used = share > EDGE * np.maximum(share[:, -1:], 1e-300)
    components = np.einsum("nji,nj->ni", directions, offset) * used
    return np.asarray(np.einsum("nij,nj->ni", directions, components))


def on_mesh(mesh: Mesh, function: fem.Function) -> fem.Function:
    """The function with the same reference coordinates on another mesh of the same cells (see `with_geometry`)."""
    given = function.function_space
    if given.mesh is mesh:
        return function
    taken = fem.Function(fem.functionspace(mesh, given.ufl_element()), name=function.name)
    here, there = taken.function_space.dofmap, given.dofmap
    taken.x.array.reshape(-1, here.bs)[here.list] = function.x.array.reshape(-1, there.bs)[there.list]
    return taken
