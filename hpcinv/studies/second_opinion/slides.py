"""Supports with ``fix: [normal]``: the directions along which nodes are held, and their displacements along these."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.formats.readers.elements import elements_of, faces_of
from hpcinv.job.job import Job
from hpcinv.job.support import Support
from hpcinv.mesh.cells import FACET_KIND, scalar_element
from hpcinv.mesh.source import Floats, Group, Ints, MeshSource
from hpcinv.model.sliding_surfaces import surface_of
from hpcinv.studies.second_opinion.regions import group_of

_SAME = 1e-9
"""Difference of unit vectors that are rounding errors; raised, shallow curved faces are taken for planes."""


@dataclass(frozen=True)
class Slide:
    """Nodes (rows) of a region that are held along unit vectors (n, 3), by known displacements along these (n,), m."""

    place: str
    nodes: Ints
    directions: Floats
    values: Floats
    region: str

    @property
    def plane_normal(self) -> Floats | None:
        """The direction (3,) of all nodes, which stay in their plane; ``None`` if directions or displacements differ.

        Its largest component is positive.
        """
        first = self.directions[0]
        if self.values.any() or np.abs(self.directions - first).max() > _SAME:
            return None
        normal: Floats = first * np.sign(first[np.abs(first).argmax()])
        return normal

    @property
    def axis(self) -> int | None:
        """The axis (0, 1, 2) along which all nodes are held; ``None`` if it is another direction."""
        along = int(np.abs(self.directions[0]).argmax())
        is_along = np.abs(np.abs(self.directions[:, along]) - 1).max() < _SAME
        return along if is_along and np.ptp(np.sign(self.directions[:, along])) == 0 else None

    @property
    def axis_values(self) -> Floats:
        """Displacements (n,) along `axis`, m."""
        along = self.axis
        return self.values if along is None else self.values * np.sign(self.directions[:, along]) + 0.0


def slide_of(rest: MeshSource, loaded: Floats, job: Job, support: Support, place: str) -> Slide:
    """Return the nodes of a support that slides.

    On a curved surface the direction is the normal at the loaded place: there the reaction acts.

    Args:
        loaded: places of the nodes (n, 3), m.
    """
    given = loaded if job.directions[0] == "inverse" else rest.points
    group = group_of(rest, support.region)
    nodes = np.unique(rest.facets[group.members])
    if support.normal is not None:
        directions = np.tile(np.array(support.normal) / np.linalg.norm(support.normal), (len(nodes), 1))
    else:
        directions = nodal_normals(rest, given, group)[nodes]
    values = np.zeros(len(nodes))
    if support.surface is not None:
        points = given[nodes]
        surface = surface_of(support, place, points, directions, points, MPI.COMM_SELF)
        gradients = surface.values(loaded[nodes]).gradient
        directions = gradients / np.linalg.norm(gradients, axis=1)[:, None]
        values = np.einsum("ni,ni->n", directions, loaded[nodes] - rest.points[nodes])
    return Slide(place, nodes, directions, values, support.region)


def nodal_normals(mesh: MeshSource, points: Floats, group: Group) -> Floats:
    """Return outward unit normals (n, 3) of a region at its nodes, 0 at others; means of the facets by their areas.

    Args:
        points: of the nodes (n, 3), m.
    """
    kind, facets = FACET_KIND[mesh.kind], mesh.facets[group.members]
    element = scalar_element(kind, mesh.degree)
    slopes = element.tabulate(1, element.points)[1:, :, :, 0]
    tangents = np.einsum("dqk,fki->fqdi", slopes, points[facets])
    areas = np.cross(tangents[:, :, 0], tangents[:, :, 1])
    owners = np.array([cell for cell, _ in faces_of(mesh, group, elements_of(mesh))], dtype=np.int64)
    outward = points[facets].mean(axis=1) - points[mesh.cells[owners]].mean(axis=1)
    areas *= np.sign(np.einsum("fqi,fi->f", areas, outward))[:, None, None]
    totals = np.zeros_like(points)
    np.add.at(totals, facets, areas)
    lengths = np.linalg.norm(totals, axis=1)
    normals: Floats = totals / np.where(lengths > 0, lengths, 1.0)[:, None]
    return normals
