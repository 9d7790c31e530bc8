"""Blocks of pages, typed in a shell with the `hpcinv`, `python` and `mpirun` of the tests, or run by this process."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from helpers.command_line import MPIRUN, environment, hpcinv_here

PROGRAMS = os.pathsep.join([str(Path(sys.executable).parent), str(MPIRUN.parent)])

BLOCKS = re.compile(
    r"^(?P<marks>(?:<!-- (?:not typed|file): [^\n]*? -->\n)*)```(?P<language>sh|python)\n(?P<text>.*?)^```", re.M | re.S
)
COMMAND = re.compile(r"(?:mpirun -n \d+ )?(?:python -m )?hpcinv (?P<arguments>[^|&;<>$`*]*)")
"""A command without features of the shell."""
FILES = re.compile(r"^<!-- file: (\S+) -->\n```\w+\n(.*?)^```", re.M | re.S)


def files(page: Path) -> dict[str, str]:
    """The files that the reader saves, by name."""
    return dict(FILES.findall(page.read_text()))


def blocks(page: Path) -> Iterator[tuple[str, str]]:
    """Languages and texts of a page's blocks, without files that are saved and what is not typed."""
    for block in BLOCKS.finditer(page.read_text()):
        if "<!-- file: " in block["marks"]:
            continue
        patterns = re.findall(r"<!-- not typed: (.*?), ", block["marks"])
        lines = block["text"].splitlines()
        for pattern in patterns:
            kept = [line for line in lines if not re.search(pattern, line)]
            assert len(kept) < len(lines), f"{page.name}: {pattern}"
            lines = kept
        yield block["language"], "\n".join(lines)


def type_in(line: str, directory: Path, *, ends: int = 0) -> None:
    """Type a line, which must end with an exit code."""
    settings = environment() | {"OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "1")}
    settings["MPIEXEC_TIMEOUT"] = "1800"  # other tests have a shorter one
    settings["PATH"] = os.pathsep.join([PROGRAMS, os.environ["PATH"]])
    ended = subprocess.run(line, shell=True, cwd=directory, env=settings, capture_output=True, text=True, timeout=1800)
    assert ended.returncode == ends, f"{line}\n{ended.stdout[-2000:]}\n{ended.stderr[-2000:]}"


def run_python(text: str, directory: Path) -> None:
    """Run a block of Python in this process, in a directory."""
    before, modules, path = Path.cwd(), set(sys.modules), [*sys.path]
    try:
        os.chdir(directory)
        sys.path.insert(0, str(directory))
        exec(compile(text, "typed.py", "exec"), {"__name__": "__main__"})
    finally:
        os.chdir(before)
        sys.path[:] = path
        for name in set(sys.modules) - modules:  # of the directory: another block may have another one
            if str(directory) in str(getattr(sys.modules[name], "__file__", "")):
                del sys.modules[name]


def run_line(line: str, directory: Path) -> None:
    """Run a command of hpcinv in this process, on one rank, and type any other line; it must end with exit code 0."""
    if command := COMMAND.fullmatch(line):
        ended = hpcinv_here(*shlex.split(command["arguments"], comments=True), cwd=directory)
        assert ended.returncode == 0, f"{line}\n{ended.stdout[-2000:]}\n{ended.stderr[-2000:]}"
    else:
        type_in(line, directory)
