"""Errors of the import of packages that hpcinv needs, as one message instead of a traceback."""

import gc
import os
import re
import sys
import traceback
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager

from hpcinv.errors import SystemPartMissing


@contextmanager
def imports_explained() -> Iterator[None]:
    """Context in which a package that is missing, or cannot be imported, becomes ``SystemPartMissing``.

    Errors of the import of modules of hpcinv and of Python itself are raised as they are.
    """
    try:
        yield
    except ImportError as error:
        if not (name := _package(error)):
            raise
        raise SystemPartMissing(
            f"{name} cannot be imported: {error}",
            f"Install it by: pip install 'hpcinv[{extra}]'"
            if (extra := extra_with(name))
            else f"Install hpcinv in {sys.executable}, or use its own Python (docs/start/installing.md).",
        ) from error


@contextmanager
def imports_at_start() -> Iterator[None]:
    """Context of imports at the start of the program: a missing package ends it with one message."""
    try:
        with imports_explained(), paused_collection():
            yield
    except SystemPartMissing as missing:
        if not is_other_rank():
            print(missing, file=sys.stderr)
        sys.exit(missing.exit_code)


@contextmanager
def paused_collection() -> Iterator[None]:
    """Context of imports: Python does not search memory for garbage in it, and never searches what they leave.

    A search of all modules at the exit takes so long that launchers kill the process in it.
    """
    gc.disable()
    try:
        yield
        gc.freeze()
    finally:
        gc.enable()


def is_other_rank() -> bool:
    """Return whether this process is a rank other than 0, from the launcher's environment (MPI is not imported)."""
    return any(os.environ.get(name, "0") != "0" for name in ("PMI_RANK", "PMIX_RANK", "OMPI_COMM_WORLD_RANK"))


def _package(error: ImportError) -> str:
    """Return the package whose import failed; empty if it is part of hpcinv or of Python, or not known."""
    name = error.name
    if not name:  # raised by the package: its module has the last frame outside Python's library
        names = [frame.f_globals.get("__name__", "") for frame, _ in traceback.walk_tb(error.__traceback__)]
        name = next((module for module in reversed(names) if _top(module) not in sys.stdlib_module_names), "")
    top = _top(name)
    return "" if top in {"", "__main__", "hpcinv"} or top in sys.stdlib_module_names else top


def extra_with(package: str) -> str:
    """Return the smallest extra of hpcinv that installs a package; empty if none does, or hpcinv is not installed."""
    from importlib import metadata  # takes as long as a twentieth of the check of a job

    name = {"pxr": "usd-core", "vtkmodules": "vtk"}.get(package, package).lower()
    try:
        requirements = metadata.requires("hpcinv") or []
    except metadata.PackageNotFoundError:
        return ""
    extras = defaultdict[str, set[str]](set)
    for line in requirements:
        if match := re.fullmatch(r"([\w-]+)\b[^;]*;\s*extra\s*==\s*['\"]([\w-]+)['\"]", line):
            extras[match[2]].add(match[1].lower())
    return min((extra for extra in extras if name in extras[extra]), key=lambda extra: len(extras[extra]), default="")


def _top(name: str) -> str:
    return name.partition(".")[0]


def is_text(argument: str) -> bool:
    """Return whether an argument is UTF-8. Other bytes are surrogates; libraries fail with them."""
    try:
        argument.encode()
    except UnicodeEncodeError:
        return False
    return True
