"""Commands of the tutorials, typed in a directory with the project's jobs and meshes."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.command_line import MPIRUN, environment

ROOT = Path(__file__).parents[2]
TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
WITHOUT_SOLVE = re.compile(r" hpcinv (validate|sweep (plan|submit)) ")
of_every_tutorial = pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)


def commands(page: Path) -> list[str]:
    blocks: list[str] = re.findall(r"^```sh\n(.*?)^```", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    return [line for block in blocks for line in block.splitlines() if line and not line.startswith("#")]


@pytest.fixture
def directory(tmp_path: Path) -> Path:
    for name in ("jobs", "meshes"):
        (tmp_path / name).symlink_to(ROOT / name)
    return tmp_path


def type_in(line: str, directory: Path) -> None:
    programs = {"python": sys.executable, "mpirun": str(MPIRUN)}
    words = [programs.get(word, word) for word in shlex.split(line)]
    settings = environment() | {"OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "1")}
    found = subprocess.run(words, cwd=directory, env=settings, capture_output=True, text=True, timeout=900)
    assert found.returncode == 0, f"{line}\n{found.stdout[-2000:]}\n{found.stderr[-2000:]}"


@of_every_tutorial
def test_commands_without_a_solve(page: Path, directory: Path) -> None:
    for line in commands(page):
        if WITHOUT_SOLVE.search(line):
            type_in(line, directory)


@pytest.mark.release
@of_every_tutorial
def test_whole_tutorials(page: Path, directory: Path) -> None:
    assert commands(page)
    for line in commands(page):
        type_in(line, directory)
