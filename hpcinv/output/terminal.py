"""Terminal of standard output, also through the pipes of a process manager such as mpirun."""

import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

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
        with open(proc / str(manager) / "fd" / "1", "wb", buffering=0, opener=_without_control) as terminal:
            return os.get_terminal_size(terminal.fileno()).columns if terminal.isatty() else None
    except (OSError, ValueError, StopIteration):  # another system, another user's processes, no terminal
        return None


def _without_control(path: str, flags: int) -> int:
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
