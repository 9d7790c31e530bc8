"""Calls of PETSc without the lock of Python, and methods that PETSc calls.

Meanwhile the thread of `hpcinv.base.parallel.signals` can end a process that is asked to stop. Functions in Python take
the lock themselves where PETSc calls them. Cyclic garbage is not collected: another thread that collected it would
destroy objects of PETSc and communicators of MPI, neither of which allow two threads at a time.

PETSc calls methods without keeping their objects: Python cannot collect a cycle through an object of PETSc.
"""

import ctypes
import gc
from collections.abc import Callable
from functools import cache
from typing import Any
from weakref import WeakMethod

from petsc4py import PETSc


def set_up(solver: PETSc.KSP | PETSc.PC) -> None:
    """Set up a solver, such as by a factorization; collective."""
    name = "KSPSetUp" if isinstance(solver, PETSc.KSP) else "PCSetUp"
    if not _succeeds(name, solver):
        solver.setUp()


def solve(ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
    """Solve ``A x = b``; collective."""
    if not _succeeds("KSPSolve", ksp, b, x):
        ksp.solve(b, x)


def _succeeds(name: str, *objects: PETSc.Object) -> bool:
    """Call a function of PETSc; return whether it succeeds. petsc4py repeats a failed call, and raises its error."""
    if (function := petsc_function(name)) is None:
        return False
    collects = gc.isenabled()
    try:
        gc.disable()
        return bool(function(*(ctypes.c_void_p(one.handle) for one in objects)) == 0)
    except SystemError:  # an exception within a function in Python
        return False
    finally:
        if collects:
            gc.enable()


@cache
def petsc_function(name: str) -> Any:
    """Return a function of PETSc, also one that petsc4py does not have; ``None`` if PETSc has none of this name."""
    try:
        return getattr(ctypes.CDLL(PETSc.__file__), name, None)
    except OSError:
        return None


def weakly(method: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that calls a bound method, but does not keep the object alive that owns the PETSc object."""
    reference = WeakMethod(method)

    def call(*arguments: Any, **further: Any) -> Any:
        found = reference()
        return None if found is None else found(*arguments, **further)

    return call
