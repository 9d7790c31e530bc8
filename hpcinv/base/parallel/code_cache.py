"""The cache: programs of what a job evaluates at points, and C code of hpcinv that was compiled.

The name of a file is a hash of all that it depends on, so that a directory can be shared by any jobs, users and
machines. HPCINV_KERNELS names the directory; the default is ``~/.cache/hpcinv``, below XDG_CACHE_HOME if that is set.
If HPCINV_KERNELS is read-only, what is missing goes to the default directory. C code is executed: files that another
user could have written are not loaded.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from hpcinv.base.parallel.cache_files import NotWritten, is_sealed, make_directory, publish, unsealed
from hpcinv.base.parallel.ownership import foreign_writer, foreign_writer_above
from hpcinv.base.parallel.ranks import MPI
from hpcinv.errors import OutputError

_TRUST = "HPCINV_TRUST_KERNELS"


def _trusts() -> bool:
    """Return whether files are loaded even if other users could have written them."""
    value = os.environ.get(_TRUST, "")
    if value not in ("", "0", "1"):
        raise OutputError(f"{_TRUST}={value}: must be 1, to load files that other users could have written, or unset")
    return value == "1"


def _directories() -> tuple[Path, ...]:
    """Directories in which files are searched; missing ones go to the last."""
    own = Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser(), "hpcinv").absolute()
    asked = os.environ.get("HPCINV_KERNELS")
    if not asked:
        refuse_foreign("the cache", own)
        return (own,)
    shared = Path(asked).expanduser().absolute()
    try:
        make_directory(shared)
    except OSError as error:
        raise OutputError(f"HPCINV_KERNELS={asked}: {error.strerror}", "Name a directory for the cache.") from None
    refuse_foreign("HPCINV_KERNELS", shared)
    if os.access(shared, os.W_OK):
        return (shared,)
    refuse_foreign("the cache", own)
    return shared, own


def refuse_foreign(what: str, directory: Path) -> None:
    """Raise ``OutputError`` for a directory into which another user could have written files, unless trusted."""
    if _TRUSTS or not directory.is_dir():
        return
    places = [(directory, reason)] if (reason := foreign_writer(directory.stat())) else []
    if parent_fault := foreign_writer_above(directory):
        places.append(parent_fault)
    if places:
        where, why = places[0]
        raise OutputError(
            f"{what} {directory}: {f'{where} above it' if where != directory else 'it'} {why}, "
            "and its files are executed",
            f"Type 'chmod go-w {where}', name another HPCINV_KERNELS, or trust these users: {_TRUST}=1.",
        )


_TRUSTS = _trusts()
_places = _directories()
_missing: list[str] = []


def directory() -> Path:
    """Return the directory to which files are written."""
    return _places[-1]


@contextmanager
def kept_in(other: Path) -> Iterator[None]:
    """Context in which another directory is the cache."""
    global _places
    before, _places = _places, (other,)
    try:
        yield
    finally:
        _places = before


def note_missing(name: str) -> None:
    """Note that a file was not found."""
    _missing.append(name)


def missing_count() -> int:
    """Return how many files this process did not find, so that it made them or waited for them."""
    return len(_missing)


def find(name: str) -> Path | None:
    """Return a complete file that no other user could have written, ``None`` if there is none."""
    found = _checked(name)
    return None if found is None else found[0]


def read(name: str) -> bytes | None:
    """Return what was kept under a name, ``None`` if it is not there."""
    found = _checked(name)
    return None if found is None else unsealed(found[1])


def _checked(name: str) -> tuple[Path, bytes] | None:
    """Return a file as `find`, and the content that was checked."""
    for place in _places:
        path = place / name
        try:
            with path.open("rb") as file:
                foreign = "" if _TRUSTS else foreign_writer(os.fstat(file.fileno()))
                if not foreign and is_sealed(content := file.read()):
                    return path, content
        except OSError:
            continue
        if foreign and MPI.COMM_WORLD.rank == 0:
            print(f"{path}: {foreign}: it is made again instead of loaded", file=sys.stderr, flush=True)
    return None


def keep(name: str, content: bytes) -> None:
    """Keep bytes under a name, if they can be written."""
    with suppress(NotWritten):
        publish(directory() / name, content)
