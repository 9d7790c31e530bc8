"""Jobs as differentiable functions of numbers and fields, for programs that learn and optimise."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def needing(package: str, title: str, installed_as: str = "", user: str = "") -> Iterator[None]:
    """Context of the import of a package, which names the remedy if it is not installed.

    Args:
        title: name of the package in text.
        installed_as: what to give to pip, by default the package.
        user: module that needs it, by default ``hpcinv.PACKAGE``.

    Raises:
        ModuleNotFoundError: the package is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != package:
            raise
        text = f"{user or f'hpcinv.{package}'} needs {title}, which is not installed. Install it by: pip install"
        raise ModuleNotFoundError(f"{text} {installed_as or package}", name=package) from None
