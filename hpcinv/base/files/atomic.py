"""Atomic writing of files: a file is complete as soon as it has its name.

`replace` replaces an existing file. `create` and `publish` return False if the file exists. They write the content to a
partial file, flush it to the disk, and make a hard link with the final name, which fails if the name exists. This is
atomic on local disks, NFS and parallel file systems. Where there are no hard links (FUSE, SMB), see the functions.
"""

import contextlib
import errno
import os
import secrets
import stat
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO

from hpcinv.errors import OutputError

_NO_HARD_LINKS = {errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EMLINK}


@contextlib.contextmanager
def output_errors(path: Path, advice: str = "") -> Iterator[None]:
    """Turn an ``OSError`` within the context into an ``OutputError``: the path cannot be written."""
    try:
        yield
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}", advice) from error


def create(path: Path, content: bytes) -> bool:
    """Create a file; return False if it exists.

    Without hard links creation is still exclusive, but a crash may leave an incomplete file: readers must expect that.

    Raises:
        OSError: the file cannot be written; nothing is left of it.
    """
    return _create(path, content, _write_in_place)


def publish(path: Path, content: bytes) -> bool:
    """Create a file as `create` does, durably: it survives a power failure.

    Without hard links the file is still complete, but the second of two simultaneous writers replaces the first.
    """
    first = _create(path, content, _move)
    flush_directory(path.parent)
    return first


def replace(path: Path, content: bytes, *, shared: bool = False) -> None:
    """Write a file, replacing an existing one; durable.

    The mode of an existing file stays. After a kill the file has its old or its new content, and a hidden
    ``.NAME.partial`` may be left, which the next call replaces. Only one process may write the file, unless it is
    shared. A device or a pipe is written to.

    Args:
        shared: several processes may write the file at the same time, through partial files of different names.

    Raises:
        OSError: the file cannot be written; it is unchanged.
    """
    if path.exists() and not path.is_file():  # a device or a pipe, which stays what it is
        with path.open("wb") as file:
            file.write(content)
        return
    own = f".{secrets.token_hex(8)}" if shared else ""
    partial = path.with_name(f".{path.name}{own}.partial")
    try:
        with _opened(partial, path) as file:
            _flushed(file, content)
        partial.replace(path)
    except OSError:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
        raise
    flush_directory(path.parent)


def write_output(path: Path, content: bytes, advice: str = "") -> None:
    """Write a file as `replace` does; raises ``OutputError`` if that fails."""
    with output_errors(path, advice):
        replace(path, content)


def make_directory(path: Path) -> None:
    """Make a directory, if it does not exist, in an existing one; durable."""
    if not path.is_dir():
        path.mkdir(exist_ok=True)
        flush_directory(path.parent)


def take_permissions(file: int | Path, path: Path) -> None:
    """Give a file, by its path or descriptor, the mode and the owner of the one that it replaces, if there is one."""
    with contextlib.suppress(OSError):  # none to replace, or a file system without them
        status = path.stat()
        if (status.st_uid, status.st_gid) != (os.geteuid(), os.getegid()):
            with contextlib.suppress(OSError):  # only root may
                os.chown(file, status.st_uid, status.st_gid)
        os.chmod(file, stat.S_IMODE(status.st_mode))  # noqa: PTH101  (of a descriptor)


def _opened(partial: Path, path: Path) -> IO[bytes]:
    """Open a file for writing that will replace another one, and that nobody else may read before that."""
    mode = 0o600 if path.exists() else 0o666
    file = os.fdopen(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, mode), "wb")
    take_permissions(file.fileno(), path)
    return file


def _flushed(file: IO[bytes], content: bytes) -> None:
    file.write(content)
    file.flush()
    os.fsync(file.fileno())


def flush_directory(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # some file systems cannot flush directories
            raise
    finally:
        os.close(descriptor)


def _create(path: Path, content: bytes, fallback: Callable[[Path, Path], None]) -> bool:
    partial = path.with_name(f".{path.name}.{secrets.token_hex(8)}.partial")
    try:
        with partial.open("xb") as file:
            _flushed(file, content)
        return _link(partial, path, fallback)
    finally:
        partial.unlink(missing_ok=True)


def _link(partial: Path, path: Path, fallback: Callable[[Path, Path], None]) -> bool:
    try:
        try:
            os.link(partial, path)
        except OSError as error:
            if error.errno not in _NO_HARD_LINKS:
                raise
            fallback(partial, path)
    except FileExistsError:
        with contextlib.suppress(FileNotFoundError):  # the file has been removed since
            return path.samefile(partial)  # NFS may repeat a request: then this process has created it
        return False
    except FileNotFoundError:
        path.parent.stat()  # raises if the directory is missing
        return False  # the first writer has removed partial files, with this process's
    return True


def _write_in_place(partial: Path, path: Path) -> None:
    content = partial.read_bytes()
    with path.open("xb") as file:
        try:
            _flushed(file, content)
        except OSError:
            path.unlink(missing_ok=True)
            raise


def _move(partial: Path, path: Path) -> None:
    if path.exists():
        raise FileExistsError
    partial.rename(path)
