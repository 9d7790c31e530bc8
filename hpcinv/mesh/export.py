"""A body written as a mesh for others: with the topology, tags, groups and data it came with, at other coordinates."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from hpcinv.errors import OutputError
from hpcinv.mesh.body import Body, gather_nodes
from hpcinv.mesh.gmsh_model import save_msh
from hpcinv.mesh.source import Floats, MeshSource
from hpcinv.mesh.vtu import save_vtu
from hpcinv.runtime import on_root

SAVERS: dict[str, Callable[[Path, MeshSource, Floats], None]] = {".msh": save_msh, ".vtu": save_vtu}


def write_mesh(path: Path, body: Body, coordinates: Floats) -> None:
    """Write the body at ``coordinates`` (m) of its local geometry nodes, as the suffix of ``path`` says; collective.

    Node order, node and cell tags, physical groups and data arrays are those of the source (vectors too: they are not
    turned with the body); the file appears whole or not at all.

    Raises:
        OutputError: on every rank, if it cannot be written.
    """
    points = gather_nodes(body, coordinates)

    def on_rank_0() -> None:
        assert points is not None
        partial = path.with_name(f".{path.stem}.partial{path.suffix}")
        try:
            SAVERS[path.suffix](partial, body.source, points)
            partial.replace(path)
        except Exception as exc:  # gmsh and VTK raise nothing narrower
            partial.unlink(missing_ok=True)
            raise OutputError(f"{path}: cannot be written: {exc}", "Is there such a directory, and space?") from exc

    on_root(body.mesh.comm, on_rank_0)


def write_msh(path: Path, body: Body, coordinates: Floats) -> None:
    """Write MSH 4.1 (binary, so that coordinates are exact); see ``write_mesh``."""
    write_mesh(path.with_suffix(".msh"), body, coordinates)


def write_vtu(path: Path, body: Body, coordinates: Floats) -> None:
    """Write VTU with an array ``region:NAME`` for each physical group; see ``write_mesh``."""
    write_mesh(path.with_suffix(".vtu"), body, coordinates)
