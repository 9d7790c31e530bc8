"""Interfaces between labels of one conforming mesh, of a generator and of a label image, whose nodes are doubled."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.verification import job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import MeshError
from hpcinv.job.job import Job
from hpcinv.mesh.body import read_source
from hpcinv.results.solution import Solution

THREE_BLOCKS = """
def build(gmsh):
    corners = ((0, 0, 0, 0.5, 1, 0.5), (0.5, 0, 0, 0.5, 1, 0.5), (0, 0, 0.5, 1, 1, 0.5))
    boxes = [(3, gmsh.model.occ.addBox(*corner)) for corner in corners]
    cells, parts = gmsh.model.occ.fragment(boxes[:1], boxes[1:])
    gmsh.model.occ.synchronize()
    for name, part in zip(("left", "right", "lid"), parts):
        gmsh.model.addPhysicalGroup(3, [tag for _, tag in part], name=name)
    left, right = (set(gmsh.model.getBoundary(part, oriented=False)) for part in parts[:2])
    gmsh.model.addPhysicalGroup(2, [tag for _, tag in left & right], name="middle")
    for name, place in (("z0", (0, 0)), ("z1", (1, 2))):
        sides = gmsh.model.getBoundary(cells, oriented=False)
        held = [tag for _, tag in sides if abs(gmsh.model.occ.getCenterOfMass(2, tag)[2] - place[0]) < 1e-9]
        gmsh.model.addPhysicalGroup(2, held, name=name)
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.6)
    gmsh.model.mesh.generate(3)
