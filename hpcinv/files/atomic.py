"""Files that appear under their name whole or not at all.

`replace` takes the place of what has the name. With `create` and `publish` a file appears only once: who comes second
is told so. For these the content is written beside and flushed to the disk; then a hard link gives it the name, which
fails if the name is taken. That is atomic on local disks, NFS and parallel file systems. Some file systems (FUSE, SMB)
have no hard links: `create` and `publish` say what they do there.
"""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal

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
    """Create a file, and tell whether it was us who did.

    Without hard links it is exclusive all the same, but a crash may leave it torn: only for what may be so.

    Raises:
        OSError: it cannot be written; then nothing is left of it.
    """
    return _create(path, content, _write_in_place)


def publish(path: Path, content: bytes) -> bool:
    """As `create`, and it survives a power failure.

    Without hard links it is whole all the same, but of two within the same instant the second replaces the first.
    """
    first = _create(path, content, _move)
    _flush_directory(path.parent)
    return first


def replace(path: Path, content: bytes, *, shared: bool = False) -> None:
    """Write a file in place of what has its name; it survives a power failure.

    A kill leaves the file as it was before, or as it is now, and perhaps a hidden ``.NAME.partial`` beside it, which
    the next call replaces: of one file only one process may be the writer, unless it is shared.

    Args:
        shared: several processes may write the file at once, each through a partial file with a name of its own.

    Raises:
        OSError: it cannot be written; the file is then as it was.
    """
    own = f".{secrets.token_hex(8)}" if shared else ""
    partial = path.with_name(f".{path.name}{own}.partial")
    try:
        _write(partial, "wb", content)
        partial.replace(path)
    except OSError:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
        raise
    _flush_directory(path.parent)


def make_directory(path: Path) -> None:
    """Make a directory if it is not there, in one that is; it survives a power failure."""
    if not path.is_dir():
        path.mkdir(exist_ok=True)
        _flush_directory(path.parent)


def _write(path: Path, mode: Literal["wb", "xb"], content: bytes) -> None:
    with path.open(mode) as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def _flush_directory(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # some file systems flush no directories
            raise
    finally:
        os.close(descriptor)


def _create(path: Path, content: bytes, without_links: Callable[[Path, Path], None]) -> bool:
    partial = path.with_name(f".{path.name}.{secrets.token_hex(8)}.partial")
    try:
        _write(partial, "xb", content)
        return _link(partial, path, without_links)
    finally:
        partial.unlink(missing_ok=True)


def _link(partial: Path, path: Path, without_links: Callable[[Path, Path], None]) -> bool:
    try:
        try:
            os.link(partial, path)
        except OSError as error:
            if error.errno not in _NO_HARD_LINKS:
                raise
            without_links(partial, path)
    except FileExistsError:
        with contextlib.suppress(FileNotFoundError):  # it was taken, and has gone since
            return path.samefile(partial)  # NFS repeats a request whose answer was lost: then it was us
        return False
    except FileNotFoundError:
        path.parent.stat()  # raises if the directory is what is missing
        return False  # who was first has tidied up meanwhile, our partial file too
    return True


def _write_in_place(partial: Path, path: Path) -> None:
    content = partial.read_bytes()
    with path.open("xb") as file:
        try:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        except OSError:
            path.unlink(missing_ok=True)
            raise


def _move(partial: Path, path: Path) -> None:
    if path.exists():
        raise FileExistsError
    partial.rename(path)
