"""Mesh files of a block whose nodes and data arrays are given."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from helpers.command_line import ROOT
from helpers.mesh_data_files import block
from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.mesh.cells import scalar_element
from hpcinv.mesh.mesh_files import save_body
from hpcinv.mesh.source import DataArray, Place


def write_block(
    comm: MPI.Intracomm,
    path: Path,
    *,
    hexahedra: bool = False,
    degree: int = 1,
    moved: Any = 0.0,
    arrays: Mapping[str, np.ndarray] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Write the block of `block` with its nodes displaced, and with arrays of its cells or nodes; collective.

    Returns:
        Nodes of the file, (n, 3), and middles of its cells, (m, 3), in m.
    """

    def write() -> tuple[np.ndarray, np.ndarray]:
        source = block(ROOT / "meshes", hexahedra, degree)
        counts = len(source.points), len(source.cells)
        data = {}
        for name, values in (arrays or {}).items():
            place: Place = "cells" if len(values) == counts[1] else "nodes"
            data[name] = DataArray(name, place, values.reshape(len(values), -1))
        points = source.points + moved
        save_body(path, source, points, data)
        centre = np.full((1, 3), 0.5 if hexahedra else 0.25)
        shapes = scalar_element(source.kind, degree).tabulate(0, centre)[0, 0, :, 0]
        return points, np.einsum("k,mki->mi", shapes, points[source.cells])

    return on_root(comm, write)
