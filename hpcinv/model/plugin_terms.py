"""Terms of plugins that programs do not have: FFCx compiles them, and messages name their file and line."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from hpcinv.physics.points.ffcx_fallback import term_places
from hpcinv.physics.points.kernels import missing_in_programs


def noted[T](where: str, method: Callable[..., Any], term: T) -> T:
    """Return a term; note its place if it is of a plugin, and has what programs do not have.

    Args:
        where: place of the law or effect in the job.
        method: of the law or effect, which made the term.
    """
    owner = type(getattr(method, "__self__", None))
    if term is None or owner.__module__.partition(".")[0] == "hpcinv":
        return term
    if missing := missing_in_programs(term):
        is_inherited = method.__module__.partition(".")[0] == "hpcinv"
        source: Any = owner if is_inherited else method
        term_places[missing] = f"{where}: {inspect.getsourcefile(owner)}, line {_line_of(source, missing)}"
    return term


def _line_of(source: Any, missing: str) -> int:
    """Return the line of a class or method that names what is missing, or its first one."""
    lines, first = inspect.getsourcelines(source)
    words = [word.lower() for word in missing.replace("'", " ").split() if word[:1].isupper()]
    words += ["grad(grad(", "grad("] if "derivatives" in missing else []
    found = (n for word in words for n, line in enumerate(lines) if word in line.replace("_", "").lower())
    return first + next(found, 0)
