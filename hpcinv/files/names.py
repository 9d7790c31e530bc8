"""Checks of file names from users, without errors for names that no file can have."""

from pathlib import Path

from hpcinv.errors import OutputError


def exists(path: Path) -> bool:
    """Return whether a file or directory exists and is accessible."""
    try:
        path.stat()
    except (OSError, ValueError):  # too long, or with a null character
        return False
    return True


def is_file(path: Path) -> bool:
    """Return whether a regular file exists and is accessible."""
    return exists(path) and path.is_file()


def check_output(path: Path) -> None:
    """Raise ``OutputError`` if a directory cannot have this name or is not accessible."""
    try:
        str(path).encode()  # required by the libraries that write results
        path.stat()
    except (FileNotFoundError, NotADirectoryError):  # the latter is reported where the directory is made
        return
    except UnicodeEncodeError:
        raise OutputError(f"{path}: the name is not UTF-8", "Choose another --output.") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OutputError(f"{path}: cannot be used: {reason}", "Choose another --output.") from None
