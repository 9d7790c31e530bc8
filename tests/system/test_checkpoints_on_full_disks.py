"""Checkpoints that a disk has no room for."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers.command_line import BLOCK, hpcinv, hpcinv_here, write_job


@pytest.fixture(params=["40k", "120k", "200k"])
def small_disk(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Path]:
    """A disk of its own, for no checkpoint of 120 kB, or one."""
    path = tmp_path / "disk"
    path.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={request.param}", "tmpfs", str(path)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("needs the right to mount a small disk")
    yield path
    subprocess.run(["umount", "-l", path], check=True)


@pytest.mark.everyday("40k")
def test_a_full_disk_is_reported_where_a_checkpoint_is_written(small_disk: Path, tmp_path: Path) -> None:
    mesh = {**BLOCK["mesh"], "parameters": {"nx": 4, "ny": 4, "nz": 4}}
    fixed = {"strategy": "fixed", "steps": 3}
    job = write_job(
        tmp_path / "job.yaml",
        BLOCK,
        mesh=mesh,
        solver=fixed,
        checkpoint={"every": 1},
        output={"fields": False, "mesh": []},
    )
    done = hpcinv(2, "run", job, "--output", small_disk / "run", cwd=tmp_path)
    assert done.returncode == 2, done.stdout + done.stderr
    assert done.stderr.count("cannot be written: No space left on device") == 1
    assert "Make room there" in done.stderr
    assert "Abort" not in done.stderr
    assert "ADIOS2" not in done.stderr
    assert not list(small_disk.glob("run/checkpoints/.partial-*"))
    subprocess.run(["mount", "-o", "remount,size=10m", small_disk], check=True)
    if list(small_disk.glob("run/checkpoints/*")):
        done = hpcinv_here("resume", small_disk / "run", cwd=tmp_path)
        assert done.returncode == 0, done.stdout + done.stderr
