"""Named parts of a body: physical groups of the mesh, geometric conditions of the job, and the whole boundary."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import dolfinx
import numpy as np
import numpy.typing as npt

from hpcinv.base.parallel.runtime import MPI, agree
from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.base.quantity.expressions import Expression
from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.errors import HpcinvError, MeshError
from hpcinv.job.region_names import THIN, THIN_REMEDY
from hpcinv.job.region_rules import RegionRule, RegionUnion, SmoothFace, VertexSet
from hpcinv.mesh.boundary_shells import Mesh as Mesh
from hpcinv.mesh.boundary_shells import cavities, outer_facets
from hpcinv.mesh.cells import FACET_KIND, vertex_count
from hpcinv.mesh.extent import extent
from hpcinv.mesh.source import MASK_BITS, Floats, Ints, MeshSource
from hpcinv.on_demand import on_demand

BOUNDARY = "boundary"
_OF_FACETS = {"nx", "ny", "nz", "cavity"}
_NONE = np.zeros(0, dtype=np.int32)


@dataclass(frozen=True)
class Region:
    """A named set of facets and cells: local indices of this rank, and their numbers on all ranks together.

    A set of vertices has none of these, and ``vertices``, with the ``edges`` between two of them.
    """

    name: str
    origin: str  # "physical", "geometric", "union" or "built in"
    facets: LocalIndices
    cells: LocalIndices
    facet_count: int
    cell_count: int
    vertices: LocalIndices | None = None
    edges: LocalIndices | None = None


def build_regions(
    mesh: Mesh, source: MeshSource, rules: Mapping[str, RegionRule], length_scale: float
) -> dict[str, Region]:
    """All regions of a distributed mesh; collective.

    A geometric region contains the boundary facets and the cells all of whose vertices satisfy its condition in SI
    coordinates; if the condition is one of outer normals (``nx``, ``ny``, ``nz``) or cavities, only boundary facets.
    So has a smooth face.
    The comparison has no tolerance: write ``x < 1e-6 m``, not ``x == 0``. A union has all facets and cells of its
    members without the members of regions that it leaves out.

    Raises:
        MeshError: on all ranks, if a condition matches nothing, cannot be evaluated, or has the name of a physical
            group, or if a physical group called "boundary" is not the whole boundary.
    """
    topology = mesh.topology
    topology.create_entities(2)
    topology.create_connectivity(2, 3)
    topology.create_connectivity(2, 0)
    exterior = dolfinx.mesh.exterior_facet_indices(topology).astype(np.int32)
    boundary = _region(mesh, BOUNDARY, "built in", exterior, _NONE)
    regions = {BOUNDARY: boundary} | _physical(mesh, source)
    problems = [f"region '{name}' is also a physical group of the mesh" for name in rules if name in regions]
    if not mesh.comm.allreduce(np.array_equal(regions[BOUNDARY].facets, exterior), MPI.LAND):
        problems.append("the physical group 'boundary' is not the whole boundary; that name is reserved for it")
    builder = _Builder(mesh, source, length_scale, exterior, regions)
    for name, rule in rules.items():
        regions[name], faults = builder.build(name, rule)
        problems += (f"region '{name}': {text}" for text in faults)
    if problems:
        low, high = (", ".join(f"{v:g}" for v in corner) for corner in extent(mesh.comm, builder.points))
        raise MeshError(
            "\n".join(f"{source.path}: {p}" for p in problems),
            f"The mesh extends from ({low}) to ({high}) m; a condition must hold at all vertices of a facet, and a"
            " listed point must be a vertex.",
        )
    return regions


@dataclass(frozen=True)
class _Builder:
    """Builder of the regions that a job defines; methods are collective.

    Attributes:
        exterior: local facets of the boundary.
        regions: built so far, by name.
    """

    mesh: Mesh
    source: MeshSource
    length_scale: float
    exterior: LocalIndices
    regions: Mapping[str, Region]

    @cached_property
    def points(self) -> Floats:
        """Local geometry nodes, (n, 3) in m."""
        return np.asarray(self.mesh.geometry.x * self.length_scale)

    @cached_property
    def cavity(self) -> Ints:
        """Number of the cavity of each boundary facet."""
        return cavities(self.mesh, self.exterior)

    def build(self, name: str, rule: RegionRule) -> tuple[Region, list[str]]:
        """Return the region of a rule, and messages on its faults."""
        if isinstance(rule, RegionUnion):
            return self._union(name, rule)
        if isinstance(rule, SmoothFace):
            point = np.array(rule.point) / self.length_scale
            mask = on_demand("smooth face")(self.mesh, self.exterior, point, rule.angle)
            return _region(self.mesh, name, "geometric", self.exterior[mask], _NONE), []
        if isinstance(rule, VertexSet):
            vertices, edges, far = on_demand("vertices at points")(self.mesh, np.array(rule.points) / self.length_scale)
            faults = list(_far_from(rule, far * self.length_scale))
            return Region(name, "geometric", _NONE, _NONE, 0, 0, vertices, edges), faults
        return self._conditional(name, rule)

    def _union(self, name: str, rule: RegionUnion) -> tuple[Region, list[str]]:
        members, without = (
            [find(self.regions, member, self.source) for member in names] for names in (rule.members, rule.without)
        )
        facets = np.setdiff1d(_joined([m.facets for m in members]), _joined([m.facets for m in without]))
        cells = np.setdiff1d(_joined([m.cells for m in members]), _joined([m.cells for m in without]))
        region = _region(self.mesh, name, "union", facets, cells)
        return region, [] if region.facet_count or region.cell_count else [f"nothing is left of {rule}"]

    def _conditional(self, name: str, condition: Expression) -> tuple[Region, list[str]]:
        """Return the region where a condition holds."""
        error: HpcinvError | None = None
        facets = cells = _NONE
        cavity = self.cavity if "cavity" in condition.names else None
        try:
            if is_facet_condition(condition):
                mask = _facet_mask(self.mesh, name, condition, self.exterior, self.points, cavity)
                facets = self.exterior[mask]
            else:
                is_inside = evaluate(name, condition, self.points)
                owned = np.arange(self.mesh.topology.index_map(3).size_local, dtype=np.int32)
                facets = self.exterior[_all_vertices(self.mesh, 2, self.exterior, is_inside)]
                cells = owned[_all_vertices(self.mesh, 3, owned, is_inside)]
        except HpcinvError as exc:
            error = exc
        except (ArithmeticError, TypeError, ValueError) as exc:
            error = MeshError(f"{self.source.path}: region '{name}': '{condition}' cannot be evaluated: {exc}")
        agree(self.mesh.comm, error)
        region = _region(self.mesh, name, "geometric", facets, cells)
        is_empty = region.facet_count == region.cell_count == 0
        return region, [f"no boundary facet and no cell satisfies '{condition}'"] if is_empty else []


def _far_from(rule: VertexSet, nearest: npt.NDArray[np.float64]) -> Iterator[str]:
    """Yield a message for each point that has no vertex, with the ``nearest`` one (n, 3) m; NaN where there is one."""
    for point, vertex in zip(rule.points, nearest, strict=True):
        if np.isfinite(vertex).all():
            at, other = (", ".join(f"{x:.6g}" for x in place) for place in (point, vertex))
            yield f"there is no vertex at ({at}) m; the nearest is at ({other}) m"


def _joined(parts: list[LocalIndices]) -> LocalIndices:
    return np.concatenate([np.zeros(0, dtype=np.int32), *parts])


def evaluate(name: str, condition: Expression, points: npt.NDArray[np.float64]) -> npt.NDArray[np.bool_]:
    """Mask (n,) of the ``points`` (n, 3), in metres, that satisfy the condition of region ``name``."""
    return _holds(name, condition, dict(zip("xyz", points.T, strict=True)), len(points))


def _holds(
    name: str, condition: Expression, values: Mapping[str, npt.NDArray[np.float64]], count: int
) -> npt.NDArray[np.bool_]:
    is_inside = np.asarray(condition.evaluate(**values))
    if is_inside.dtype != np.bool_:
        raise MeshError(f"region '{name}': '{condition}' is a number, not a condition", "Compare it: x < 1 mm")
    return np.broadcast_to(is_inside, count)


def is_facet_condition(rule: RegionRule) -> bool:
    """Return whether a rule is one of outer normals or cavities, which only facets have, a smooth face, or vertices."""
    return isinstance(rule, SmoothFace | VertexSet) or (isinstance(rule, Expression) and bool(rule.names & _OF_FACETS))


def _facet_mask(
    mesh: Mesh,
    name: str,
    condition: Expression,
    exterior: LocalIndices,
    points: npt.NDArray[np.float64],
    cavity: Ints | None,
) -> npt.NDArray[np.bool_]:
    """Mask of the boundary facets that satisfy the condition of region ``name`` at all their vertices."""
    nodes, areas = outer_facets(mesh, exterior)
    normals = areas / np.maximum(np.linalg.norm(areas, axis=1, keepdims=True), 1e-300)
    repeated = np.repeat(np.arange(len(nodes)), nodes.shape[1])
    values = dict(zip("xyz", points[nodes.ravel()].T, strict=True))
    values |= dict(zip(("nx", "ny", "nz"), normals[repeated].T, strict=True))
    if cavity is not None:
        values["cavity"] = cavity[repeated].astype(np.float64)
    return np.asarray(_holds(name, condition, values, nodes.size).reshape(nodes.shape).all(axis=1))


def find(regions: Mapping[str, Region], name: str, source: MeshSource) -> Region:
    """The region ``name``; raises ``MeshError`` with the names of all regions if there is no such region."""
    if name in regions:
        return regions[name]
    hint = f".{did_you_mean(name, regions, list_all=False)}"
    if name in source.thin_groups:
        raise MeshError(f"{source.path}: no region '{name}': it {THIN}", THIN_REMEDY)
    physical = [r.name for r in regions.values() if r.origin == "physical"]
    no_groups = "" if physical else " The mesh has no physical groups."
    arrays = "; ".join(on_demand("arrays of integers")(source))  # on rank 0, whose message is shown
    labels = f" Arrays of integers can be regions (mesh.labels: {{array: …}}): {arrays}." if arrays else ""
    raise MeshError(
        f"{source.path}: no region '{name}'{hint}",
        f"The regions are: {', '.join(sorted(regions))}.{no_groups}{labels}"
        f" Or define it in the job: regions: {{{name}: 'x < 1e-6 m'}}",
    )


def _physical(mesh: Mesh, source: MeshSource) -> dict[str, Region]:
    """Regions of the physical groups; a surface and a volume of the same name are one region."""
    names = dict.fromkeys(g.name for g in source.groups)
    local = {dim: _distribute(mesh, source, dim) for dim in (2, 3)}
    regions = {}
    for name in names:
        parts = {}
        for dim, entities in local.items():
            members = [entities[i] for i, g in enumerate(source.groups) if g.name == name and g.dim == dim]
            parts[dim] = np.unique(np.concatenate([np.zeros(0, dtype=np.int32), *members]))
        regions[name] = _region(mesh, name, "physical", parts[2], parts[3])
    return regions


def _distribute(mesh: Mesh, source: MeshSource, dim: int) -> dict[int, LocalIndices]:
    """Local entities of dimension ``dim`` of each group of the source, by its index."""
    nodes = source.cells if dim == 3 else source.facets
    members = [i for i, group in enumerate(source.groups) if group.dim == dim]
    if not mesh.comm.allreduce(source.groups_overlap(dim), MPI.LOR):
        entities, labels = _tagged(mesh, dim, nodes, source.labels(dim), -1)
        return {i: entities[labels == i] for i in members}
    parts: dict[int, LocalIndices] = {}
    masks = source.masks(dim)
    for word in range(masks.shape[1]):
        entities, labels = _tagged(mesh, dim, nodes, masks[:, word], 0)
        parts |= {i: entities[labels >> (i % MASK_BITS) & 1 > 0] for i in members if i // MASK_BITS == word}
    return parts


def _tagged(mesh: Mesh, dim: int, nodes: Ints, values: Ints, none: int) -> tuple[LocalIndices, LocalIndices]:
    """Local entities with values above ``none``, and those, from the rows of ``nodes`` on all ranks; collective."""
    known = values > none
    entities, labels = dolfinx.io.distribute_entity_data(mesh, dim, nodes[known], values[known].astype(np.int32))
    mesh.topology.create_connectivity(dim, 0)
    tags = dolfinx.mesh.meshtags_from_entities(mesh, dim, dolfinx.graph.adjacencylist(entities), labels)
    return tags.indices, tags.values


def _all_vertices(
    mesh: Mesh, dim: int, entities: LocalIndices, is_inside: npt.NDArray[np.bool_]
) -> npt.NDArray[np.bool_]:
    if not len(entities):
        return np.zeros(0, dtype=bool)
    kind = mesh.topology.cell_type.name
    vertices = vertex_count(kind if dim == 3 else FACET_KIND[kind])  # vertices come first; other nodes do not count
    return np.asarray(is_inside[dolfinx.mesh.entities_to_geometry(mesh, dim, entities)[:, :vertices]].all(axis=1))


def _region(mesh: Mesh, name: str, origin: str, facets: LocalIndices, cells: LocalIndices) -> Region:
    """A region with its total counts; a facet between two ranks is counted by its owner."""
    owned = mesh.topology.index_map(2).size_local
    counts = np.array([np.count_nonzero(facets < owned), len(cells)], dtype=np.int64)
    total = np.empty_like(counts)
    mesh.comm.Allreduce(counts, total)
    return Region(name, origin, facets, cells, int(total[0]), int(total[1]))


def side_names(between: tuple[str, str]) -> tuple[str, str]:
    """Return the names of the sides of an interface between two labels."""
    a, b = between
    return f"{a}|{b}", f"{b}|{a}"


def sides_of(regions: Mapping[str, Region], between: tuple[str, str]) -> tuple[str, str]:
    """Return the regions of the boundary on both sides of an interface between two regions or two labels."""
    sides = side_names(between)
    is_of_labels = all(name in regions and not regions[name].facet_count for name in between)
    return sides if is_of_labels and all(side in regions for side in sides) else between
