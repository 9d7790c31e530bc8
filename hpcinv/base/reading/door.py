"""The door through which every file of a user is read, so that ``--untrusted`` holds wherever one is opened.

A file is opened as ``admitted(path).open()``, a program is executed as ``run_path(trusted(path))``. Without
``--untrusted`` both return the path. A test walks the code, and refuses other openings.

The option sets two environment variables, which all processes that a command starts inherit: `VARIABLE`, and in
`PLACES` the files and directories that the user has named, as JSON.
"""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hpcinv.errors import HpcinvError, JobError

VARIABLE = "HPCINV_UNTRUSTED"
PLACES = "HPCINV_UNTRUSTED_PLACES"
REFUSED = "refused with --untrusted"


class Refused(HpcinvError):
    """A file is not read because of ``--untrusted``."""

    exit_code = 2

    def __init__(self, path: Path, text: str) -> None:
        super().__init__(f"{path}: {text}")
        self.path, self.text = path, text

    def __reduce__(self) -> tuple[type["Refused"], tuple[Path, str]]:
        return type(self), (self.path, self.text)


def is_asked() -> bool:
    """Return whether the environment variable is set; raises ``JobError`` if its value is not valid."""
    value = os.environ.get(VARIABLE, "")
    if value not in ("", "0", "1"):
        raise JobError(f"{VARIABLE}={value}: must be 1, to refuse files that could execute code, or unset")
    return value == "1"


_noted: list[set[Path]] = []


@contextmanager
def files_noted() -> Iterator[set[Path]]:
    """Context that notes the absolute paths of all files for which this door is asked in it."""
    paths = set[Path]()
    _noted.append(paths)
    try:
        yield paths
    finally:
        del _noted[next(i for i, other in enumerate(_noted) if other is paths)]


def _note(path: Path) -> None:
    for paths in _noted:
        paths.add(path.absolute())


def admitted(path: Path, named_in: Path | None = None) -> Path:
    """Return the path of a file that is about to be read.

    Args:
        named_in: the file that names it, whose directory it must not leave.

    Raises:
        Refused: with ``--untrusted``, if it is outside of what the user has named.
    """
    _note(path)
    if not is_asked():
        return path
    if named_in is not None and (fault := path_fault(named_in.parent, os.path.relpath(path, named_in.parent))):
        raise Refused(path, fault)
    places = [Path(place) for place in json.loads(os.environ.get(PLACES, "[]"))]
    real = path.resolve()
    if places and not any(real.is_relative_to(place) for place in places):
        raise Refused(path, f"leads out of the directories of the files that were named, and is {REFUSED}")
    return path


def trusted(path: Path) -> Path:
    """Return the path of a program, or of a file that can make a library execute one; ``Refused`` if that is asked."""
    _note(path)
    if is_asked():
        raise Refused(path, f"can execute code, and is {REFUSED}; ask for one file of data, such as .msh or .vtu")
    return path


def admit(*places: Path) -> None:
    """Let files be read that are one of these, or below one of these directories."""
    known = json.loads(os.environ.get(PLACES, "[]"))
    os.environ[PLACES] = json.dumps(list(dict.fromkeys([*known, *(str(place.resolve()) for place in places)])))


def path_fault(directory: Path, path: str) -> str:
    """Fault of a path in an untrusted file in ``directory``; empty text if there is none."""
    if (directory / path).resolve().is_relative_to(directory.resolve()):
        return ""
    return f"leads out of the directory of the file, and is {REFUSED}; put the needed files there"
