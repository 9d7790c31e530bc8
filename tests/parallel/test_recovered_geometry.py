"""The recovered body has the degree of the displacement; the files of its shape are as the given mesh is."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import NO_CERTIFICATE
from helpers.mesh_cases import spec
from helpers.verification import HERE, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.errors import CheckpointError
from hpcinv.job.fingerprint import check_same_problem, fingerprint
from hpcinv.mesh.body import build_body, local_node_values, read_source, reorder_to_source
from hpcinv.mesh.mesh_files import save
from hpcinv.mesh.source import MeshSource

RANKS = [1, 2]


def straight(meshes: Path, *, hexahedra: bool = False) -> MeshSource:
    parameters = {"nx": 3, "ny": 1, "nz": 1, "lx": 3.0, "hexahedra": hexahedra}
    return read_source(spec(meshes / "box.py", parameters=parameters), meshes / "box.py")


def sagging(mesh: dict[str, Any], **changes: Any) -> Any:
    return job(
        mesh=mesh,
        regions={"end": "x < 1e-6 m"},
        material={"law": "neo-hookean", "young": "10 kPa", "poisson": 0.3},
        effects=[{"effect": "gravity", "acceleration": [0, 0, -0.1], "density": 1000}],
        supports=[{"region": "end", "fix": ["x", "y", "z"]}],
        **{"certificate": NO_CERTIFICATE | {"round_trip": "near"}, **changes},
    )


def round_trip(result: Any) -> float:
    (entry,) = [line.value for line in result.certificate.lines if line.name.startswith("round trip")]
    assert entry is not None
    return float(entry)


@pytest.mark.everyday(".msh-hexahedron-2")
@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize(("kind", "degree"), [("tetrahedron", 2), ("hexahedron", 2), ("tetrahedron", 3)])
@pytest.mark.parametrize("suffix", [".vtu", ".msh"])
def test_straight_files_close_and_keep_their_numbering(
    suffix: str, kind: str, degree: int, comm: MPI.Intracomm, run_directory: Path, meshes: Path
) -> None:
    path, directory = run_directory / f"given{suffix}", run_directory / "run"

    def write() -> None:
        source = straight(meshes, hexahedra=kind == "hexahedron")
        save(path, source, source.points)

    on_root(comm, write)
    result = hpcinv.run(
        sagging({"file": str(path)}, discretisation={"displacement": degree}), comm, directory=directory
    )
    assert round_trip(result) < 1e-10
    nodes = reorder_to_source(result.body, result.solutions[0].other_nodes)

    def check() -> None:
        given, shape = (read_source(spec(file), file) for file in (path, directory / f"shape{suffix}"))
        assert shape.degree == given.degree == 1
        assert np.array_equal(shape.cells, given.cells)
        assert np.array_equal(shape.node_tags, given.node_tags)
        assert np.array_equal(shape.points, nodes)

    on_root(comm, check)


@pytest.mark.everyday("-3")
@pytest.mark.parallel(RANKS)
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_nodes_of_a_higher_degree_are_on_the_given_cells(degree: int, comm: MPI.Intracomm, meshes: Path) -> None:
    given = straight(meshes, hexahedra=True) if comm.rank == 0 else None
    if given is not None:  # cells that are not parallelepipeds
        given = dataclasses.replace(given, points=given.points * (1 + 0.1 * given.points[:, [1, 2, 0]]))
    file = spec(meshes / "box.py", parameters={"hexahedra": True})
    first, body = (build_body(file, {}, comm, degree=d, replacement=given) for d in (1, degree))
    assert (first.degree, body.degree, body.source.degree) == (1, degree, 1)
    x = body.mesh.geometry.x * body.length_scale
    there = reorder_to_source(body, x)
    assert np.array_equal(there, body.source.points.reshape(-1, 3))
    assert np.abs(local_node_values(body, there) - x).max() < 1e-15 * np.abs(x).max()


@pytest.mark.parallel([2, 1])
def test_forward_and_back_from_straight_cells_closes(comm: MPI.Intracomm, meshes: Path) -> None:
    mesh = {"file": str(meshes / "box.py"), "parameters": {"nx": 3, "ny": 1, "nz": 1, "lx": 3.0}, "geometry_degree": 1}
    both = sagging(mesh, analysis="round_trip", first="forward", certificate=NO_CERTIFICATE)
    result = hpcinv.run(both, comm)
    assert result.errors["round_trip"]["max"] < 1e-10 * result.solutions[0].largest_displacement


@pytest.mark.parametrize(("analysis", "resumes"), [("inverse", True), ("round_trip", False)])
def test_checkpoints_on_moved_straight_cells_are_refused(analysis: str, resumes: bool) -> None:
    """Earlier versions solved back on the given cells with moved nodes; their first solve is the same."""
    mesh = {"file": "../meshes/box.py", "parameters": {"nx": 1}}
    new = fingerprint(sagging(mesh, analysis=analysis))
    old = new | {"discretisation": {k: v for k, v in new["discretisation"].items() if k != "recovered_geometry"}}
    if resumes:
        check_same_problem(HERE, old, new)
        return
    with pytest.raises(CheckpointError, match="recovered_geometry: absent -> 2"):
        check_same_problem(HERE, old, new)
