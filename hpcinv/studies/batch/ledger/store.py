"""Store of sweeps and studies: a directory with ``store.json``, ``ledger/``, ``holders/``, and ``cases/`` of runs."""

import contextlib
import errno
import json
from collections.abc import Iterator
from pathlib import Path

from hpcinv.base.files.atomic import make_directory, publish
from hpcinv.base.files.names import check_output
from hpcinv.errors import OutputError

RECORDS, HEARTBEATS, RUNS = "ledger", "holders", "cases"
"""directories in a store"""
_MARK, _FORMAT = "store.json", "hpcinv store 1"
# Further entries of files need no other format, since earlier versions ignore them; another meaning of entries does.
_FULL = {errno.ENOSPC, errno.EDQUOT}
_GONE = {errno.ENOENT, errno.ENOTDIR, errno.ESTALE, errno.EIO, errno.ENOTCONN}


@contextlib.contextmanager
def as_output_error(path: Path) -> Iterator[None]:
    """Turn an error of the file system into an ``OutputError`` with a remedy."""
    try:
        yield
    except OSError as error:
        if error.errno in _FULL:
            remedy = "Free space there;"
        elif error.errno in _GONE:
            remedy = "Check whether its file system is still mounted;"
        else:
            remedy = "Make it writable, or choose another 'store';"
        kept = "finished cases are kept, and the same command continues."
        raise OutputError(f"{path}: {error.strerror or error}", f"{remedy} {kept}") from error


def open_store(path: Path) -> None:
    """Make a store, or check that it is one; any number of processes may do so at once.

    Raises:
        OutputError: it cannot be written, holds other files, or has another format.
    """
    mark = path / _MARK
    check_output(path)
    with as_output_error(path):
        path.mkdir(parents=True, exist_ok=True)
        if not mark.exists():
            others = [entry.name for entry in path.iterdir() if not entry.name.startswith(".")]
            if others and mark.name not in others:
                raise OutputError(f"{path}: holds files that are not of a store", "Choose another 'store'.")
            publish(mark, json.dumps({"format": _FORMAT}).encode())
        check_format(path)
        for directory in (RECORDS, HEARTBEATS):
            make_directory(path / directory)


def check_format(path: Path) -> None:
    """Raise ``OutputError`` if a store has another format; one that is not there has none."""
    mark = path / _MARK
    with as_output_error(mark):
        try:
            version = json.loads(mark.read_bytes())["format"]
        except (FileNotFoundError, NotADirectoryError):
            return
        except (ValueError, KeyError, TypeError):
            version = "unknown"
    if version != _FORMAT:
        raise OutputError(
            f"{mark}: the format is {version}, not {_FORMAT}",
            "Use the version of hpcinv that wrote it, or choose another 'store'.",
        )
