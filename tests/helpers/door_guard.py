"""The guard of the door: only `DiscreteModel.put` and `System` write mesh, unknowns, parameters, supports and contacts.

Elsewhere in the package their arrays are read-only, and PETSc's vector of the unknowns is a copy: a write raises
or has no effect. Contacts change only in calls of these two.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, wraps
from importlib import import_module
from types import FrameType
from typing import Any

from dolfinx import fem, la, mesh

WRITERS = {
    "hpcinv.model.discrete_model.DiscreteModel": (
        *("__init__", "put", "renew", "put_load", "put_fields", "put_displacement", "put_unknowns"),
        *("put_contacts", "unload", "impose_supports", "weak_form"),
    ),
    "hpcinv.model.assembly.system.System": (
        *("set_load", "set_state", "set_values", "begin_path", "begin_line", "begin_unloaded", "end_path"),
        *("lift_rates", "lift_path_rates", "lift_region", "move_region", "set_numbers"),
        *("begin_contacts", "locate_contacts", "update_contacts", "halve_contact_update"),
        *("begin_contact_step", "end_contact_step", "resume_contacts"),
    ),
}
"""Classes with the methods that may write: a state is put, and a solver's system moves it."""
CALLED_INSIDE = {
    "hpcinv.model.contacts.Contacts": (
        *("begin", "reset", "restore", "locate", "update", "halve_update"),
        *("begin_step", "end_step", "resume"),
    ),
}
"""Classes with methods that change a model, and that only these may call."""
SETTERS = {
    "hpcinv.mesh.body.Body": ("move_to",),
    "hpcinv.model.spaces.Unknowns": ("set_displacement", "set_pressure"),
}
"""Classes with methods that write for the others, and for tests."""
LENDERS = {
    "hpcinv.mesh.body.Body": ("at",),
    "hpcinv.model.parameters.Parameters": ("moved",),
    "hpcinv.model.obstacle_contact.ObstacleContact": ("moved",),
}
"""Classes with the contexts that write for their time, and restore what was there."""

_inside = 0
_is_on = False


@contextmanager
def _writing() -> Iterator[None]:
    global _inside
    _inside += 1
    try:
        yield
    finally:
        _inside -= 1


class _Lending:
    def __init__(self, context: Any) -> None:
        self._context = context

    def __enter__(self) -> Any:
        with _writing():
            return self._context.__enter__()

    def __exit__(self, *error: object) -> Any:
        with _writing():
            return self._context.__exit__(*error)


def _may_write(function: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(function)
    def write(*args: Any, **kwargs: Any) -> Any:
        with _writing():
            return function(*args, **kwargs)

    return write


def _may_write_for_tests(function: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(function)
    def write(*args: Any) -> Any:
        if _is_of_the_package(sys._getframe(1)):
            return function(*args)
        with _writing():
            return function(*args)

    return write


def _is_of_the_package(frame: FrameType) -> bool:
    return str(frame.f_globals["__name__"]).startswith("hpcinv.")


def _only_inside(function: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        if _is_on and not _inside and _is_of_the_package(sys._getframe(1)):
            raise ValueError(f"{function.__qualname__} is called around the door")
        return function(*args, **kwargs)

    return call


def _may_lend(function: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(function)
    def lend(*args: Any, **kwargs: Any) -> Any:
        return _Lending(function(*args, **kwargs))

    return lend


def _after(function: Callable[..., Any], then: Callable[[Any], None]) -> Callable[..., Any]:
    @wraps(function)
    def call(self: Any, *args: Any, **kwargs: Any) -> None:
        with _writing():
            function(self, *args, **kwargs)
        then(self)

    return call


def _is_protected(owner: Any) -> bool:
    """Whether the package asks for what is guarded, outside of the listed methods; tests may write."""
    if not _is_on or _inside or "_is_guarded" not in owner.__dict__:
        return False
    return _is_of_the_package(sys._getframe(2))


def _guarded(read: Any) -> Any:
    def get(self: Any) -> Any:
        array = read(self)
        if _is_protected(self):
            array = array.view()
            array.flags.writeable = False
        return array

    return get


def _copied(read: Any) -> Any:
    def get(self: Any) -> Any:
        vector = read(self)
        return vector.copy() if _is_protected(self) else vector

    return get


def _class(path: str) -> Any:
    module, _, name = path.rpartition(".")
    return getattr(import_module(module), name)


@contextmanager
def guarded() -> Iterator[None]:
    """Context in which nothing but the listed methods can write."""
    global _is_on
    _install()
    _is_on = True
    try:
        yield
    finally:
        _is_on = False


@cache
def _install() -> None:
    wrappers = (
        (WRITERS, _may_write),
        (SETTERS, _may_write_for_tests),
        (LENDERS, _may_lend),
        (CALLED_INSIDE, _only_inside),
    )
    for table, wrapped in wrappers:
        for path, names in table.items():
            kind = _class(path)
            for name in names:
                setattr(kind, name, wrapped(vars(kind)[name]))
    body, unknowns, parameters, supports = (
        _class(f"hpcinv.{path}")
        for path in (
            "mesh.body.Body",
            "model.spaces.Unknowns",
            "model.parameters.Parameters",
            "model.supports.Supports",
        )
    )

    def mark(*owners: Any) -> None:
        for owner in owners:
            owner._is_guarded = True

    body.__post_init__ = _after(body.__post_init__, lambda self: mark(self.mesh.geometry))
    unknowns.__init__ = _after(unknowns.__init__, lambda self: mark(self.state.x))
    parameters.__init__ = _after(parameters.__init__, lambda self: mark(self.constant))
    supports.__init__ = _after(supports.__init__, lambda self: mark(*(entry.now.x for entry in self.prescribed)))
    mesh.Geometry.x = property(_guarded(mesh.Geometry.x.fget))
    la.Vector.array = property(_guarded(la.Vector.array.fget))
    la.Vector.petsc_vec = property(_copied(la.Vector.petsc_vec.fget))
    fem.Constant.value = property(_guarded(fem.Constant.value.fget), fem.Constant.value.fset)
