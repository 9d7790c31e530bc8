"""Programs with packages that the environment of the tests lacks."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from helpers.command_line import ROOT, environment


def run_with(packages: Sequence[str], *command: str, cwd: Path = ROOT, **settings: str) -> str:
    """Run a program with packages that uv adds to this environment, and return what it prints.

    Args:
        settings: further variables of the environment.
    """
    uv = os.environ.get("UV") or shutil.which("uv")
    if not uv:
        pytest.skip("needs uv")
    added = [word for package in packages for word in ("--with", package)]
    line = [uv, "run", "--project", str(ROOT), "--no-sync", *added, *command]
    # The environment of uv lies over this one, whose libraries of MPI are found by their place.
    where = environment() | {"LD_LIBRARY_PATH": str(Path(sys.prefix) / "lib")} | settings
    ended = subprocess.run(line, cwd=cwd, env=where, capture_output=True, text=True, timeout=3000, check=False)
    assert ended.returncode == 0, ended.stderr[-3000:]
    return ended.stdout + ended.stderr


def run_alone(packages: Sequence[str], script: Path) -> str:
    """Run a script next to its files in an environment of its own, and return what it prints."""
    uv = os.environ.get("UV") or shutil.which("uv")
    if not uv:
        pytest.skip("needs uv")
    bare = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    added = [word for package in packages for word in ("--with", package)]
    command = [uv, "run", "--no-project", "--isolated", "--python", "3.12", *added, "python", script.name]
    done = subprocess.run(
        command, cwd=script.parent, env=bare, capture_output=True, text=True, timeout=1500, check=False
    )
    if "No solution found" in done.stderr or "Failed to fetch" in done.stderr:
        pytest.skip(f"{packages[0]} cannot be installed: {done.stderr[-200:]}")
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout
