"""Laws and effects from outside the package: installed packages (entry points) and Python files named by a job."""

import importlib.util
import os
import sys
import traceback
from contextlib import suppress
from functools import cache
from hashlib import sha256
from importlib.machinery import PathFinder
from pathlib import Path

from hpcinv.base.files.inputs import changed_inputs, digest_of, recorded_inputs
from hpcinv.base.files.names import is_file
from hpcinv.base.reading.door import trusted
from hpcinv.errors import JobError, described

GROUP = "hpcinv.plugins"
_PREFIX = "hpcinv_plugin_"  # of module names of files named by a job
_DIGEST = "__digest_at_import__"
_inputs: dict[str, dict[str, str]] = {}
"""files that plugins have read, by the names of their modules"""


@cache
def load_installed() -> None:
    """Import all entry points of the group ``hpcinv.plugins``.

    Raises:
        JobError: one of them cannot be imported.
    """
    if not _are_possible():
        return
    from importlib.metadata import entry_points  # whose search takes a tenth of the check of a job

    for entry in entry_points(group=GROUP):
        try:
            entry.load()
        except BaseException as error:  # KeyboardInterrupt and GeneratorExit too
            package = f" of the package '{entry.dist.name}'" if entry.dist else ""
            text = f"the installed plugin '{entry.name}'{package} cannot be imported: {described(error)}"
            raise JobError(text) from error


def _are_possible() -> bool:
    """Return whether an installed package may name the group; false only if all say what they have, and none does."""
    if any(hasattr(finder, "find_distributions") for finder in sys.meta_path if finder is not PathFinder):
        return True
    for place in map(Path, sys.path):
        if not place.is_dir():
            if place.exists():
                return True  # an archive
            continue
        for entry in os.scandir(place):
            if entry.name.endswith(".dist-info"):
                with suppress(FileNotFoundError, NotADirectoryError):
                    if GROUP.encode() in (Path(entry.path) / "entry_points.txt").read_bytes():
                        return True
            elif entry.name.endswith((".egg-info", ".egg")):
                return True
    return False


def load_file(path: Path) -> None:
    """Import a Python file, which registers its laws and effects; a file is imported only once.

    Relative paths in it start from its directory.

    Raises:
        ValueError: the import failed; with the reason and the line. Or the file has changed since it was imported.
    """
    if not is_file(path):
        raise ValueError(f"there is no file '{path}'. Paths start from the directory of the job file")
    path = path.resolve()
    name = _name_of(path)
    if name in sys.modules:
        is_changed = digest_of(path) != sys.modules[name].__dict__[_DIGEST]
        if files := [path.name] * is_changed or changed_inputs(_inputs[name], path.parent):
            raise ValueError(
                f"'{path.parent / files[0]}' has changed since this process imported it; start Python again to use it"
            )
        return
    spec = importlib.util.spec_from_file_location(name, trusted(path))
    if path.suffix != ".py" or spec is None or spec.loader is None:
        raise ValueError(f"'{path.name}' is not a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    module.__dict__[_DIGEST] = digest_of(path)
    try:
        with recorded_inputs(path) as inputs:
            spec.loader.exec_module(module)
        _inputs[name] = inputs
    except BaseException as error:  # user code may raise anything, KeyboardInterrupt and GeneratorExit too
        del sys.modules[name]
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
        where = f" (line {lines[-1]})" if lines else ""  # a syntax error contains its line
        raise ValueError(f"'{path}' cannot be imported: {described(error)}{where}") from error


def inputs_of(path: Path) -> dict[str, str]:
    """Return the digests of the files that a plugin read when this process imported it, by their paths."""
    return _inputs.get(_name_of(path.resolve()), {})


def _name_of(path: Path) -> str:
    return f"{_PREFIX}{sha256(str(path).encode()).hexdigest()[:16]}"


def fault_of_plugin(error: BaseException) -> str | None:
    """Message of an error raised in a file loaded by `load_file`, with file and line; None for other errors."""
    frames = (
        (frame.f_code.co_filename, line)
        for frame, line in traceback.walk_tb(error.__traceback__)
        if frame.f_globals.get("__name__", "").startswith(_PREFIX)
    )
    *_, last = (None, *frames)
    return f"{last[0]}, line {last[1]}: {described(error)}" if last else None
