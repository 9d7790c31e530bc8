"""Files of a user that are written again keep their mode, and nobody else can read them meanwhile."""

import os
import stat
from pathlib import Path

import numpy as np
import pytest
from helpers.command_line import BLOCK, write_job

from hpcinv.base.files import atomic
from hpcinv.mesh.mesh_files import save
from hpcinv.mesh.source import MeshSource
from hpcinv.studies.serving.job_editor import JobEditor


def mode_of(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o400, 0o755])
def test_the_mode_of_a_file_that_is_replaced_stays(mode: int, tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"old")
    path.chmod(mode)
    atomic.replace(path, b"new")
    assert (path.read_bytes(), mode_of(path)) == (b"new", mode)


def test_a_new_file_has_the_mode_of_new_files(tmp_path: Path) -> None:
    (tmp_path / "other").touch()
    atomic.replace(tmp_path / "file", b"new")
    assert mode_of(tmp_path / "file") == mode_of(tmp_path / "other")


def test_the_content_of_a_private_file_is_never_readable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, partial = tmp_path / "file", tmp_path / ".file.partial"
    path.write_bytes(b"old")
    path.chmod(0o600)
    partial.write_bytes(b"of a run that was killed")  # with the mode of new files
    modes = []
    monkeypatch.setattr(os, "fsync", lambda _: modes.append(mode_of(partial) if partial.exists() else 0o600))
    atomic.replace(path, b"new")
    assert set(modes) == {0o600}


def test_a_job_that_is_edited_stays_private(tmp_path: Path) -> None:
    job = write_job(tmp_path / "job.yaml", BLOCK)
    job.chmod(0o600)
    editor = JobEditor(job, b"", 0, "token")
    try:
        editor._write([("regions", "top: z > 0.9")])
    finally:
        editor.close()
    assert "top: z > 0.9" in job.read_text()
    assert mode_of(job) == 0o600


def test_a_mesh_that_is_written_again_stays_private(tmp_path: Path) -> None:
    points, tags = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]), np.arange(1, 5)
    path, cells = tmp_path / "body.vtu", np.array([[0, 1, 2, 3]])
    source = MeshSource(path, "tetrahedron", 1, points, tags, cells, tags[:1], np.zeros((0, 3), dtype=np.int64), ())
    save(path, source, points)
    path.chmod(0o600)
    save(path, source, points)
    assert mode_of(path) == 0o600
