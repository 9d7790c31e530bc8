"""Laws and effects from outside the package: installed packages (entry points) and Python files named by a job."""

import importlib.util
import sys
import traceback
from functools import cache
from hashlib import sha256
from importlib.metadata import entry_points
from pathlib import Path

from hpcinv.errors import JobError, described
from hpcinv.files.names import is_file

GROUP = "hpcinv.plugins"
_PREFIX = "hpcinv_plugin_"  # of module names of files named by a job


@cache
def load_installed() -> None:
    """Import all entry points of the group ``hpcinv.plugins``.

    Raises:
        JobError: one of them cannot be imported.
    """
    for entry in entry_points(group=GROUP):
        try:
            entry.load()
        except BaseException as error:  # KeyboardInterrupt and GeneratorExit too
            package = f" of the package '{entry.dist.name}'" if entry.dist else ""
            text = f"the installed plugin '{entry.name}'{package} cannot be imported: {described(error)}"
            raise JobError(text) from error


def load_file(path: Path) -> None:
    """Import a Python file, which registers its laws and effects; a file is imported only once.

    Raises:
        ValueError: the import failed; with the reason and the line.
    """
    if not is_file(path):
        raise ValueError(f"there is no file '{path}'. Paths start from the directory of the job file")
    path = path.resolve()
    name = f"{_PREFIX}{sha256(str(path).encode()).hexdigest()[:16]}"
    if name in sys.modules:
        return
    spec = importlib.util.spec_from_file_location(name, path)
    if path.suffix != ".py" or spec is None or spec.loader is None:
        raise ValueError(f"'{path.name}' is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException as error:  # user code may raise anything, KeyboardInterrupt and GeneratorExit too
        del sys.modules[name]
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
        where = f" (line {lines[-1]})" if lines else ""  # a syntax error contains its line
        raise ValueError(f"'{path}' cannot be imported: {described(error)}{where}") from error


def fault_of_plugin(error: BaseException) -> str | None:
    """Message of an error raised in a file loaded by `load_file`, with file and line; None for other errors."""
    frames = (
        (frame.f_code.co_filename, line)
        for frame, line in traceback.walk_tb(error.__traceback__)
        if frame.f_globals.get("__name__", "").startswith(_PREFIX)
    )
    *_, last = (None, *frames)
    return f"{last[0]}, line {last[1]}: {described(error)}" if last else None