"""
GIVEN: dict[str, Any] = {
    "analysis": "forward",
    "material": {"law": "neo-hookean", "mu": 1.0, "lam": 2.0},
    "solver": {"tolerance": 1e-12},
    "discretisation": {"displacement": 1},
    "effects": [{"effect": "traction", "region": "z1", "traction": [0.1, 0.05, 0.2], "area_in": "reference"}],
    "supports": [{"region": "z0", "fix": ["x", "y", "z"]}],
}
PAIRS = [("left", "right"), ("left", "lid"), ("lid", "right")]


@pytest.fixture
def blocks(run_directory: Path, comm: MPI.Intracomm) -> dict[str, Any]:
    """Two blocks next to each other, and a lid on both."""
    file = run_directory / "three.py"
    if comm.rank == 0:
        file.write_text(THREE_BLOCKS)
    comm.Barrier()
    return {"file": str(file)}


def interfaces(kind: str, *pairs: tuple[str, str]) -> list[dict[str, Any]]:
    return [{"between": list(pair), "kind": kind} for pair in pairs]


def everywhere(solution: Solution, comm: MPI.Intracomm) -> np.ndarray:
    """Nodes and displacements (n, 6) of all ranks."""
    return np.vstack(comm.allgather(np.hstack([solution.mesh_nodes, solution.u])))


@pytest.mark.release
@pytest.mark.parallel([2, 1])
@pytest.mark.parametrize(
    ("analysis", "pairs"),
    [("forward", PAIRS), ("inverse", PAIRS[:1]), pytest.param("inverse", PAIRS, marks=pytest.mark.release)],
)
def test_tied_labels_are_one_conforming_body(
    analysis: str, pairs: list[tuple[str, str]], blocks: dict[str, Any], comm: MPI.Intracomm
) -> None:
    """With one interface its edge at the lid is closed; with three, each label has nodes of its own."""
    data = GIVEN | {"mesh": blocks, "analysis": analysis}
    whole = everywhere(hpcinv.run(job(**data), comm).solutions[0], comm)
    solution = hpcinv.run(job(**data, interfaces=interfaces("tied", *pairs)), comm).solutions[0]
    tied = everywhere(solution, comm)
    places = np.round(whole[:, :3], 9)
    for row in tied:
        same = np.flatnonzero((places == np.round(row[:3], 9)).all(axis=1))[0]
        assert np.abs(whole[same, 3:] - row[3:]).max() < 1e-10
    areas = [contact.area for contact in solution.contacts]
    assert areas == pytest.approx([0.5] * len(pairs), rel=1e-9)


def source_of(posed: Job) -> Any:
    return read_source(posed.mesh, posed.resolve(posed.mesh.file))


def test_regions_have_both_sides_of_what_is_doubled(blocks: dict[str, Any]) -> None:
    data = GIVEN | {"mesh": blocks}
    whole, doubled = source_of(job(**data)), source_of(job(**data, interfaces=interfaces("tied", PAIRS[0])))
    counts = {group.name: len(group.members) for group in doubled.groups if group.dim == 2}
    before = {group.name: len(group.members) for group in whole.groups if group.dim == 2}
    assert counts["middle"] == 2 * before["middle"]
    assert counts["left|right"] == counts["right|left"] == before["middle"]
    assert all(counts[name] == before[name] for name in ("z0", "z1"))
    copied = doubled.points[len(whole.points) :]
    assert (copied[:, 2] < 0.5).all()  # on the lid they stay
    assert len(copied) == int(((whole.points[:, 0] == 0.5) & (whole.points[:, 2] < 0.5)).sum())


def test_labels_without_a_common_facet_are_refused(blocks: dict[str, Any], tmp_path: Path) -> None:
    file = tmp_path / "apart.py"
    apart = THREE_BLOCKS.replace("(0.5, 0, 0, 0.5, 1, 0.5)", "(0.6, 0, 0, 0.4, 1, 0.5)")
    file.write_text("\n".join(line for line in apart.splitlines() if "middle" not in line))
    posed = job(**GIVEN | {"mesh": {"file": str(file)}, "interfaces": interfaces("tied", PAIRS[0])})
    with pytest.raises(MeshError, match="the interface between 'left' and 'right' is on no facet"):
        source_of(posed)
    posed = job(**GIVEN | {"mesh": blocks, "interfaces": interfaces("tied", ("left", "middle"))})
    with pytest.raises(MeshError, match="region 'left' has cells but no facets"):
        hpcinv.run(posed, MPI.COMM_SELF)


@pytest.mark.release
def test_contact_between_labels_opens_up_to_its_closed_edge(blocks: dict[str, Any]) -> None:
    """The lid is lifted from one block, and stays joined to the other one."""
    data = GIVEN | {"mesh": blocks, "interfaces": interfaces("contact", ("left", "lid"))}
    lift = [GIVEN["effects"][0] | {"traction": [0.0, 0.0, 0.05]}]
    solution = hpcinv.run(job(**data | {"effects": lift}), MPI.COMM_SELF).solutions[0]
    x, u = solution.mesh_nodes, solution.u
    face = (np.abs(x[:, 2] - 0.5) < 1e-9) & (x[:, 0] < 1e-9)
    gaps = [np.ptp(u[face & (np.abs(x[:, 1] - y) < 1e-9)][:, 2]) for y in np.unique(np.round(x[face, 1], 9))]
    assert min(gaps) > 0.01
    assert solution.contacts[0].force[2] == pytest.approx(0.0, abs=1e-9)


@pytest.fixture
def image(run_directory: Path, comm: MPI.Intracomm) -> dict[str, Any]:
    """A bar of two labels, one on the other, of voxels of 1 mm."""
    imaging = pytest.importorskip("helpers.imaging_cases")
    if comm.rank == 0:
        voxels = np.zeros((10, 10, 14), dtype=np.uint8)
        voxels[2:-2, 2:-2, 2:7], voxels[2:-2, 2:-2, 7:-2] = 1, 2
        imaging.written(run_directory / "bar.nrrd", voxels)
    comm.Barrier()
    return {"image": str(run_directory / "bar.nrrd"), "labels": {"lung": 1, "wall": 2}, "size": "5 mm"}


IMAGED: dict[str, Any] = GIVEN | {
    "regions": {"low": "z < 2 mm", "high": "z > 11 mm"},
    "supports": [{"region": "low", "fix": ["x", "y", "z"]}],
}


@pytest.mark.parallel([2, 1])
def test_labels_of_an_image_slide_and_come_back(image: dict[str, Any], comm: MPI.Intracomm) -> None:
    held = [*IMAGED["supports"], {"region": "high", "fix": ["x", "y", "z"]}]
    push = {"effect": "gravity", "acceleration": [100, 0, 0], "density": 0.05}
    data = IMAGED | {"mesh": image, "supports": held, "effects": [push], "analysis": "round_trip", "first": "inverse"}
    result = hpcinv.run(job(**data, interfaces=interfaces("sliding", ("lung", "wall"))), comm)
    assert result.errors["round_trip"]["max"] < 1e-12 * 0.01
    assert result.surface_spread is None  # its derivatives would leave the interface out
    source = result.body.source
    sides = comm.bcast([group.members for group in source.groups if group.name in ("lung|wall", "wall|lung")])
    corners = source.points[source.facets[sides[0]]] if comm.rank == 0 else np.zeros((0, 3, 3))
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    assert len(sides[0]) == len(sides[1])
    assert result.solutions[0].contacts[0].area == pytest.approx(comm.bcast(area), rel=1e-9)
