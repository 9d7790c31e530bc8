"""``hpcinv compile`` and the directory of HPCINV_KERNELS: what is made once need not be again, by anybody."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from helpers.command_line import BLOCK, CUBE, ROOT, environment, hpcinv, write_job

JOB: Mapping[str, Any] = {**BLOCK, "discretisation": {"displacement": 1}, "certificate": CUBE["certificate"]}
READ_ONLY = "import os, runpy; os.access = lambda *_: False; runpy.run_module('hpcinv', run_name='__main__')"


def files(directory: Path) -> set[str]:
    return {path.name for path in directory.glob("*.*") if path.suffix in (".so", ".npz", ".json")}


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A job, and a cache that was compiled and that a run has filled."""
    here = tmp_path_factory.mktemp("filled")
    job, cache = write_job(here / "job.yaml", JOB), here / "cache"
    done = hpcinv(1, "compile", job, "--cache", cache, cwd=here)
    assert done.returncode == 0, done.stderr
    assert f"{job}: nothing to compile; its first run makes programs in about a second" in done.stdout
    assert f"hpcinv's C code is in {cache}" in done.stdout
    code = files(cache)
    done = hpcinv(1, "run", job, "--output", "first", cwd=here, HPCINV_KERNELS=str(cache))
    assert done.returncode == 0, done.stderr
    assert code < files(cache)
    return job, cache


def test_compile_says_where_nothing_can_be_compiled(tmp_path: Path) -> None:
    done = hpcinv(1, "compile", "--cache", tmp_path / "cache", cwd=tmp_path, CC="no-such-cc")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("no C compiler 'no-such-cc': NumPy evaluates laws and loads")


def test_a_run_without_compiler_uses_a_shared_cache_and_what_is_missing_there_goes_to_the_users(
    filled: tuple[Path, Path], tmp_path: Path
) -> None:
    _, directory = filled
    before = files(directory)
    job = write_job(
        tmp_path / "job.yaml", JOB, quantities=[{"name": "height", "of": "X*J", "on": "block", "reduce": "mean"}]
    )
    env = environment(HPCINV_KERNELS=str(directory), XDG_CACHE_HOME=str(tmp_path), CC="no-such-cc")
    command = [sys.executable, "-c", READ_ONLY, "run", str(job), "--output", str(tmp_path / "results")]
    done = subprocess.run(command, env=env, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "NumPy" not in done.stdout
    assert files(directory) == before
    # The one program of the quantity: all others were found.
    assert len(files(tmp_path / "hpcinv")) == 1


def test_a_directory_that_cannot_be_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    job = write_job(tmp_path / "job.yaml", CUBE)
    done = hpcinv(1, "run", job, cwd=tmp_path, HPCINV_KERNELS=str(tmp_path / "file" / "kernels"))
    assert done.returncode == 2
    assert done.stderr.startswith(f"HPCINV_KERNELS={tmp_path / 'file' / 'kernels'}: Not a directory")


def test_flags_of_the_environment_give_code_of_their_own(filled: tuple[Path, Path], tmp_path: Path) -> None:
    _, directory = filled
    shutil.copytree(directory, tmp_path / "cache")
    done = hpcinv(1, "compile", "--cache", tmp_path / "cache", cwd=tmp_path, CFLAGS="-O0")
    assert done.returncode == 0, done.stderr
    assert len(files(tmp_path / "cache")) == len(files(directory)) + 2
