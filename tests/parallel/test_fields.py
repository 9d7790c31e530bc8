"""The files for ParaView hold, at every point and in every cell, what the solution has there."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.mesh_cases import spec
from helpers.solutions import Field, cell_values, made_up

import hpcinv.mesh.io.vtu_writer
from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.errors import OutputError
from hpcinv.mesh import MeshSource, build_body
from hpcinv.output.vtk import write_fields


def bending(x: np.ndarray) -> np.ndarray:
    """A quadratic displacement."""
    return np.stack([-x[:, 0] * x[:, 1], 0.5 * x[:, 0] ** 2, 1e-3 + x[:, 2]], axis=1)


def stretching(x: np.ndarray) -> np.ndarray:
    return 3 * x


def pressure(x: np.ndarray) -> np.ndarray:
    return 1e4 * (1 + x @ np.array([1.0, -2.0, 3.0]))


def linear(grid: Any, values: np.ndarray) -> np.ndarray:
    """Values that are linear in each cell: on curved tetrahedra the mean of an edge's ends stands in its middle."""
    expected = values.copy()
    for i in range(grid.n_cells):
        nodes = np.array(grid.get_cell(i).point_ids)
        if len(nodes) == 10:  # of a quadratic tetrahedron of VTK, the edges in its order
            ends = nodes[[[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]]]
            expected[nodes[4:]] = values[ends].mean(axis=1)
    return expected


def check(directory: Path, source: MeshSource, field: Field, *, is_linear: bool, region: str) -> None:
    """Compare the files with the fields at their own points, and their cells with the cells of the source."""
    import pyvista
    from vtkmodules.vtkCommonCore import vtkDataArray

    assert [p.name for p in directory.parent.iterdir()] == ["fields"]
    grid, moved = (pyvista.read(directory / f"{body}.pvd")[0] for body in ("undeformed", "deformed"))
    points = np.asarray(grid.points)
    assert np.allclose(moved.points, points + grid.point_data["displacement"], rtol=0, atol=1e-15)
    assert len(np.unique(points.round(12), axis=0)) == len(points)  # nodes are shared, also between ranks
    assert grid.GetCellData().GetArray("cauchy_stress").GetInformation().Get(vtkDataArray.UNITS_LABEL()) == "Pa"
    u = linear(grid, field(points)) if is_linear else field(points)
    # Coordinates of 0.2 m are rounded to 3e-17 m, and are scaled on the way.
    assert np.allclose(grid.point_data["displacement"], u, rtol=1e-13, atol=1e-16)
    assert np.allclose(grid.point_data["pressure"], linear(grid, pressure(points)), rtol=1e-12, atol=1e-7)

    corners = 8 if source.kind == "hexahedron" else 4
    nodes = np.array([grid.get_cell(i).point_ids for i in range(grid.n_cells)])
    centres = points[nodes[:, :corners]].mean(axis=1)
    assert np.allclose(grid.cell_data["J"], cell_values("J", centres).ravel(), rtol=1e-13)
    assert np.allclose(grid.cell_data["cauchy_stress"], cell_values("cauchy_stress", centres), rtol=1e-13)
    assert np.all(grid.cell_data[f"region:{region}"] == 1)
    stress = cell_values("cauchy_stress", centres).reshape(-1, 3, 3)
    stress = (stress + stress.transpose(0, 2, 1)) / 2
    assert np.allclose(grid.cell_data["principal_stress"], np.linalg.eigvalsh(stress)[:, ::-1], rtol=1e-5, atol=1)
    # The mean over cells around a vertex, by volume: exact for one value, here between the values of the cells.
    low, high = grid.cell_data["J"].min(), grid.cell_data["J"].max()
    smooth = grid.point_data["J_projected"]
    assert low * (1 - 1e-6) <= smooth.min() < smooth.max() <= high * (1 + 1e-6)
    # Cells, which no rank writes twice, and where the source has curved ones all their nodes, are where they were.
    written, expected = (points[nodes], source.points[source.cells])
    count = min(written.shape[1], expected.shape[1])
    assert count == expected.shape[1]
    middles = [np.unique(c[:, :count].mean(axis=1).round(12), axis=0) for c in (written, expected)]
    assert middles[0].shape == middles[1].shape == (len(source.cells), 3)
    assert np.allclose(*middles, rtol=0, atol=2e-12)


@pytest.mark.release
@pytest.mark.parallel([1, 2])
def test_fields_read_back_from_files_agree_with_the_solution(
    comm: MPI.Intracomm, meshes: Path, run_directory: Path
) -> None:
    beam, box = ("pdms_beam.py", {"size": "4 mm"}), ("box.py", {"lx": "30 mm", "nx": 3, "hexahedra": True})
    cases = ((beam, 2, 2, "silicone"), (beam, 2, 1, "silicone"), (beam, 1, 2, "silicone"), (box, 2, 2, "block"))
    for (file, parameters), displacement, geometry, region in cases:
        body = build_body(spec(meshes / file, parameters=parameters, geometry_degree=geometry), {}, comm)
        field, is_linear = (bending, False) if displacement == 2 else (stretching, True)
        solution = made_up(body, "forward", field, degree=displacement, pressure=pressure)
        # The mesh has moved since, as for the second solution of a round trip.
        target = run_directory / "fields"
        with body.at(1.7 * body.given_nodes):
            write_fields(target, body, [solution])
        on_root(comm, lambda: check(target, body.source, field, is_linear=is_linear, region=region))  # noqa: B023


@pytest.mark.parallel([2])
def test_fields_that_cannot_be_written_are_an_error_on_all_ranks_and_leave_the_old_ones(
    comm: MPI.Intracomm, meshes: Path, run_directory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    body = build_body(spec(meshes / "box.py", parameters={"nx": 2}), {}, comm)
    solution = made_up(body, "inverse", bending)
    target = run_directory / "fields"
    write_fields(target, body, [solution])
    old = {p.name: p.read_bytes() for p in target.iterdir()}
    assert not any(b'"pressure"' in content for content in old.values())  # the displacement form has none

    def fail(_stream: Any, _content: bytes) -> None:
        _stream._error = OSError(28, "No space left on device")

    monkeypatch.setattr(hpcinv.mesh.io.vtu_writer._Stream, "_write", fail)
    with pytest.raises(OutputError, match="cannot be written: No space left"):
        write_fields(target, body, [solution])
    assert {p.name: p.read_bytes() for p in target.iterdir()} == old
    assert [p.name for p in run_directory.iterdir()] == ["fields"]
    comm.Barrier()
    with pytest.raises(OutputError, match="cannot be made"):
        write_fields(run_directory / "fields" / "deformed.pvd" / "below", body, [solution])
