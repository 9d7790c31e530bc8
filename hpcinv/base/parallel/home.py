"""The home directory, without which ADIOS2 ends the process and DOLFINx and PETSc fail in words of their own."""

import os
import pwd
import tempfile
from collections.abc import MutableMapping
from pathlib import Path

from hpcinv.base.parallel.ownership import foreign_writer
from hpcinv.errors import OutputError

_DIRECTORY = os.R_OK | os.X_OK
_ADVICE = "Set HOME to a directory of your own."


def provide_home(environment: MutableMapping[str, str] = os.environ) -> None:
    """Set HOME, unless it is a directory, to the home of the user, or to a private directory for temporary files.

    Raises:
        OutputError: there is neither, or another user could have written the latter.
    """
    if not _is_usable(environment.get("HOME", "")):
        own = _home_of_user()
        environment["HOME"] = own if _is_usable(own) else str(_private_directory())


def require_working_directory() -> None:
    """Raise ``OutputError`` if the working directory was removed or cannot be read: PETSc and DOLFINx ask for it."""
    try:
        os.getcwd()  # noqa: PTH109  (Path.cwd() is the same)
    except OSError as error:
        raise OutputError(
            f"the working directory cannot be used: {error.strerror}", "Change to one that exists, and start again."
        ) from None


def _is_usable(directory: str) -> bool:
    return Path(directory).is_absolute() and os.path.isdir(directory) and os.access(directory, _DIRECTORY)  # noqa: PTH112


def _home_of_user() -> str:
    """Home directory by the user database; "" if the user is not in it, as in containers."""
    try:
        return pwd.getpwuid(os.geteuid()).pw_dir
    except KeyError:
        return ""


def _private_directory() -> Path:
    """Make a directory for this user, the same in each run, so that the cache in it serves later ones."""
    try:
        path = Path(tempfile.gettempdir()) / f"hpcinv-home-{os.geteuid()}"
        path.mkdir(mode=0o700, exist_ok=True)
        status = path.lstat()
    except OSError as error:
        raise OutputError(f"HOME is not a directory, and none can be made: {error}", _ADVICE) from None
    reason = "is a link" if path.is_symlink() else foreign_writer(status)
    if reason:
        raise OutputError(f"HOME is not a directory, and {path} {reason}", _ADVICE)
    return path
