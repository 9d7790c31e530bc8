"""The boundary that pictures are drawn from: the same triangles on any number of ranks, closed, with the results."""

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import BLOCK
from helpers.verification import job

import hpcinv
from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.errors import Interrupted, OutputError
from hpcinv.output.result import Result
from hpcinv.output.surfaces.boundary_surface import NAME, Boundary, read_boundary
from hpcinv.output.surfaces.gathering import boundary_of
from hpcinv.output.surfaces.snapshots import NAME as SNAPSHOTS
from hpcinv.output.surfaces.snapshots import read_snapshots, write_snapshot
from hpcinv.pages.pictures.result_picture import measure

SHEAR: dict[str, Any] = {
    "analysis": "forward",
    "mesh": {"file": "../meshes/box.py", "parameters": {"nx": 2, "ny": 1, "nz": 1}, "geometry_degree": 2},
    "material": BLOCK["material"],
    "supports": [{"region": "boundary", "displacement": ["0.2*y", "0", "0"]}],
    "fibres": {
        "upright": {"direction": [0, 2, 0], "given_on": "reference"},
        "leaning": {"direction": ["0", "x + 1 m", "0"], "given_on": "current"},
    },
    "solver": {"strategy": "fixed", "steps": 4},
}


F = np.array([[1.0, 0.2, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


def sheared(comm: MPI.Intracomm, directory: Path) -> tuple[Result, Boundary | None]:
    result = hpcinv.run(job(**SHEAR), comm, directory=directory, overwrite=True)
    return result, boundary_of(result.body, result.solutions, families=result.job.fibres)


@pytest.mark.release
@pytest.mark.parallel([1, 2, 3])
def test_the_boundary_is_closed_and_has_the_solution(comm: MPI.Intracomm, run_directory: Path) -> None:
    _, boundary = sheared(comm, run_directory / "run")
    if boundary is None:
        assert comm.rank != 0
        return
    corners = boundary.points[boundary.triangles]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    assert np.allclose(areas.sum(axis=0), 0.0, atol=1e-12)  # closed
    assert np.isclose(np.einsum("ti,ti->", corners.mean(axis=1), areas) / 3, 1.0)  # the volume: normals point outwards
    sides = np.sort(np.concatenate([boundary.triangles[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))]), axis=1)
    assert (np.unique(sides, axis=0, return_counts=True)[1] == 2).all()  # no point is there twice
    (entry,) = boundary.results
    assert np.allclose(entry.displacement, boundary.points[:, [1]] * [0.2, 0, 0], atol=1e-9)
    assert np.allclose(entry.others, boundary.points + entry.displacement)
    x = corners[boundary.regions["x1"]][:, :, 0]
    assert x.size
    assert np.allclose(x, 1.0)
    mu = 10e3  # simple shear γ of a neo-Hookean body: σ = μ (b - I), b - I = [[γ², γ, 0], [γ, 0, 0], [0, 0, 0]]
    expected = np.sqrt(0.2**4 + 3 * 0.2**2) * mu
    assert np.allclose(measure("von_mises", entry), expected, rtol=1e-6)
    assert np.allclose(entry.J, 1.0, atol=1e-8)
    # F = I + γ e_x e_y: stretches from the eigenvalues of C, and what was along y leans.
    assert np.allclose(entry.stretches, np.sqrt(np.linalg.eigvalsh(F.T @ F)[::-1]), atol=1e-8)
    up = np.array([0.0, 1.0, 0.0])
    for of_body, name, direction in (
        (boundary.fibres, "upright", up),
        (entry.fibres, "upright", F @ up),
        (boundary.fibres, "leaning", np.linalg.inv(F) @ up),
        (entry.fibres, "leaning", up),
    ):
        assert np.allclose(of_body[name], direction / np.linalg.norm(direction), atol=1e-8), name
    assert not entry.crossing.any()


@pytest.mark.parallel(2)
def test_a_run_keeps_its_boundary(comm: MPI.Intracomm, run_directory: Path) -> None:
    result, boundary = sheared(comm, run_directory / "run")
    picture = result.plot("von-mises")
    assert picture.png.startswith(b"\x89PNG")
    if boundary is not None:
        kept = read_boundary(run_directory / "run" / NAME)
        assert np.array_equal(kept.points, boundary.points)
        assert np.array_equal(kept.triangles, boundary.triangles)
        assert kept.regions.keys() == boundary.regions.keys()
        assert [result.direction for result in kept.results] == ["forward"]
        assert kept.error is None
    with pytest.raises(OutputError, match="no values for the colour 'error'"):
        result.plot("error")


def check_snapshots(directory: Path) -> None:
    """Compare what was kept with simple shear in proportion to the load."""
    points, snapshots = read_boundary(directory / NAME).points, read_snapshots(directory / SNAPSHOTS)
    assert [snapshot.load for snapshot in snapshots] == [0.25, 0.5, 0.75]
    for snapshot in snapshots:
        expected = 0.2 * snapshot.load * points[snapshot.points][:, [1]] * [1, 0, 0]
        assert np.allclose(snapshot.displacement, expected, atol=2e-5 * 0.2)


@pytest.mark.release
@pytest.mark.parallel(2)
def test_steps_are_kept_also_by_a_run_that_resumes(comm: MPI.Intracomm, run_directory: Path) -> None:
    run = run_directory / "run"
    sheared(comm, run)
    on_root(comm, lambda: check_snapshots(run))
    asked = itertools.count()
    with pytest.raises(Interrupted):
        hpcinv.run(job(**SHEAR), comm, directory=run, overwrite=True, stop_asked=lambda: next(asked) > 5)
    if comm.rank == 0:
        kept = read_snapshots(run / SNAPSHOTS)
        assert 0 < len(kept) < 3
        write_snapshot(run / SNAPSHOTS, replace(kept[0], solves=99), 20)  # of a step after the last checkpoint
    comm.Barrier()
    hpcinv.run(job(**SHEAR), comm, directory=run, resume=True)
    on_root(comm, lambda: check_snapshots(run))


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"no archive"])
def test_a_damaged_file_is_refused(content: bytes, tmp_path: Path) -> None:
    (tmp_path / NAME).write_bytes(content)
    with pytest.raises(OutputError, match=r"surface\.npz: cannot be read"):
        read_boundary(tmp_path / NAME)
