"""Lock on the directory of a run: only one process may write to it.

The file ``.lock`` in the directory is locked by ``flock``, which the system releases at any end of the process, also
over NFS (as a lock on a range of bytes). It contains the identity of the holder, for messages. On file systems without
locks only this identity is used, and a process of another machine is assumed to be running.
"""

import fcntl
import json
import os
from datetime import UTC, datetime
from pathlib import Path

from hpcinv.base.parallel.processes import Identity
from hpcinv.errors import OutputError

NAME = ".lock"
_RESUME = "'resume' continues from its last checkpoint"


class DirectoryLock:
    """Lock that is held from construction until ``release``.

    Args:
        goes_on: what continues the work in the directory after its holder has ended, for messages.

    Raises:
        OutputError: another process has the lock, or its file cannot be written.
    """

    def __init__(self, directory: Path, goes_on: str = _RESUME) -> None:
        self._path, self._goes_on = directory / NAME, goes_on
        try:
            self._descriptor = self._take()
        except OSError as error:
            text = f"{self._path}: cannot be written: {error.strerror}"
            raise OutputError(text, "Make the directory writable, or choose another.") from error

    def _take(self) -> int:
        while True:
            descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o644)
            try:
                _lock(descriptor, self._path, self._goes_on)
                if _is_at(descriptor, self._path):  # otherwise the last holder has just removed the file
                    now = datetime.now(UTC).isoformat(timespec="seconds")
                    content = {"holder": Identity.current().as_json(), "since": now}
                    os.ftruncate(descriptor, 0)
                    os.pwrite(descriptor, json.dumps(content).encode(), 0)
                    return descriptor
            except BaseException:
                os.close(descriptor)
                raise
            os.close(descriptor)

    @property
    def is_in_place(self) -> bool:
        """True if the directory with the lock still has its path."""
        return _is_at(self._descriptor, self._path)

    def release(self) -> None:
        if self.is_in_place:
            self._path.unlink(missing_ok=True)
        os.close(self._descriptor)


def check_unlocked(directory: Path) -> None:
    """Raise ``OutputError`` if another process uses the directory; nothing is changed."""
    path = directory / NAME
    try:
        descriptor = os.open(path, os.O_RDWR)
    except OSError:  # no lock, or a fault that is reported when the lock is taken
        return
    try:
        _lock(descriptor, path)
    finally:
        os.close(descriptor)


def _lock(descriptor: int, path: Path, goes_on: str = _RESUME) -> None:
    """Lock an open file; raise ``OutputError`` if another process has, or on file systems without locks may have."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise _refusal(path, *_written(path), goes_on) from None
    except OSError:  # the file system has no locks
        holder, start = _written(path)
        if holder is not None and Identity.current().runs(holder) is not False:
            raise _refusal(path, holder, start, goes_on, only_told=True) from None


def _refusal(path: Path, holder: Identity | None, start: str, goes_on: str, *, only_told: bool = False) -> OutputError:
    who = f"{holder}, since {start}" if holder else "another process"
    advice = f"Wait until it has ended, or end it; then {goes_on}."
    if only_told:
        advice = f"{advice} If it is not running any more, which cannot be checked from here, remove {path}."
    return OutputError(f"{path.parent}: this directory is in use by another run: {who}", advice)


def _written(path: Path) -> tuple[Identity | None, str]:
    """Holder of the lock and start of the lock, as written in the file."""
    try:
        content = json.loads(path.read_bytes())
        return Identity.from_json(content["holder"]), str(content["since"])
    except (OSError, ValueError, KeyError, TypeError):
        return None, ""


def _is_at(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except OSError:
        return False
