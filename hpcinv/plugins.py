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

GROUP = "hpcinv.plugins"


@cache
def load_installed() -> None:
    """Import what installed packages offer under the entry point group ``hpcinv.plugins``.

    Raises:
        JobError: one of them cannot be imported.
    """
    for entry in entry_points(group=GROUP):
        try:
            entry.load()
        except (Exception, SystemExit) as error:
            package = f" of the package '{entry.dist.name}'" if entry.dist else ""
            text = f"the installed plugin '{entry.name}'{package} cannot be imported: {type(error).__name__}: {error}"
            raise JobError([text]) from error


def load_file(path: Path) -> None:
    """Import a Python file, so that the laws and effects in it are registered; once, however often it is asked for.

    Raises:
        ValueError: with the reason and its line, whatever went wrong.
    """
    path = path.resolve()
    if not path.is_file():
        raise ValueError(f"there is no file '{path}'. Paths start from the directory of the job file")
    name = f"hpcinv_plugin_{sha256(str(path).encode()).hexdigest()[:16]}"
    if name in sys.modules:
        return
    spec = importlib.util.spec_from_file_location(name, path)
    if path.suffix != ".py" or spec is None or spec.loader is None:
        raise ValueError(f"'{path.name}' is no Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:  # whatever the user's own code raises
        del sys.modules[name]
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
        where = f" (line {lines[-1]})" if lines else ""  # a syntax error tells its line itself
        raise ValueError(f"'{path}' cannot be imported: {type(error).__name__}: {error}{where}") from error
