"""Distances between shapes, and expected shapes that are not of the job's mesh."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import SimpleITK
from helpers.solutions import made_up
from helpers.verification import HERE

from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import MeshError
from hpcinv.job.job import Job, parse
from hpcinv.mesh import build_body, write_mesh
from hpcinv.results.shape_distance import closure, differences, distance, read_expected


def job(mesh: dict[str, Any], expected: dict[str, Any] | None, path: Path = HERE) -> Job:
    data = {
        "mesh": mesh,
        "material": {"law": "neo-hookean", "young": "1 MPa", "poisson": 0.3},
        "supports": [{"region": "boundary", "fix": ["x", "y", "z"]}],
    }
    return parse(data | ({"expected_shape": expected} if expected else {}), path)


@pytest.mark.parallel([1, 2])
def test_the_recovered_shape_is_measured_from_the_expected_one(comm: MPI.Intracomm, run_directory: Path) -> None:
    def u(x: np.ndarray) -> np.ndarray:
        return np.stack([0.5 * x[:, 1], 0 * x[:, 0], 0.1 * x[:, 0] ** 2], axis=1)

    # The given shape is a curved file; the expected one a generator, which knows no degree: the file's is taken.
    generator = {"file": "../meshes/box.py", "parameters": {"lx": 3.0, "ny": 2, "nz": 2}}
    origin = job(generator | {"geometry_degree": 2}, None)
    body = build_body(origin.mesh, {}, comm, resolve=origin.resolve)
    assert read_expected(origin, body) is None
    forward = made_up(body, "forward", u)
    write_mesh(run_directory / "given.msh", body, forward.other_nodes)

    given = {"file": str(run_directory / "given.msh"), "partition": "scotch"}
    inverse_job = job(given, generator)
    deformed = build_body(inverse_job.mesh, {}, comm, resolve=inverse_job.resolve)
    found_expected = read_expected(inverse_job, deformed)
    assert isinstance(found_expected, partial)
    expected = found_expected.keywords["expected"]
    nodes = np.concatenate(comm.allgather(expected[: deformed.mesh.geometry.index_map().size_local]))
    length = np.sqrt(3.0**2 + 1 + 1)
    not_moved = distance(deformed, made_up(deformed, "inverse", np.zeros_like), expected)
    moves = u(nodes)
    largest = np.linalg.norm(moves, axis=1).max()
    assert largest > 0.9
    assert not_moved == pytest.approx(
        {"max": largest, "rms": np.sqrt((moves**2).sum(axis=1).mean()), "relative": largest / length}, rel=1e-12
    )

    # x = X + u(X) is undone by hand.
    def back(x: np.ndarray) -> np.ndarray:
        X = x - np.stack([0.5 * x[:, 1], 0 * x[:, 0], 0 * x[:, 0]], axis=1)
        return u(X)

    distances = distance(deformed, made_up(deformed, "inverse", back), expected)
    assert distances["max"] < 1e-14
    assert distances["relative"] == distances["max"] / length

    # A round trip that misses by 1 mm along z at one end.
    second = made_up(body, "inverse", lambda x: u(x) + 1e-3 / 3 * x[:, [0]] * np.array([0, 0, 1]))
    assert closure(forward, forward) == {"max": 0, "rms": 0, "relative": 0}
    missed = closure(forward, second)
    assert missed["max"] == pytest.approx(1e-3, rel=1e-9)
    assert missed["relative"] == pytest.approx(1e-3 / length, rel=1e-9)
    assert missed["rms"] == pytest.approx(1e-3 / 3 * np.sqrt(np.mean(nodes[:, 0] ** 2)), rel=1e-9)


@pytest.mark.parallel([2])
def test_an_expected_shape_of_another_mesh_is_refused_on_all_ranks(
    comm: MPI.Intracomm, run_directory: Path, meshes: Path
) -> None:
    box = {"file": str(meshes / "box.py")}
    # As many nodes and cells, joined otherwise.
    slender, flat = ({"parameters": {"nx": nx, "ny": ny, "nz": 2}} for nx, ny in ((4, 2), (2, 4)))
    cases = (
        (box, box | slender, "45 nodes, but the job's mesh has 125"),
        (box | slender, box | flat, "join other nodes"),
    )
    for mesh, expected, message in cases:
        wrong = job(mesh, expected)
        body = build_body(wrong.mesh, {}, comm, resolve=wrong.resolve)
        with pytest.raises(MeshError, match=message):
            read_expected(wrong, body)


@pytest.mark.parallel([2, 1])
def test_a_surface_or_an_image_may_be_expected(comm: MPI.Intracomm, run_directory: Path) -> None:
    """A box of 3 m that was found 1 cm thicker at both ends, and 5 cm aside, which an alignment takes away."""
    import pyvista

    surface, image = run_directory / "box.ply", run_directory / "box.nii.gz"
    if comm.rank == 0:
        box = pyvista.Cube(center=(1500, 500, 500), x_length=3000, y_length=1000, z_length=1000).triangulate()
        box.save(surface)
        voxels = np.zeros((20, 20, 40), np.uint8)
        voxels[5:15, 5:15, 5:35] = 7  # of 10 cm, with its first middle at (5, 5, 5) cm
        written = SimpleITK.GetImageFromArray(voxels)
        written.SetSpacing([100.0] * 3)
        written.SetOrigin([-450.0] * 3)
        SimpleITK.WriteImage(written, str(image))
    comm.Barrier()
    generator = {"file": "../meshes/box.py", "parameters": {"lx": 3.0, "ny": 2, "nz": 2}}

    def found(expected: dict[str, Any], aside: float) -> dict[str, float]:
        wanted = job(generator, expected)
        body = build_body(wanted.mesh, {}, comm, resolve=wanted.resolve)

        def u(x: np.ndarray) -> np.ndarray:
            return 1e-2 * (x[:, [0]] / 1.5 - 1) * np.array([1, 0, 0]) + aside * np.array([0, 1, 0])

        shape = read_expected(wanted, body)
        assert shape is not None
        return differences(body, [made_up(body, "forward", u)], shape)["expected_shape"]

    plain = found({"surface": str(surface), "unit": "mm"}, 0.0)
    assert plain["max"] == pytest.approx(1e-2, rel=1e-5)
    # Outside at two of 14 m², and by linear interpolation in the triangles next to them.
    assert 1e-2 * 2 / 14 < plain["mean"] < 1e-2 / 2
    assert plain["relative"] == pytest.approx(plain["max"] / np.sqrt(3.02**2 + 2), rel=1e-6)
    assert plain["dice"] > 0.97
    aside = found({"surface": str(surface), "unit": "mm"}, 0.05)
    assert aside["max"] == pytest.approx(np.hypot(0.05, 0.01), rel=0.03)
    moved = found({"surface": str(surface), "unit": "mm", "align": True}, 0.05)
    assert moved["max"] == pytest.approx(1e-2, rel=0.1)
    voxelised = found({"image": str(image), "labels": [7]}, 0.0)
    # Most nodes of this mesh lie on edges, which are rounded over about a voxel of 10 cm.
    assert voxelised["max"] < 0.13
    assert -0.01 < voxelised["mean"] < 0.1
    assert voxelised["dice"] > 0.97
