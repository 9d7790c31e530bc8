"""Files of the cache: with a checksum, published atomically, and C code compiled by one process at a time.

A process may be killed at any moment. It compiles in a private directory, and the finished file is renamed into the
cache, so that readers find a complete file or none. The lock on a file is released by the operating system when the
process ends. It only saves work: without locks (on some network file systems), or if the owner takes too long, code
is compiled more than once, and the last file is kept.
"""

import fcntl
import os
import socket
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from hashlib import sha256
from pathlib import Path

_LOCK = "cache.lock"
_PARTIAL = ".partial"
_MARK = b"hpcinv kernel 1\n"
"""End of a sealed file, after the SHA-256 of the content. The loader ignores data after the sections of a shared
object."""
_LEFT_BEHIND = 3600.0
"""Age (s) after which the process of a partial file is assumed to have ended."""


class NotWritten(Exception):
    """A file cannot be written to the cache, or the compiler cannot write its files."""


def make_directory(path: Path) -> None:
    """Make a directory and its parents, writable only for this user, whatever the file mode mask is.

    Raises:
        OSError: it cannot be made.
    """
    if path.is_dir():
        return
    kept_mask = os.umask(0o022)
    os.umask(kept_mask | 0o022)
    try:
        path.mkdir(parents=True, exist_ok=True)
    finally:
        os.umask(kept_mask)


def unsealed(content: bytes) -> bytes:
    """Content that was published, from the content of its file."""
    return content[: -len(_MARK) - sha256().digest_size]


def is_sealed(content: bytes) -> bool:
    """Return whether the content is a complete file, unchanged since it was published."""
    return content.endswith(sha256(unsealed(content)).digest() + _MARK)


def publish(path: Path, content: bytes) -> None:
    """Write a file to the cache, atomically and with its checksum, replacing an existing file.

    Raises:
        NotWritten: with the reason.
    """
    partial = path.with_name(f".{path.name}.{socket.gethostname()}-{os.getpid()}{_PARTIAL}")
    try:
        make_directory(path.parent)
        with os.fdopen(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644), "wb") as file:
            file.write(content + sha256(content).digest() + _MARK)
            file.flush()
            os.fsync(file.fileno())  # otherwise a failure of the node may leave an empty file
        partial.replace(path)
    except OSError as error:
        with suppress(OSError):
            partial.unlink()
        raise NotWritten(f"the cache {path.parent} cannot be written: {error.strerror}") from error


@contextmanager
def locked(directory: Path, name: str, patience: float = 600.0) -> Iterator[None]:
    """Context in which no other process makes the file ``name``; without file locks there is no waiting.

    Args:
        patience: longest time (s) to wait for another process, which may be stopped.
    """
    try:
        make_directory(directory)
        # Everyone who can write into the directory can lock. One lock file for all, with one byte for each.
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
            except (BlockingIOError, PermissionError):  # by POSIX, either means that another process has the lock
                time.sleep(0.02)
            except OSError:  # the file system has no locks
                break
            else:
                _remove_left_behind(directory)
                break
        yield
    finally:
        os.close(file)


def _remove_left_behind(directory: Path) -> None:
    """Remove partial files of processes that were killed.

    Listing the directory also makes NFS clients ask the server again for files that they have cached as missing.
    """
    for name in os.listdir(directory):  # noqa: PTH208  (no path for each of thousands of files)
        if name.endswith(_PARTIAL):
            with suppress(OSError):
                partial = directory / name
                if time.time() - partial.stat().st_mtime > _LEFT_BEHIND:
                    partial.unlink()


@contextmanager
def private_directory() -> Iterator[Path]:
    """Context with a temporary directory for the files of one compilation, outside the cache.

    Raises:
        NotWritten: with the reason.
    """
    try:
        made = tempfile.TemporaryDirectory(prefix="hpcinv-code-", ignore_cleanup_errors=True)
    except OSError as error:  # tempfile has tried all its directories
        where = os.environ.get("TMPDIR") or "the directory for temporary files"
        raise NotWritten(f"the compiler cannot write to {where}: {error.strerror}") from error
    with made as path:
        yield Path(path)


def check_room(directory: Path) -> None:
    """Raise ``NotWritten`` if no file of 1 MiB fits into ``directory``: compilers do not report the reason."""
    probe = directory / "room"
    try:
        with probe.open("wb") as file:
            file.write(bytes(2**20))
            file.flush()
            os.fsync(file.fileno())
        probe.unlink()
    except OSError as error:
        raise NotWritten(f"the compiler cannot write to {directory}: {error.strerror}") from error
