"""A body written as a mesh for others: with the topology, tags, groups and data it came with, at other coordinates."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

from hpcinv.errors import OutputError
from hpcinv.job.mesh_header import SUFFIX
from hpcinv.mesh.body import Body, in_source_order
from hpcinv.mesh.distributed.partitioned import write_partitioned
from hpcinv.mesh.io.gmsh_model import save_msh
from hpcinv.mesh.io.vtu import save_vtu
from hpcinv.mesh.source import Floats, MeshSource
from hpcinv.parallel.runtime import on_root

SAVERS: dict[str, Callable[[Path, MeshSource, Floats], None]] = {".msh": save_msh, ".vtu": save_vtu}


def write_mesh(path: Path, body: Body, coordinates: Floats) -> None:
    """Write the body at ``coordinates`` (m) of its local geometry nodes, as the suffix of ``path`` says; collective.

    Node order, node and cell tags, physical groups and data arrays are those of the source (vectors too: they are not
    turned with the body); the file appears whole or not at all. A ``.bp`` is written by all ranks, in metres; others by
    rank 0, which cannot of a partitioned mesh, in the unit of the source's own file, which they state.

    Raises:
        OutputError: on every rank, if it cannot be written.
    """
    points, comm = in_source_order(body, coordinates), body.mesh.comm
    if path.suffix == SUFFIX:
        write_partitioned(path, comm, dataclasses.replace(body.source, points=points))
    else:
        assert not body.source.is_partitioned
        on_root(comm, lambda: save(path, body.source, points))


def save(path: Path, source: MeshSource, points: Floats) -> None:
    """Write a whole mesh at ``points`` (n, 3) m as the suffix of ``path`` says; the file appears whole or not at all.

    Its coordinates are in ``source.unit``, which the file states.

    Raises:
        OutputError: it cannot be written.
    """
    partial = path.with_name(f".{path.stem}.partial{path.suffix}")
    try:
        SAVERS[path.suffix](partial, source, source.in_its_unit(points))
        partial.replace(path)
    except Exception as exc:  # gmsh and VTK raise nothing narrower
        partial.unlink(missing_ok=True)
        raise OutputError(f"{path}: cannot be written: {exc}", "Is there such a directory, and space?") from exc


def write_msh(path: Path, body: Body, coordinates: Floats) -> None:
    """Write MSH 4.1 (binary, so that coordinates are exact); see ``write_mesh``."""
    write_mesh(path.with_suffix(".msh"), body, coordinates)


def write_vtu(path: Path, body: Body, coordinates: Floats) -> None:
    """Write VTU with an array ``region:NAME`` for each physical group; see ``write_mesh``."""
    write_mesh(path.with_suffix(".vtu"), body, coordinates)
