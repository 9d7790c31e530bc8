"""Consoles that handle a closed pipe, as in ``hpcinv laws | head``, and a terminal behind the pipes of mpirun."""

import os
import stat
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TextIO

import rich.console
from rich.table import Table

from hpcinv.base.parallel.signals import discard_output
from hpcinv.errors import OutputError


class Console(rich.console.Console):
    """Console of commands that only print: raises ``BrokenPipeError`` when the pipe is closed."""

    def on_broken_pipe(self) -> None:
        raise BrokenPipeError


def table_console(width: int = 140) -> Console:
    """Return a console for tables: as wide as the terminal, or ``width``, since a file or a pipe has none."""
    console = Console(highlight=False, markup=False)
    if not console.is_terminal:
        console.width = width
    return console


def table_of_numbers(*titles: str, texts: int = 1, header_style: str = "") -> Table:
    """Return a table without lines, with the numbers on the right, after some columns with ``texts``."""
    table = Table(box=None, pad_edge=False, header_style=header_style)
    for i, title in enumerate(titles):
        table.add_column(title, justify="left" if i < texts else "right", no_wrap=True)
    return table


class RunConsole(rich.console.Console):
    """Console of a run, which continues when its output cannot be written, since its results are files."""

    def on_broken_pipe(self) -> None:
        self.quiet = True
        discard_output()

    def _check_buffer(self) -> None:
        try:
            super()._check_buffer()
        except OutputError as error:  # such as a full disk
            print(f"warning: {error.message}; the run goes on", file=sys.stderr)
            self.on_broken_pipe()


class ForwardedConsole(RunConsole):
    """Console of a run under mpirun: it never hides the cursor, which a killed run could not show again."""

    def show_cursor(self, show: bool = True) -> bool:
        return False


def run_console(stream: TextIO) -> RunConsole:
    """Return a console with a live bar if the output is a terminal, also through the pipes of mpirun."""
    settings: dict[str, Any] = {"highlight": False, "markup": False, "soft_wrap": True}
    if not stream.isatty() and (width := width_through_mpirun(stream)):
        return ForwardedConsole(file=stream, force_terminal=True, width=width, **settings)
    return RunConsole(file=stream, **settings)


_MANAGERS = ("mpirun", "mpiexec", "mpiexec.hydra")
# Options that change lines or write them to files.
_LABELS = ("-l", "-prepend-rank", "-prepend-pattern", "-outfile", "-outfile-pattern")
_GENERATIONS = 8


def width_through_mpirun(stream: TextIO, proc: Path = Path("/proc")) -> int | None:
    """Return the width of the terminal to which mpirun on this machine forwards ``stream``, else ``None``.

    There is one only if ``stream`` is a pipe that a parent process reads, one of the parents is mpirun, and the output
    of mpirun is a terminal, so that nothing redirects the output.
    """
    try:
        number = stream.fileno()
        if not stat.S_ISFIFO(os.fstat(number).st_mode):
            return None
        pipe = (proc / "self" / "fd" / str(number)).readlink()
        parents = list(_parents(proc, os.getpid()))
        if not any(pipe in _open_files(proc / str(parent)) for parent in parents[:2]):
            return None
        manager = next(p for p in parents if _arguments(proc, p) and _is_manager(_arguments(proc, p)))
        if any(argument.split("=")[0] in _LABELS for argument in _arguments(proc, manager)):
            return None
        with open(proc / str(manager) / "fd" / "1", "wb", buffering=0, opener=_open_without_control) as terminal:
            return os.get_terminal_size(terminal.fileno()).columns if terminal.isatty() else None
    except (OSError, ValueError, StopIteration):  # another system, another user's processes, no terminal
        return None


def _open_without_control(path: str, flags: int) -> int:
    return os.open(path, (flags & ~(os.O_CREAT | os.O_TRUNC)) | os.O_NOCTTY | os.O_NONBLOCK)


def _parents(proc: Path, process: int) -> Iterator[int]:
    for _ in range(_GENERATIONS):
        # The name, in parentheses, may contain any character.
        process = int((proc / str(process) / "stat").read_text().rpartition(")")[2].split()[1])
        if process <= 1:
            return
        yield process


def _open_files(process: Path) -> set[Path]:
    return {file.readlink() for file in (process / "fd").iterdir()}


def _arguments(proc: Path, process: int) -> list[str]:
    return [os.fsdecode(a) for a in (proc / str(process) / "cmdline").read_bytes().split(b"\0")]


def _is_manager(arguments: list[str]) -> bool:
    """Return whether the program, or the script that an interpreter runs, is a process manager."""
    return any(Path(argument).name in _MANAGERS for argument in arguments[:2])
