"""Regions that a job defines by conditions, on a shape of its run: mesh files have the groups of the mesh only."""

from __future__ import annotations

import dataclasses

import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.job.job import Job
from hpcinv.job.region_references import REFERENCES
from hpcinv.mesh import build_body
from hpcinv.mesh.body import Body
from hpcinv.mesh.facet_groups import add_facets
from hpcinv.mesh.regions import BOUNDARY
from hpcinv.mesh.source import Group, Ints, MeshSource, distinct_tags


def with_job_regions(shape: MeshSource, given: MeshSource, job: Job) -> MeshSource:
    """Return a shape with the regions that its job defines or names, beyond the groups of the mesh.

    Args:
        shape: a shape of the run, with the cells of the given body.
        given: the given body. Conditions are evaluated on it.

    Raises:
        MeshError: as `build_body`.
    """
    named = {*job.regions, *(name for references in REFERENCES for _, name in references(job))}
    missing = (named & {*job.regions, BOUNDARY}) - {group.name for group in shape.groups}
    if not missing:
        return shape
    body = build_body(job.mesh, job.regions, MPI.COMM_SELF, resolve=job.resolve, replacement=given)
    order = np.asarray(body.mesh.topology.original_cell_index).astype(np.int64)
    regions = [body.regions[name] for name in sorted(missing)]
    shape = add_facets(shape, {r.name: _sides(body, r.facets, order) for r in regions if len(r.facets)})
    cells = [Group(r.name, 3, 0, np.sort(order[r.cells])) for r in regions if len(r.cells)]
    return dataclasses.replace(shape, groups=distinct_tags([*shape.groups, *cells]))


def _sides(body: Body, facets: Ints, order: Ints) -> Ints:
    """Return the cell, as the file counts, and the local number in it (n, 2) of facets of a mesh on one rank."""
    topology = body.mesh.topology
    topology.create_connectivity(2, 3)
    topology.create_connectivity(3, 2)
    of_facets, of_cells = topology.connectivity(2, 3), topology.connectivity(3, 2)
    cells = of_facets.array[of_facets.offsets[facets]]
    which = (of_cells.array.reshape(len(order), -1)[cells] == facets[:, None]).argmax(axis=1)
    return np.stack([order[cells], which], axis=1)
