"""Checkpoints by themselves: any number of ranks, any element, damaged and foreign ones."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.checkpoints import PROBLEM, fields
from helpers.mesh_cases import spec
from helpers.solutions import SOLVES

from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import CheckpointError
from hpcinv.mesh import Body, build_body
from hpcinv.output.checkpoint import _FORMAT, Checkpoints, Position, functions_digest

DAMAGED = "functions.bp or state.json is damaged"
BOX = {"nx": 3, "ny": 2, "nz": 2}
MESHES: Mapping[str, tuple[str, dict[str, Any]]] = {
    "tetrahedra-metis": ("box.py", {"parameters": BOX}),
    "tetrahedra-scotch": ("box.py", {"parameters": BOX, "partition": "scotch"}),
    "hexahedra": ("box.py", {"parameters": BOX | {"hexahedra": True}}),
    "curved": ("pdms_beam.py", {"parameters": {"size": "4 mm"}, "geometry_degree": 2}),
}


def body_on(comm: MPI.Intracomm, name: str, meshes: Path) -> Body:
    file, settings = MESHES[name]
    return build_body(spec(meshes / file, **settings), {}, comm, resolve=Path)


@pytest.mark.everyday("tetrahedra-scotch-4", "hexahedra-2")
@pytest.mark.parallel(3)
@pytest.mark.parametrize(
    ("mesh", "degree"),
    [
        ("tetrahedra-metis", 2),
        ("tetrahedra-metis", 3),
        ("tetrahedra-scotch", 4),
        ("hexahedra", 2),
        ("hexahedra", 3),
        ("curved", 3),
    ],
)
def test_a_checkpoint_of_two_ranks_reads_the_same_on_one_and_three(
    mesh: str, degree: int, comm: MPI.Intracomm, run_directory: Path, meshes: Path
) -> None:
    position = Position(0, 0.375, (SOLVES,))
    two = comm.Split(0 if comm.rank < 2 else 1)
    if comm.rank < 2:
        written = fields(body_on(two, mesh, meshes), degree, filled=True)
        Checkpoints(run_directory, two, PROBLEM, keep=2).write(position, written)
    comm.Barrier()
    for some in (comm, MPI.COMM_SELF):
        body = body_on(some, mesh, meshes)
        restart = Checkpoints(run_directory, some, PROBLEM, keep=2).latest()
        assert restart is not None
        expected = fields(body, degree, filled=True)
        for name, function in fields(body, degree, filled=False).items():
            restart.read(name, function)
            np.testing.assert_allclose(function.x.array, expected[name].x.array, rtol=0, atol=1e-13)


@pytest.fixture
def three(tmp_path: Path, meshes: Path) -> Checkpoints:
    """Three checkpoints, at load factors 0.25, 0.5 and 0.75."""
    checkpoints = Checkpoints(tmp_path / "checkpoints", MPI.COMM_SELF, PROBLEM, keep=3)
    body = body_on(MPI.COMM_SELF, "tetrahedra-metis", meshes)
    for load in (0.25, 0.5, 0.75):
        checkpoints.write(Position(0, load, (SOLVES[1:],)), fields(body, 1, filled=True))
    return checkpoints


def newest(checkpoints: Checkpoints, age: int = 0) -> Path:
    return sorted(checkpoints.directory.glob("[0-9]*"))[-1 - age]


def flip_a_byte(path: Path) -> None:
    data = next(f for f in sorted((path / "functions.bp").iterdir()) if f.name.startswith("data"))
    content = bytearray(data.read_bytes())
    content[len(content) // 2] ^= 1
    data.write_bytes(content)


def truncate_state(path: Path) -> None:
    text = (path / "state.json").read_text()
    (path / "state.json").write_text(text[: len(text) // 2])


def change_state(path: Path) -> None:
    """Still JSON, but no state."""
    (path / "state.json").write_text("[1, 2]")


def put_binary_in_state(path: Path) -> None:
    (path / "state.json").write_bytes(b"\xff\xfe\x00")


def name_an_unknown_outcome(path: Path) -> None:
    state = json.loads((path / "state.json").read_text())
    state["position"]["solves"][0][0]["outcome"] = "FLOWN_AWAY"
    (path / "state.json").write_text(json.dumps(state))


def change_the_load(path: Path) -> None:
    text = (path / "state.json").read_text()
    (path / "state.json").write_text(text.replace('"load": 0.75', '"load": 0.85', 1))


def remove_state(path: Path) -> None:
    (path / "state.json").unlink()


def remove_functions(path: Path) -> None:
    shutil.rmtree(path / "functions.bp")


def remove_metadata(path: Path) -> None:
    (path / "functions.bp" / "md.0").unlink()


DAMAGES = {
    flip_a_byte: DAMAGED,
    truncate_state: "state.json is missing or damaged",
    change_state: "state.json is missing or damaged",
    put_binary_in_state: "state.json is missing or damaged",
    name_an_unknown_outcome: DAMAGED,
    change_the_load: DAMAGED,
    remove_state: "state.json is missing or damaged",
    remove_functions: DAMAGED,
    remove_metadata: DAMAGED,
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_checkpoint_is_refused_and_the_previous_one_is_used(
    damage: Callable[[Path], None], three: Checkpoints
) -> None:
    path = newest(three)
    damage(path)
    restart = three.latest()
    assert restart is not None
    assert restart.position.load == 0.5
    assert [c for c in restart.complaints if str(path) in c and DAMAGES[damage] in c]


def test_all_damaged_is_an_error_that_names_each(three: Checkpoints) -> None:
    for age in range(3):
        flip_a_byte(newest(three, age))
    with pytest.raises(CheckpointError) as raised:
        three.latest()
    assert str(raised.value).count(DAMAGED) == 3


def test_a_missing_checkpoint_is_not_an_error(tmp_path: Path) -> None:
    assert Checkpoints(tmp_path / "none", MPI.COMM_SELF, PROBLEM, keep=2).latest() is None


def test_a_checkpoint_of_another_problem_is_refused_with_the_difference(three: Checkpoints) -> None:
    three.fingerprint = {"material": {"law": "neo-hookean", "mu": 2.0}}
    with pytest.raises(CheckpointError, match=r"material\.mu: 1\.0 -> 2\.0"):
        three.latest()


def test_a_checkpoint_of_another_format_is_refused_by_name(three: Checkpoints) -> None:
    path = newest(three) / "state.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"format": 99}))
    with pytest.raises(CheckpointError, match="has format 99"):
        three.latest()


@pytest.mark.parametrize("version", [_FORMAT, 99])
def test_a_checkpoint_of_a_newer_version_is_kept(version: int, three: Checkpoints) -> None:
    """It is whole, though an entry of a solve is not known here."""
    path = newest(three)
    state = json.loads((path / "state.json").read_text()) | {"format": version}
    del state["digest"]
    state["position"]["solves"][0][0]["of a newer version"] = 1
    state["digest"] = functions_digest(state, path / "functions.bp")
    (path / "state.json").write_text(json.dumps(state))
    why = "has format 99" if version == 99 else "written by another version of hpcinv"
    with pytest.raises(CheckpointError, match=f"{path}: .*{why}") as refused:
        three.latest()
    assert "Resume with the version that wrote it" in refused.value.advice
    assert path.exists()


def test_damaged_checkpoints_do_not_replace_an_intact_one(three: Checkpoints, meshes: Path) -> None:
    damaged = newest(three)
    flip_a_byte(damaged)
    three.keep = 2
    assert three.latest() is not None
    three.write(Position(0, 1.0, (SOLVES,)), fields(body_on(MPI.COMM_SELF, "tetrahedra-metis", meshes), 1, filled=True))
    assert [p.name for p in sorted(three.directory.iterdir())] == ["0002", "0004"]


def test_half_written_checkpoints_are_ignored_and_removed(three: Checkpoints) -> None:
    partial = three.directory / ".partial-0004"
    shutil.copytree(newest(three), partial)
    restart = three.latest()
    assert restart is not None
    assert restart.position.load == 0.75
    assert not partial.exists()
