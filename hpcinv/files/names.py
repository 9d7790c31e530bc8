"""Checks of file names from users, without errors for names that no file can have."""

import os.path
from pathlib import Path

from hpcinv.errors import OutputError

exists, is_file = os.path.exists, os.path.isfile
"""False, and no error as from methods of a path, for names that are too long or have a null character"""


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
