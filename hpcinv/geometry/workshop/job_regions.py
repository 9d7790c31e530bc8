"""Regions that a job defines by conditions, on a shape of its run: mesh files have the groups of the mesh only."""

from __future__ import annotations

import dataclasses

import dolfinx
import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.base.quantity.spatial_fields import ELSEWHERE
from hpcinv.job.job import Job
from hpcinv.job.region_references import REFERENCES
from hpcinv.mesh import build_body
from hpcinv.mesh.body import Body
from hpcinv.mesh.boundary_shells import cells_and_sides
from hpcinv.mesh.cells import scalar_element, sub_entities
from hpcinv.mesh.facet_groups import add_facets
from hpcinv.mesh.regions import BOUNDARY
from hpcinv.mesh.source import Group, Ints, MeshSource, distinct_tags


def with_middles(mesh: MeshSource, vertices: Ints) -> Ints:
    """Return vertices (rows), and in a mesh of degree 2 the nodes between two of them."""
    if mesh.degree == 1:
        return vertices
    is_own = np.zeros(len(mesh.points), dtype=bool)
    is_own[vertices] = True
    ends = mesh.cells[:, sub_entities(mesh.kind, 1)]
    middles = mesh.cells[:, np.array(scalar_element(mesh.kind, 2).entity_dofs[1]).ravel()]
    return np.unique([*vertices, *middles[is_own[ends].all(axis=2)]])


def with_job_regions(shape: MeshSource, given: MeshSource, job: Job) -> tuple[MeshSource, dict[str, Ints]]:
    """Return a shape with the regions that its job defines or names, beyond the groups of the mesh.

    Args:
        shape: a shape of the run, with the cells of the given body.
        given: the given body. Conditions are evaluated on it.

    Returns:
        The shape with groups, and the rows of the vertices of regions of vertices.

    Raises:
        MeshError: as `build_body`.
    """
    named = {*job.regions, *(name for references in REFERENCES for _, name in references(job))}
    missing = (named & {*job.regions, BOUNDARY}) - {group.name for group in shape.groups}
    if not missing:
        return _with_remainder(shape, job), {}
    body = build_body(job.mesh, job.regions, MPI.COMM_SELF, resolve=job.resolve, replacement=given)
    order = np.asarray(body.mesh.topology.original_cell_index).astype(np.int64)
    regions = [body.regions[name] for name in sorted(missing)]
    shape = add_facets(shape, {r.name: _sides(body, r.facets, order) for r in regions if len(r.facets)})
    cells = [Group(r.name, 3, 0, np.sort(order[r.cells])) for r in regions if len(r.cells)]
    shape = dataclasses.replace(shape, groups=distinct_tags([*shape.groups, *cells]))
    vertices = {r.name: _rows(body, r.vertices) for r in regions if r.vertices is not None}
    return _with_remainder(shape, job), vertices


def _rows(body: Body, vertices: LocalIndices) -> Ints:
    """Return the rows of vertices in the file."""
    nodes = dolfinx.mesh.entities_to_geometry(body.mesh, 0, vertices).ravel()
    return np.unique(body.mesh.geometry.input_global_indices[nodes])


def _with_remainder(shape: MeshSource, job: Job) -> MeshSource:
    """Return the shape with the cells that no law of a region takes as the region ``elsewhere``, if that has a law."""
    regions = {where.partition(".")[2] for where in job.laws}
    if ELSEWHERE not in regions:
        return shape
    taken = [group.members for group in shape.groups if group.dim == 3 and group.name in regions]
    left = np.setdiff1d(np.arange(len(shape.cells)), np.concatenate(taken))
    return dataclasses.replace(shape, groups=distinct_tags([*shape.groups, Group(ELSEWHERE, 3, 0, left)]))


def _sides(body: Body, facets: LocalIndices, order: Ints) -> Ints:
    """Return the cell, as the file counts, and the local number in it (n, 2) of facets of a mesh on one rank."""
    cells, which = cells_and_sides(body.mesh, facets)
    return np.stack([order[cells], which], axis=1)
