"""A mesh file that a process reads while this one imports: read once, and by nobody if it is not needed."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hpcinv.base.parallel import children
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.mesh.io import isolated
from hpcinv.mesh.io.isolated import reading_ahead
from hpcinv.mesh.readers import FILES

TETRAHEDRON = "*node\n1, 0, 0, 0\n2, 1, 0, 0\n3, 0, 1, 0\n4, 0, 0, 1\n*element, type=C3D4, elset=all\n1, 1, 2, 3, 4\n"


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[subprocess.Popen[bytes]]:
    """The processes that have been started since."""
    processes, start = list[subprocess.Popen[bytes]](), children.start_child

    def recorded(*arguments: Any, **options: Any) -> subprocess.Popen[bytes]:
        processes.append(start(*arguments, **options))
        return processes[-1]

    monkeypatch.setattr(children, "start_child", recorded)
    monkeypatch.setattr(isolated, "start_child", recorded)
    return processes


def test_one_process_reads_the_mesh(tmp_path: Path, started: list[subprocess.Popen[bytes]]) -> None:
    path = tmp_path / "part.inp"
    path.write_text(TETRAHEDRON)
    with reading_ahead(MeshSpec.model_construct(file=path.name), path):
        assert len(started) == 1
        assert np.array_equal(FILES[".inp"](path).points, [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
        assert len(started) == 1
        FILES[".inp"](path)
        assert len(started) == 2


def test_a_process_that_was_not_needed_ends(tmp_path: Path, started: list[subprocess.Popen[bytes]]) -> None:
    path = tmp_path / "part.inp"
    path.write_text(TETRAHEDRON)
    with reading_ahead(MeshSpec.model_construct(file=path.name), path):
        pass
    assert [process.returncode is not None for process in started] == [True]


@pytest.mark.parametrize("name", ["missing.inp", "generator.py", "mesh.msh"])
def test_other_files_are_left_to_their_readers(
    name: str, tmp_path: Path, started: list[subprocess.Popen[bytes]]
) -> None:
    """A missing file has the message of its reader; gmsh's files are checked once only."""
    with reading_ahead(MeshSpec.model_construct(file=name), tmp_path / name):
        assert not started
