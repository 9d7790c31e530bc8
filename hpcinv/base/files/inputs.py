"""Files that a program of the user reads, such as a mesh generator or a plugin: their paths and digests.

Results depend on them as on the program itself. Reads of Python are seen by an audit hook; libraries that read files by
themselves, such as gmsh, report them with `note_input`.
"""

import hashlib
import os
import sys
import sysconfig
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from hpcinv.base.reading.door import admitted

_WRITES = os.O_WRONLY | os.O_RDWR | os.O_APPEND | os.O_CREAT
_SYSTEM = tuple(
    os.path.join(os.path.realpath(path), "")  # noqa: PTH118  (a path that ends with its separator)
    for path in (
        *(sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")),
        *(str(Path(__file__).parents[2]), "/proc", "/sys", "/dev", "/etc", "/usr/lib", "/usr/share"),
        *(os.path.expanduser(path) for path in ("~/.cache", "~/.config")),  # noqa: PTH111  (there may be no home)
    )
)
"""directories of installed programs, whose versions are recorded elsewhere, and of their caches and settings"""


class _Recorder:
    """Files read while it is active; ``None`` for those that were written before they were read."""

    def __init__(self) -> None:
        self.is_active = False
        self.files: dict[str, bool] = {}

    def note(self, path: str, *, written: bool) -> None:
        real = os.path.realpath(path)
        if not real.startswith(_SYSTEM) and not real.endswith(".pyc"):
            self.files.setdefault(real, not written)


_recorder = _Recorder()
_is_hooked: list[bool] = []


def _hook(event: str, arguments: tuple[Any, ...]) -> None:
    if event != "open" or not _recorder.is_active:
        return
    path, mode, flags = arguments
    with suppress(TypeError, ValueError, OSError):
        written = bool(set(mode or "") & set("wax+")) or bool((flags or 0) & _WRITES and mode is None)
        _recorder.note(os.fsdecode(path), written=written)


@contextmanager
def recorded_inputs(program: Path, *, reimported: bool = False) -> Iterator[dict[str, str]]:
    """Context in which a program in Python runs; yields a mapping that has its inputs at the end.

    In it relative paths start from the directory of the program, where also modules are found that it imports. The
    mapping has the SHA-256 of each file by its path from that directory. Files that the program itself writes, and
    files of installed packages, are left out.

    Args:
        reimported: whether modules of that directory are imported again by the next program.
    """
    if not _is_hooked:
        sys.addaudithook(_hook)  # for the life of the process
        _is_hooked.append(True)
    home, last_directory, modules = program.absolute().parent, _working_directory(), set(sys.modules)
    # Python takes kept byte code for current if a module changes within a second and keeps its size.
    writes_no_bytecode, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    inputs: dict[str, str] = {}
    _recorder.files, _recorder.is_active = {}, True
    sys.path.insert(0, str(home))
    os.chdir(home)
    try:
        yield inputs
    finally:
        _recorder.is_active, sys.dont_write_bytecode = False, writes_no_bytecode
        with suppress(ValueError):
            sys.path.remove(str(home))
        if last_directory is not None:
            os.chdir(last_directory)
        for name in set(sys.modules) - modules:
            file = getattr(sys.modules[name], "__file__", None)
            if isinstance(file, str) and not os.path.realpath(file).startswith(_SYSTEM):
                _recorder.note(file, written=False)
                if reimported and home in Path(file).absolute().parents:
                    del sys.modules[name]
        read = (path for path, is_read in _recorder.files.items() if is_read and path != os.path.realpath(program))
        inputs |= {os.path.relpath(path, home): digest for path in sorted(read) if (digest := digest_of(Path(path)))}


def note_input(path: str | Path) -> None:
    """Add a file that a library reads, from a path that starts from the working directory."""
    if _recorder.is_active:
        _recorder.note(str(path), written=False)


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a regular file; empty if there is none."""
    with suppress(OSError):
        if path.is_file():
            with admitted(path).open("rb") as file:
                return hashlib.file_digest(file, "sha256").hexdigest()
    return ""


def changed_inputs(inputs: Mapping[str, str], home: Path, digest: Callable[[Path], str] = digest_of) -> list[str]:
    """Return the inputs of a program in a directory ``home`` whose content is another one now; missing ones are not.

    Args:
        digest: returns what `digest_of` does, such as a memory of it for many programs with the same inputs.
    """
    return [name for name, known_digest in inputs.items() if digest(home / name) not in ("", known_digest)]


def _working_directory() -> str | None:
    with suppress(OSError):  # it was removed
        return os.getcwd()  # noqa: PTH109
    return None
