"""Store of sweeps and studies: a directory with ``store.json``, ``ledger/``, ``holders/``, and ``cases/`` of runs."""

import contextlib
import errno
import json
from collections.abc import Iterator
from pathlib import Path

from hpcinv.base.files.atomic import make_directory, publish, replace
from hpcinv.base.files.names import check_output
from hpcinv.errors import OutputError

LEDGER, HEARTBEATS, RUNS = "ledger", "holders", "cases"
"""directories in a store"""
LOG, RECORDS = f"{LEDGER}/log", f"{LEDGER}/records"
_MARK, _FORMAT, _EARLIER = "store.json", "hpcinv store 2", "hpcinv store 1"
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
            publish(mark, _mark())
        if check_format(path) == _EARLIER:
            replace(mark, _mark(), shared=True)  # earlier versions would not see what is written from now on
        for directory in (LEDGER, LOG, RECORDS, HEARTBEATS):
            make_directory(path / directory)


def _mark() -> bytes:
    return json.dumps({"format": _FORMAT}).encode()


def check_format(path: Path) -> str:
    """Return the format of a store; raises ``OutputError`` if it cannot be read. One that is not there has none."""
    mark = path / _MARK
    with as_output_error(mark):
        try:
            version = json.loads(mark.read_bytes())["format"]
        except (FileNotFoundError, NotADirectoryError):
            return ""
        except (ValueError, KeyError, TypeError):
            version = "unknown"
    if version not in (_FORMAT, _EARLIER):
        raise OutputError(
            f"{mark}: the format is {version}, not {_FORMAT}",
            "Use the version of hpcinv that wrote it, or choose another 'store'.",
        )
    return str(version)
