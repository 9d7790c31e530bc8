"""Files of compiled kernels: sealed with a checksum, put in place whole, and compiled by one process at a time.

Nothing here depends on how the files were left: a process may be killed at any moment. It compiles in a directory of
its own, and the finished file is renamed into the cache, so that a reader finds a whole kernel or none. The lock on a
kernel is one of the operating system, which ends with the process that holds it. It only saves work: without it (some
network file systems have no locks), or when its owner takes too long, a kernel is compiled more than once, and the last
one is kept.
"""

from __future__ import annotations

import fcntl
import os
import socket
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from hashlib import sha256
from pathlib import Path

_LOCK = "kernels.lock"
_PARTIAL = ".partial"
_MARK = b"hpcinv kernel 1\n"
"""Ends a sealed file; the digits before it are the SHA-256 of all before them. The loader ignores what follows the
sections of a shared object."""
_LEFT_BEHIND = 3600.0
"""Age (s) from which a partial file belongs to no living process."""


class NotWritten(Exception):
    """A kernel could not be put into the cache, or the compiler had no place for its files."""


def make_directory(path: Path) -> None:
    """Make it and those above it, which no other user shall be able to write, whatever the file mode mask allows.

    Raises:
        OSError: it cannot be made.
    """
    if path.is_dir():
        return
    before = os.umask(0o022)
    os.umask(before | 0o022)
    try:
        path.mkdir(parents=True, exist_ok=True)
    finally:
        os.umask(before)


def is_sealed(content: bytes) -> bool:
    """Whether a file is a whole kernel of ours: neither truncated nor changed since it was published."""
    digest = sha256(content[: -len(_MARK) - sha256().digest_size]).digest()
    return content.endswith(digest + _MARK)


def publish(path: Path, content: bytes) -> None:
    """Put a shared object into the cache, at once and sealed, in place of whatever is there.

    Raises:
        NotWritten: with the reason.
    """
    partial = path.with_name(f".{path.name}.{socket.gethostname()}-{os.getpid()}{_PARTIAL}")
    try:
        make_directory(path.parent)
        with os.fdopen(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644), "wb") as file:
            file.write(content + sha256(content).digest() + _MARK)
            file.flush()
            os.fsync(file.fileno())  # else a node that fails may leave the name without the content
        partial.replace(path)
    except OSError as error:
        with suppress(OSError):
            partial.unlink()
        raise NotWritten(f"kernels cannot be written to {path.parent}: {error.strerror}") from error


@contextmanager
def locked(directory: Path, name: str, patience: float = 600.0, pause: float = 0.1) -> Iterator[None]:
    """Wait until no other process compiles the kernel ``name``, and let none begin; without locks go on at once.

    Args:
        patience: seconds after which one that does not end (it may be stopped) is no longer waited for.
        pause: seconds between two looks.
    """
    try:
        make_directory(directory)
        # Who can write into the directory can lock there. One file for all kernels, a byte of it for each.
        mode = 0o644 | (directory.stat().st_mode & 0o022)
        file = os.open(directory / _LOCK, os.O_RDWR | os.O_CREAT, mode)
    except OSError:
        yield
        return
    try:
        byte = int.from_bytes(sha256(name.encode()).digest()[:6])
        end = time.monotonic() + patience
        while time.monotonic() < end:
            try:
                fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, byte)
            except (BlockingIOError, PermissionError):  # as POSIX has it, either says that another process has it
                time.sleep(pause)
            except OSError:  # the file system has no locks
                break
            else:
                _remove_left_behind(directory)
                break
        yield
    finally:
        os.close(file)


def _remove_left_behind(directory: Path) -> None:
    """Remove what processes that were killed while publishing have left.

    The listing has a second use: a client of NFS that remembers a file as missing asks the server again.
    """
    for name in os.listdir(directory):  # noqa: PTH208  (no path for each of thousands of kernels)
        if name.endswith(_PARTIAL):
            with suppress(OSError):
                partial = directory / name
                if time.time() - partial.stat().st_mtime > _LEFT_BEHIND:
                    partial.unlink()


@contextmanager
def private_directory() -> Iterator[Path]:
    """A directory for the files of one compilation, away from the cache.

    Raises:
        NotWritten: with the reason.
    """
    try:
        made = tempfile.TemporaryDirectory(prefix="hpcinv-kernel-", ignore_cleanup_errors=True)
    except OSError as error:  # tempfile has looked for a place where a file can be written
        where = os.environ.get("TMPDIR") or "the directory for temporary files"
        raise NotWritten(f"the compiler cannot write to {where}: {error.strerror}") from error
    with made as path:
        yield Path(path)


def check_room(directory: Path) -> None:
    """Raise ``NotWritten`` if no file of 1 MiB fits into ``directory``: a compiler does not say why it fails."""
    probe = directory / "room"
    try:
        with probe.open("wb") as file:
            file.write(bytes(2**20))
            file.flush()
            os.fsync(file.fileno())
        probe.unlink()
    except OSError as error:
        raise NotWritten(f"the compiler cannot write to {directory}: {error.strerror}") from error
