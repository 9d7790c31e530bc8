"""The body with the nodes of its mesh at other places: the same distributed cells, regions and data."""

from __future__ import annotations

from dataclasses import replace

from hpcinv.base.parallel.runtime import on_root
from hpcinv.errors import MeshError
from hpcinv.mesh.body import Body, replace_geometry
from hpcinv.mesh.checks import check
from hpcinv.mesh.kind_source import source_of
from hpcinv.mesh.source import Floats, MeshSource

_REMEDY = "Move the nodes by less, or add a term to the objective that keeps cells in shape."


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
