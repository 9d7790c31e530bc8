"""The nodes of the given body as an input of a job."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from hpcinv.base.parallel.runtime import on_root
from hpcinv.errors import MeshError
from hpcinv.job.job import Job
from hpcinv.mesh.body import Body, replace_geometry
from hpcinv.mesh.checks import check
from hpcinv.mesh.kind_source import source_of
from hpcinv.mesh.location import locate, position
from hpcinv.mesh.source import Floats, MeshSource
from hpcinv.solver.workspace import Workspace, collect_garbage

NODES = "mesh.nodes"
"""key of the input"""
_MOVES = 20
"""Moves of the body between collections of garbage. Raised, more communicators of earlier bodies are kept, and MPI has
few thousand; lowered, moves take longer."""

_REMEDY = "Move the nodes by less, or add a term to the objective that keeps cells in shape."


class GivenNodes:
    """The nodes (n, 3) m of the mesh in the file, of a shell the nodes of its surface; methods are collective.

    Attributes:
        start: where the job has them.
    """

    def __init__(self, job: Job, workspace: Workspace) -> None:
        self._workspace, self._may_be_cut = workspace, job.mesh.may_be_cut
        self._given = self._body = workspace.body(job)
        comm, source = workspace.comm, self._given.source
        self.start: Floats = on_root(comm, lambda: source.in_file.points)
        self._nodes, self._moves = self.start, 0
        points = {f"quantities[{i}].at": q.at for i, q in enumerate(job.quantities) if q.at is not None}
        places = locate(self._given, points.values())
        self._places = {key: place for key, at in points.items() if (place := places[at]) is not None}

    def put(self, job: Job, nodes: Floats) -> Job:
        """Move the body, and return the job whose points of quantities have moved with it.

        Raises:
            MeshError: on all ranks, if cells are inverted there; the body stays where it was.
        """
        if self._workspace.body(job) is not self._body or not np.array_equal(nodes, self._nodes):
            body = move_body(self._given, nodes, may_be_cut=self._may_be_cut)
            self._workspace.put_body(body)
            self._body, self._nodes, self._moves = body, nodes, self._moves + 1
            if self._moves % _MOVES == 0:
                collect_garbage(self._workspace.comm)
        changes: dict[str, Any] = {
            key: position(self._body, place, self._body.given_nodes).tolist() for key, place in self._places.items()
        }
        return job.with_(changes)

    def gradient(self, by_nodes: Floats) -> Floats:
        """Return derivatives (n, 3) by the nodes of the mesh, from derivatives by the nodes of the body."""
        source, kind = self._given.source, source_of(self._given.source.body_kind)
        found: Floats = on_root(self._workspace.comm, lambda: kind.node_gradient(source, self._nodes, by_nodes))
        return found

    def direction(self, rates: Floats) -> Floats:
        """Return rates of the nodes of the body, from rates (n, 3) of the nodes of the mesh."""
        source, kind = self._given.source, source_of(self._given.source.body_kind)
        found: Floats = on_root(self._workspace.comm, lambda: kind.node_direction(source, self._nodes, rates))
        return found


def move_body(given: Body, nodes: Floats, *, may_be_cut: bool = False) -> Body:
    """Return the body whose mesh has its nodes at other places; collective.

    Regions keep their facets and cells, also regions by a rule. Nodes on the edges of curved cells in the file are in
    ``nodes``. Nodes that a displacement of degree 2 adds to straight cells stay half way.

    Args:
        given: whose mesh is not partitioned; it stays as it is.
        nodes: of the mesh in the file (of a shell, its surface), (n, 3) in m, the same on all ranks.
        may_be_cut: as of `check`.

    Raises:
        MeshError: on all ranks, if cells are inverted or flat there.
    """
    sources = list[MeshSource]()

    def move_on_root() -> None:
        source = _moved(given.source, nodes)
        try:
            check(source, may_be_cut=may_be_cut)
        except MeshError as error:
            raise MeshError(f"with the given nodes, {error.message}", _REMEDY) from None
        sources.append(source)

    on_root(given.mesh.comm, move_on_root)
    body = replace_geometry(given, sources[0] if sources else given.source)
    return replace(body.raise_degree(given.degree), build_halved=None)


def _moved(given: MeshSource, nodes: Floats) -> MeshSource:
    """Return the mesh of a body whose mesh in the file has its nodes elsewhere."""
    shape = replace(given.in_file, points=nodes, surface=None)
    if given.midsurface is None:
        return shape
    kind = source_of(given.body_kind)
    change = kind.moved(given, shape) - kind.moved(given, given.midsurface)  # columns of data need not be normals
    return replace(given, points=given.points + change, midsurface=shape, surface=None)
