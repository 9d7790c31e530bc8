"""Laws and effects from outside the package: installed ones, by entry points, and Python files that a job names."""

from __future__ import annotations

import importlib.util
import sys
from functools import cache
from hashlib import sha256
from importlib.metadata import entry_points
from pathlib import Path

GROUP = "hpcinv.plugins"


@cache
def load_installed() -> None:
    """Import what installed packages offer under the entry point group ``hpcinv.plugins``."""
    for entry in entry_points(group=GROUP):
        entry.load()


def load_file(path: Path) -> None:
    """Import a Python file, so that the laws and effects in it are registered; once, however often it is asked for.

    Raises:
        ValueError: with the reason and its line, whatever went wrong.
    """
    path = path.resolve()
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
        raise ValueError(f"'{path}' cannot be imported: {type(error).__name__}: {error}") from error
