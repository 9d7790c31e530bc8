"""Methods that PETSc calls without keeping their objects: Python cannot collect a cycle through an object of PETSc."""

from collections.abc import Callable
from typing import Any
from weakref import WeakMethod


def weakly(method: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that calls a bound method, but does not keep the object alive that owns the PETSc object."""
    reference = WeakMethod(method)

    def call(*arguments: Any, **further: Any) -> Any:
        found = reference()
        return None if found is None else found(*arguments, **further)

    return call
