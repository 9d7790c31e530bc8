"""Installations beside the wheels: a DOLFINx that does not fit, and what the page on installing says to install."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from helpers.command_line import environment

ROOT = Path(__file__).parents[2]
# What a site's own DOLFINx comes with.
OF_THE_SITE = {"adios2", "adios4dolfinx", "dolfinx-solver-real", "h5py", "mpi4py", "mpich", "numpy"}


@pytest.mark.parametrize(
    ("module", "text", "told"),
    [
        ("dolfinx", "__version__ = '0.9.0'", "DOLFINx 0.9.0 is installed, and hpcinv needs 0.11"),
        ("adios4dolfinx", "raise ImportError('no such library')", "adios4dolfinx cannot be imported: no such library"),
    ],
)
def test_an_unsuitable_part_is_named(tmp_path: Path, module: str, text: str, told: str) -> None:
    (tmp_path / module).mkdir()
    (tmp_path / module / "__init__.py").write_text(text)
    command = [sys.executable, "-m", "hpcinv", "run", str(ROOT / "jobs" / "column.yaml"), "--output", "out"]
    settings = environment() | {"PYTHONPATH": str(tmp_path)}
    found = subprocess.run(command, cwd=tmp_path, env=settings, capture_output=True, text=True, timeout=120)
    assert found.returncode == 5, found.stderr
    assert told in found.stderr
    assert "docs/start/installing.md" in found.stderr
    assert "Traceback" not in found.stderr
    assert not (tmp_path / "out").exists()


def test_the_page_names_every_package_that_a_site_lacks() -> None:
    needed = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    line = re.search(r"--no-deps \. && pip install (.*)", (ROOT / "docs" / "start" / "installing.md").read_text())
    assert line
    assert set(line[1].split()) == {name.split("==")[0] for name in needed} - OF_THE_SITE
