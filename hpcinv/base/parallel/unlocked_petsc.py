"""Long calls of PETSc that release the interpreter lock of Python, which petsc4py keeps.

Meanwhile the thread of `hpcinv.base.parallel.signals` can end a process that is asked to stop. Functions in Python take
the lock themselves where PETSc calls them. Cyclic garbage is not collected: another thread that collected it would
destroy objects of PETSc and communicators of MPI, neither of which allow two threads at a time.
"""

import ctypes
import gc
from functools import cache

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
    collects = gc.isenabled()
    try:
        function = getattr(_library(), name)
        gc.disable()
        return bool(function(*(ctypes.c_void_p(one.handle) for one in objects)) == 0)
    except (OSError, AttributeError, SystemError):  # no such library, or an exception within a function in Python
        return False
    finally:
        if collects:
            gc.enable()


@cache
def _library() -> ctypes.CDLL:
    return ctypes.CDLL(PETSc.__file__)
