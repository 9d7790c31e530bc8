"""Checks of file names from users, without errors for names that no file can have."""

import os.path
import re
from pathlib import Path
from typing import Annotated

from hpcinv.errors import OutputError

exists, is_file, is_directory = os.path.exists, os.path.isfile, os.path.isdir
"""False, and no error as from methods of a path, for names that are too long or have a null character"""


class NamesFile:
    """Mark of a field of a job with paths of files: keys of results have their content instead of the path."""


FilePath = Annotated[str, NamesFile()]
"""Path of a file, relative to the job file."""


def escaped_line(text: str) -> str:
    """Return a text from a user with escapes for what ends a line or is not printable, for comments in files."""
    return "".join(c if c.isprintable() else _escape(c) for c in text)


def yaml_text(text: str) -> str:
    """Return a text from a user as a scalar of YAML that is read as this text again, whatever is in it."""
    if re.fullmatch(_PLAIN, text, re.ASCII) and text.lower() not in _WORDS:
        return text
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped_line(escaped)}"'


_PLAIN = r"[A-Za-z_/][\w./-]*|\.{1,2}/[\w./-]*"
_WORDS = ("true", "false", "yes", "no", "on", "off", "null", "y", "n")
"""words that YAML does not read as text"""


def _escape(character: str) -> str:
    code = ord(character)
    if code < 0x100:
        return f"\\x{code:02x}"
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


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


def check_directory_of(path: Path) -> None:
    """Raise ``OutputError`` if there is no directory for a file to write."""
    if not is_directory(path.parent):
        text = f"{path}: cannot be written: there is not a directory {path.parent}"
        raise OutputError(text, "Make it first, or name another one.")
