"""Walls with one cell through them are reported."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.command_line import ROOT
from helpers.mesh_cases import spec

from hpcinv.geometry.cad.mesh_warnings import edges_through_walls, report_thin_walls
from hpcinv.mesh import read_source
from hpcinv.mesh.source import MeshSource


def box(hexahedra: bool, through: int) -> MeshSource:
    """A plate of 4 x 4 x 0.1 (m), with cells of 1 x 1."""
    path = ROOT / "meshes" / "box.py"
    size = {"lx": 4.0, "ly": 4.0, "lz": 0.1, "nx": 4, "ny": 4, "nz": through, "hexahedra": hexahedra}
    return read_source(spec(path, parameters=size), path)


@pytest.mark.parametrize("hexahedra", [False, True])
def test_a_plate_needs_two_cells_through_it(hexahedra: bool) -> None:
    source, lines = box(hexahedra, 1), list[str]()
    edges = edges_through_walls(source)
    steps = source.points[edges[:, 1]] - source.points[edges[:, 0]]
    straight = edges[np.abs(steps[:, :2]).max(axis=1) < 1e-12]
    assert len(straight) == 9  # through the nodes that are not at the rim
    report_thin_walls(source, lines.append)
    assert len(lines) == 1
    assert "take mesh.size 50 mm for two there" in lines[0]


@pytest.mark.parametrize("hexahedra", [False, True])
def test_two_cells_through_a_plate_are_enough(hexahedra: bool) -> None:
    lines = list[str]()
    report_thin_walls(box(hexahedra, 2), lines.append)
    assert lines == []
