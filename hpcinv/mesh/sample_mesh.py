"""Sample of a mesh: one cell of each kind that a job distinguishes, without shared nodes."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

import dolfinx
import numpy as np
import numpy.typing as npt

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.expressions import Expression
from hpcinv.base.quantity.nondimensional import power_of_two
from hpcinv.job.region_rules import RegionRule, RegionUnion
from hpcinv.mesh.body import Body
from hpcinv.mesh.cells import coordinate_element, vertex_count
from hpcinv.mesh.distributed.partition import partition_of
from hpcinv.mesh.facet_groups import join_facets
from hpcinv.mesh.refine.finer_geometry import FinerGeometry
from hpcinv.mesh.regions import Region, build_regions, evaluate, is_facet_condition
from hpcinv.mesh.source import Floats, Group, Ints, MeshSource
from hpcinv.mesh.topology import FacetTable

HELD = "one facet of each cell"
"""A region of every sample body."""


def sample_body(
    source: MeshSource,
    rules: Mapping[str, RegionRule],
    points: Iterable[Floats],
    finer: FinerGeometry | None = None,
) -> Body:
    """Body of a few cells on this process alone, with the regions of the whole body, and `HELD`.

    It has one cell for each combination of regions that a cell and its facets are in, and all cells next to one of the
    ``points`` (m). Cells share no nodes, so that each needs supports.

    Args:
        finer: true geometry of the whole mesh, if known.
    """
    chosen = np.unique([*_first_of_each(source, rules), *_cells_near(source, points)])
    part = _separated(source, chosen)
    if finer is not None and finer.source is not None:
        finer = replace(finer, source=_separated(finer.source, chosen))
    length_scale = power_of_two(float(np.linalg.norm(np.ptp(part.points, axis=0))))
    comm = MPI.COMM_SELF
    element = coordinate_element(part.kind, part.degree)
    mesh = dolfinx.mesh.create_mesh(comm, part.cells, element, part.points / length_scale)
    place_rules = _place_rules(rules)
    regions = build_regions(mesh, part, place_rules, length_scale)
    mesh.topology.create_connectivity(3, 2)
    first = np.sort(mesh.topology.connectivity(3, 2).array.reshape(len(chosen), -1)[:, 0])
    held = Region(HELD, "built in", first, np.zeros(0, dtype=np.int32), len(first), 0)
    # Separate cells have other normals and cavities than the body.
    normal_regions = {n: replace(held, name=n, origin="geometric") for n in rules if n not in place_rules}
    read = None if finer is None else lambda: finer
    return Body(
        mesh,
        length_scale,
        regions | normal_regions | {HELD: held},
        partition_of(mesh, "none"),
        part,
        mesh.geometry,
        read,
    )


def _place_rules(rules: Mapping[str, RegionRule]) -> dict[str, RegionRule]:
    """Return the rules that depend neither on normals nor on cavities, also not by members of unions."""
    place_rules: dict[str, RegionRule] = {}
    for name, rule in rules.items():
        others = rules.keys() - place_rules.keys()
        if not is_facet_condition(rule) and not (isinstance(rule, RegionUnion) and others & {*rule.names}):
            place_rules[name] = rule
    return place_rules


def _first_of_each(source: MeshSource, rules: Mapping[str, RegionRule]) -> Ints:
    """First cell of each combination of regions."""
    table = FacetTable.build(source.kind, source.cells[:, : vertex_count(source.kind)])
    marks = np.stack([np.zeros(len(source.cells), dtype=bool), *_memberships(source, table, rules)], axis=1)
    return np.asarray(np.unique(marks, axis=0, return_index=True)[1], dtype=np.int64)


def _memberships(
    source: MeshSource, table: FacetTable, rules: Mapping[str, RegionRule]
) -> Iterator[npt.NDArray[np.bool_]]:
    """For each region two flags of each cell: whether the cell is in it, and whether a facet of the cell is in it."""
    facet_rows = table.find(source.facets[:, : table.vertices.shape[1]])
    for group in source.groups:
        if group.dim == 3:
            yield np.isin(np.arange(len(source.cells)), group.members)
        else:
            yield np.asarray(np.isin(table.cell_facets, facet_rows[group.members]).any(axis=1))
    exterior = table.sharing == 1
    yield exterior[table.cell_facets].any(axis=1)
    for name, condition in rules.items():
        if not isinstance(condition, Expression) or is_facet_condition(condition):  # a union follows from its members
            continue
        is_inside = evaluate(name, condition, source.points)
        yield np.asarray(is_inside[source.cells[:, : vertex_count(source.kind)]].all(axis=1))
        yield (exterior & is_inside[table.vertices].all(axis=1))[table.cell_facets].any(axis=1)


def _cells_near(source: MeshSource, points: Iterable[Floats]) -> Iterator[int]:
    """Cells whose bounding boxes, enlarged by a quarter, contain one of the points."""
    nodes = source.points[source.cells]
    low, high = nodes.min(axis=1), nodes.max(axis=1)
    margin = 0.25 * (high - low).max(axis=1, keepdims=True)
    for point in points:
        yield from np.flatnonzero(((low - margin <= point) & (point <= high + margin)).all(axis=1)).tolist()


def _separated(source: MeshSource, chosen: Ints) -> MeshSource:
    """The ``chosen`` cells of a mesh without shared nodes, with their groups and data."""
    nodes = source.cells[chosen]
    new = np.arange(nodes.size).reshape(nodes.shape)
    facets, groups = list[list[int]](), list[Group]()
    for group in source.groups:
        if group.dim == 3:
            groups.append(replace(group, members=np.flatnonzero(np.isin(chosen, group.members))))
            continue
        group_facets, facet_count = source.facets[group.members], len(facets)
        for cell, cell_nodes in zip(new, nodes, strict=True):
            mine = np.isin(group_facets, cell_nodes).all(axis=1)
            place = {int(node): int(own) for node, own in zip(cell_nodes, cell, strict=True)}
            facets += [[place[int(node)] for node in facet] for facet in group_facets[mine]]
        groups.append(replace(group, members=np.arange(facet_count, len(facets))))
    data = source.nodal_data(lambda values: values[nodes.ravel()])
    part = replace(
        source,
        points=source.points[nodes.ravel()],
        node_tags=new.ravel() + 1,
        cells=new,
        cell_tags=source.cell_tags[chosen],
        facets=np.array(facets, dtype=np.int64).reshape(len(facets), source.facets.shape[1]),
        groups=tuple(groups),
        data={n: replace(a, values=a.values[chosen]) if a.place == "cells" else a for n, a in data.items()},
        parts=(),
    )
    return join_facets(part)
