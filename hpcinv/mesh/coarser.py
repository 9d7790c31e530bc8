"""The body on larger cells, made by the generator of its mesh."""

from collections.abc import Callable, Mapping
from pathlib import Path

from hpcinv.base.parallel.runtime import on_root
from hpcinv.errors import MeshError
from hpcinv.job.region_rules import RegionRule
from hpcinv.job.sections import MeshSpec
from hpcinv.mesh.body import Body, build_body, read_source
from hpcinv.mesh.source import MeshSource


def coarser_body(
    body: Body,
    spec: MeshSpec,
    regions: Mapping[str, RegionRule],
    *,
    resolve: Callable[[str], Path],
    size_factor: float,
    most: float,
) -> Body:
    """Return the body on cells larger by a factor, by gmsh's ``Mesh.MeshSizeFactor``; collective.

    Args:
        spec: mesh of the job, from a generator.
        resolve: makes the path in the job one that can be opened.
        most: largest number of cells, as a share of the cells of ``body``.

    Raises:
        MeshError: the same on every rank: the generator makes no such mesh, or not an admissible one.
    """
    comm, sources = body.mesh.comm, list[MeshSource]()
    cells = sum(body.partition.cells)

    def read_on_root() -> None:
        source = read_source(spec, resolve(spec.file), size_factor=size_factor)
        if len(source.cells) > most * cells:
            raise MeshError(f"its generator makes {len(source.cells):,} coarser cells instead of {cells:,}")
        sources.append(source)

    on_root(comm, read_on_root)
    coarse_source = sources[0] if sources else None
    return build_body(spec, regions, comm, resolve=resolve, degree=body.degree, replacement=coarse_source)
