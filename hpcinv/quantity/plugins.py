"""Laws and effects from outside the package: installed ones, by entry points, and Python files that a job names."""

from __future__ import annotations

import importlib.util
import sys
import traceback
from functools import cache
from hashlib import sha256
from importlib.metadata import entry_points
from pathlib import Path

from hpcinv.errors import JobError
from hpcinv.files.names import is_file

GROUP = "hpcinv.plugins"
_PREFIX = "hpcinv_plugin_"  # of the names of modules that are files named by a job


@cache
def load_installed() -> None:
    """Import what installed packages offer under the entry point group ``hpcinv.plugins``.

    Raises:
        JobError: one of them cannot be imported.
    """
    for entry in entry_points(group=GROUP):
        try:
            entry.load()
        except BaseException as error:  # KeyboardInterrupt and GeneratorExit too
            package = f" of the package '{entry.dist.name}'" if entry.dist else ""
            text = f"the installed plugin '{entry.name}'{package} cannot be imported: {type(error).__name__}: {error}"
            raise JobError([text]) from error


def load_file(path: Path) -> None:
    """Import a Python file, so that the laws and effects in it are registered; once, however often it is asked for.

    Raises:
        ValueError: with the reason and its line, whatever went wrong.
    """
    if not is_file(path):
        raise ValueError(f"there is no file '{path}'. Paths start from the directory of the job file")
    path = path.resolve()
    name = f"{_PREFIX}{sha256(str(path).encode()).hexdigest()[:16]}"
    if name in sys.modules:
        return
    spec = importlib.util.spec_from_file_location(name, path)
    if path.suffix != ".py" or spec is None or spec.loader is None:
        raise ValueError(f"'{path.name}' is no Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException as error:  # whatever the user's own code raises, KeyboardInterrupt and GeneratorExit too
        del sys.modules[name]
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
        where = f" (line {lines[-1]})" if lines else ""  # a syntax error tells its line itself
        raise ValueError(f"'{path}' cannot be imported: {type(error).__name__}: {error}{where}") from error


def fault_of_plugin(error: BaseException) -> str | None:
    """What an error says that came out of a file loaded by `load_file`, with its line; None if it came from elsewhere.

    The file is the last one in the traceback.
    """
    frames = (
        (frame.f_code.co_filename, line)
        for frame, line in traceback.walk_tb(error.__traceback__)
        if frame.f_globals.get("__name__", "").startswith(_PREFIX)
    )
    *_, last = (None, *frames)
    return f"{last[0]}, line {last[1]}: {type(error).__name__}: {error}" if last else None
