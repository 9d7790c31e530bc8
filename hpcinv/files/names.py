"""Questions about files whose names a user has typed: a name that no file can have is one of no file, not an error."""

from __future__ import annotations

from pathlib import Path

from hpcinv.errors import OutputError


def exists(path: Path) -> bool:
    """Whether there is such a file or directory, and it can be reached."""
    try:
        path.stat()
    except (OSError, ValueError):  # it is too long, or holds a null character
        return False
    return True


def is_file(path: Path) -> bool:
    """Whether there is such a regular file, and it can be reached."""
    return exists(path) and path.is_file()


def check_output(path: Path) -> None:
    """Raise ``OutputError`` unless a directory can have this name and be looked into."""
    try:
        str(path).encode()  # the libraries that write results know no other names
        path.stat()
    except (FileNotFoundError, NotADirectoryError):  # the latter is told where the directory is made
        return
    except UnicodeEncodeError:
        raise OutputError(f"{path}: the name is not UTF-8", "Choose another --output.") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OutputError(f"{path}: cannot be used: {reason}", "Choose another --output.") from None
