"""Lines of the package that a process executes, recorded test by test."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from helpers import executed_lines

PROGRAM = """
import json, os, runpy, sys
start = runpy.run_path(sys.argv[1])
if sys.argv[3] == "pytest":
    start["start"].__globals__["_write_for_test"] = lambda: None
start["start"]()
law = runpy.run_path(sys.argv[2])
law["strain"](1)
first = start["restarted"]()
law["strain"](1)
law["strain"](-1)
if (child := os.fork()) == 0:
    law["stress"](1)
    os._exit(0)
os.waitpid(child, 0)
second = start["restarted"]()
print(json.dumps([{name: sorted(numbers) for name, numbers in lines.items()} for lines in (first, second)]))
"""
LAW = """def strain(x):
    if x < 0:
        return 0
    return x
def stress(x):
    return (
        x)
class Law:
    order = 1
"""
TEST = "tests/unit/test_law.py::test_strain[a (b)]"


def run(directory: Path, as_pytest: bool) -> str:
    """Execute parts of a module; return what is printed."""
    (directory / "hpcinv").mkdir()
    (directory / "hpcinv" / "law.py").write_text(LAW)
    environment = os.environ | {executed_lines.DIRECTORY: str(directory), executed_lines.TEST: f"{TEST} (call)"}
    command = [sys.executable, "-c", PROGRAM, executed_lines.__file__, str(directory / "hpcinv" / "law.py")]
    command.append("pytest" if as_pytest else "command")
    return subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout


def test_lines_are_recorded_again_after_each_test(tmp_path: Path) -> None:
    assert run(tmp_path, as_pytest=True) == '[{"hpcinv/law.py": [2, 4]}, {"hpcinv/law.py": [2, 3, 4]}]\n'


def test_processes_that_a_test_starts_write_for_it_while_they_run(tmp_path: Path) -> None:
    assert run(tmp_path, as_pytest=False) == "[{}, {}]\n"
    blocks = [
        block.split("\n") for path in tmp_path.glob("*.lines") for block in path.read_text().strip().split("\n\n")
    ]
    assert {block[0] for block in blocks} == {TEST}
    lines = {line for block in blocks for line in block[1:]}
    assert lines == {f"hpcinv/law.py {number}" for number in (2, 3, 4, 6, 7)}
