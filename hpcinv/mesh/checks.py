"""Checks of a mesh before anything is solved on it, and cells that a file numbers inside out, as legacy DOLFIN does."""

import dataclasses
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from hpcinv.errors import MeshError
from hpcinv.mesh.cells import jacobians, mirrored, scalar_element, vertex_count
from hpcinv.mesh.source import Floats, Ints, MeshSource
from hpcinv.mesh.topology import FacetTable, neighbour_signs, unique_rows

FLAT = 1e-12  # |det J| / ∏|∂x/∂ξᵢ| below which a cell has no volume: far below any usable sliver, far above round-off
FARTHEST = 1e60  # m; the squares and cubes of larger coordinates overflow
CHUNK = 2_000  # cells at a time, so that the arrays at their points stay in the processor cache

_MIDDLE = np.full((1, 3), 0.25)  # a point of reference tetrahedra and hexahedra


def check(source: MeshSource, *, may_be_cut: bool = False) -> None:
    """Check a whole mesh.

    Args:
        may_be_cut: whether nodes may coincide, as where bodies touch each other.

    Raises:
        MeshError: for node coordinates that are not finite or are duplicated, cells that are duplicated, overlap, are
            inverted or flat, and groups that are empty or contain facets of no cell. Groups may overlap.
    """
    if not np.isfinite(source.points).all():
        raise MeshError(f"{source.path}: some node coordinates are not finite", "Write the mesh again.")
    if (np.abs(source.points) > FARTHEST).any():
        raise MeshError(f"{source.path}: some node coordinates are beyond {FARTHEST:g} m", "Write the mesh again.")
    _check_vertices(source)
    table = FacetTable.build(source.kind, source.cells[:, : vertex_count(source.kind)])
    problems = [
        *(() if may_be_cut else _duplicate_nodes(source)),
        *_duplicate_cells(source),
        *_overlaps(source, table),
        *_bad_cells(source),
        *_bad_groups(source, table),
    ]
    if problems:
        raise MeshError(
            "\n".join(f"{source.path}: {problem}" for problem, _ in problems),
            "\n  ".join(dict.fromkeys(advice for _, advice in problems)),
        )


type MeshProblems = Iterator[tuple[str, str]]


def check_nodes(source: MeshSource) -> None:
    """Raise ``MeshError`` if a cell or facet has a missing node; all other checks rely on this one."""
    for what, entities, tags in (("cell", source.cells, source.cell_tags), ("facet", source.facets, None)):
        wrong = ((entities < 0) | (entities >= len(source.points))).any(axis=1)
        if wrong.any():
            which = f" ({_first_of(tags[wrong], what)})" if tags is not None else ""
            raise MeshError(
                f"{source.path}: {wrong.sum()} {what}s have nodes that do not exist{which};"
                f" the mesh has {len(source.points)} nodes",
                "Write the mesh again.",
            )


def _check_vertices(source: MeshSource) -> None:
    """Raise ``MeshError`` if a cell has a vertex twice; else it would be called inverted, and its facets overlaps."""
    vertices = np.sort(source.cells[:, : vertex_count(source.kind)], axis=1)
    collapsed = (vertices[:, 1:] == vertices[:, :-1]).any(axis=1)
    if collapsed.any():
        raise MeshError(
            f"{source.path}: {collapsed.sum():,} cells are collapsed: they have a vertex twice"
            f" ({_first_of(source.cell_tags[collapsed], 'cell')})",
            "Mesh by tetrahedra alone (Abaqus: Mesh Controls, Tet; Ansys: MSHAPE,1,3D), or by hexahedra of eight"
            " different vertices.",
        )


def _duplicate_cells(source: MeshSource) -> MeshProblems:
    vertices = np.sort(source.cells[:, : vertex_count(source.kind)], axis=1)
    _, place = unique_rows(vertices)
    twice = np.bincount(place)[place] > 1
    if twice.any():
        yield (
            f"{twice.sum()} cells have the same vertices as another ({_first_of(source.cell_tags[twice], 'cell')})",
            "Remove the duplicate cells.",
        )


def _duplicate_nodes(source: MeshSource) -> MeshProblems:
    order = np.lexsort(source.points.T)
    same = (source.points[order[1:]] == source.points[order[:-1]]).all(axis=1)
    if same.any():
        first = int(np.flatnonzero(same)[0])
        pair = sorted(source.node_tags[order[first : first + 2]].tolist())
        yield (
            f"{same.sum()} nodes coincide with another (first: {pair[0]} and {pair[1]}); the body is cut there",
            "Join the parts (gmsh: occ.fragment on the parts, or model.mesh.removeDuplicateNodes());"
            " 'interfaces' tie parts that share no nodes.",
        )


def _overlaps(source: MeshSource, table: FacetTable) -> MeshProblems:
    crowded = table.sharing > 2
    if crowded.any():
        cells = np.flatnonzero(crowded[table.cell_facets].any(axis=1))
        yield (
            f"{crowded.sum()} facets have more than two cells ({_first_of(source.cell_tags[cells], 'cell')})",
            "Remove duplicate cells, such as those that two physical groups of one volume have saved.",
        )


def _bad_cells(source: MeshSource) -> MeshProblems:
    least, most = determinants(source)
    flat = np.minimum(np.abs(least), np.abs(most)) < FLAT
    if flat.any():
        yield (
            f"{flat.sum()} cells have no volume ({_first_of(source.cell_tags[flat], 'cell')})",
            "Mesh again with another size, or optimise the mesh (gmsh: model.mesh.optimize()).",
        )
    # All cells may be numbered left-handed: DOLFINx only needs the same orientation in all of them.
    handed = 1.0 if (least > 0).sum() >= (most < 0).sum() else -1.0
    inverted = ~flat & (np.minimum(least * handed, most * handed) < 0)
    if inverted.any():
        yield (
            f"{inverted.sum()} cells are inverted, with det J < 0 ({_first_of(source.cell_tags[inverted], 'cell')})",
            "Refine where the mesh is curved; where nodes were moved through cells, mesh again.",
        )


def determinants(source: MeshSource) -> tuple[Floats, Floats]:
    """Smallest and largest det J / ∏|∂x/∂ξᵢ| of each cell, over its nodes and the nodes of degree 4."""
    constant = source.kind == "tetrahedron" and source.degree == 1
    reference_points = np.zeros((1, 3))
    if not constant:
        reference_points = np.concatenate([scalar_element(source.kind, d).points for d in {source.degree, 4}])
    least, most = np.empty(len(source.cells)), np.empty(len(source.cells))
    for start in range(0, len(source.cells), CHUNK):
        part = slice(start, start + CHUNK)
        gradient = jacobians(source.kind, source.degree, source.points[source.cells[part]], reference_points)
        scale = np.linalg.norm(gradient, axis=2).prod(axis=2)
        shape = np.divide(det(gradient), scale, out=np.zeros_like(scale), where=scale > 0)
        least[part], most[part] = shape.min(axis=1), shape.max(axis=1)
    return least, most


def det(matrices: Floats) -> Floats:
    """Determinants of matrices (…, 3, 3); much faster than by numpy.linalg.det, which factorizes each of them."""
    (a, b, c), (d, e, f), (g, h, i) = np.moveaxis(matrices, (-2, -1), (0, 1))
    return np.asarray(a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g))


def _bad_groups(source: MeshSource, table: FacetTable) -> MeshProblems:
    facet_rows = table.find(source.facets[:, : table.vertices.shape[1]])
    for group in source.groups:
        if not len(group.members):
            yield f"physical group '{group.name}' is empty", "Add meshed entities to it, or delete it."
        elif group.dim == 2 and (facet_rows[group.members] < 0).any():
            yield (
                f"{(facet_rows[group.members] < 0).sum()} facets of physical group '{group.name}' belong to no cell",
                "A surface group must lie on the boundary of, or between, meshed volumes.",
            )


def _first_of(tags: Ints, what: str) -> str:
    head = ", ".join(str(t) for t in tags[:5])
    return f"{what}{'s' if len(tags) > 1 else ''} {head}{', …' if len(tags) > 5 else ''}"


def consistently_oriented(source: MeshSource) -> MeshSource:
    """Return a mesh of solids in which only inverted cells have a negative determinant, if others have a positive one.

    Cells on both sides of a facet are both inverted or both not; of cells on one side of it, one is inverted. Inverted
    are the fewer ones of each connected part. A note gives the number of cells that are renumbered.
    """
    vertices = source.cells[:, : vertex_count(source.kind)]
    with np.errstate(all="ignore"):  # coordinates are checked later
        is_negative = det(jacobians(source.kind, 1, source.points[vertices], _MIDDLE)[:, 0]) < 0
    if is_negative.all() or not is_negative.any():
        return source
    changed = is_negative != _inverted(source, vertices)
    if not changed.any():
        return source
    cells = source.cells.copy()
    cells[changed] = mirrored(source.kind, source.degree, cells[changed])
    note = f"{np.count_nonzero(changed):,} cells were numbered inside out (det J < 0) and have been renumbered"
    return dataclasses.replace(source, cells=cells, notes=(*source.notes, note))


def _inverted(source: MeshSource, vertices: Ints) -> npt.NDArray[np.bool_]:
    """Mask of the inverted cells, by the sides of facets on which cells are, whatever the order of their nodes."""
    table = FacetTable.build(source.kind, vertices)
    first, second, third = (source.points[table.vertices[:, i]] for i in range(3))
    normals = np.cross(second - first, third - first)
    offsets = source.points[vertices].mean(axis=1)[:, None] - first[table.cell_facets]
    is_above = (offsets * normals[table.cell_facets]).sum(axis=2).ravel() > 0
    order = np.argsort(table.cell_facets.ravel(), kind="stable")
    inner = order[table.sharing[table.cell_facets.ravel()[order]] == 2].reshape(-1, 2)
    one, other = (inner // table.cell_facets.shape[1]).T
    agree = np.where(is_above[inner[:, 0]] != is_above[inner[:, 1]], 1, -1)
    sign, part = neighbour_signs(one, other, agree, len(vertices))
    is_unlike = sign < 0
    shares = np.bincount(part, is_unlike) / np.maximum(np.bincount(part), 1)
    return np.asarray(is_unlike != (shares[part] > 0.5))
