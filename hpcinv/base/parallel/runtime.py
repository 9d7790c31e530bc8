"""Import of the compiled stack in the right order. ADIOS2 is left to files that need it (`hpcinv.base.parallel.adios`).

Import this module before anything that loads PETSc or DOLFINx.
"""

import importlib
import importlib.util
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from hpcinv.base.parallel.imports import is_text
from hpcinv.base.parallel.ranks import MPI, agree, on_root
from hpcinv.base.parallel.signals import handlers_kept
from hpcinv.errors import SystemPartMissing

# isort: split
from numpy import complexfloating  # after `ranks`, which sets NumPy's threads and memory

DOLFINX = "0.11"
"""The version whose interface is used; others differ in it."""

INSTALLING = "docs/start/installing.md says how DOLFINx is installed with hpcinv, and what your own must be."


def _load_stack() -> None:
    """Import the compiled stack in the only order in which all parts share one MPI and PETSc."""
    if importlib.util.find_spec(
        "dolfinx_solver"
    ):  # in the wheel; a DOLFINx that the site has built has no such package
        importlib.import_module("dolfinx_solver")  # checks that no other PETSc is installed
    for name in ("mpi4py.MPI", "petsc4py.PETSc", "dolfinx"):
        try:
            module = importlib.import_module(name)
        except ImportError as exc:
            raise SystemPartMissing(f"{name.partition('.')[0]} cannot be imported: {exc}", INSTALLING) from None
        if name == "petsc4py.PETSc" and issubclass(module.ScalarType, complexfloating):
            raise SystemPartMissing("PETSc has complex scalars, and hpcinv needs real ones", INSTALLING)
        # Here, since it waits for all ranks, and some may never solve. The log measures the time of linear solves.
        if name == "petsc4py.PETSc" and not module.Log.isActive():
            module.Log.begin()
        if name == "dolfinx" and not module.__version__.startswith(f"{DOLFINX}."):
            mismatch = f"DOLFINx {module.__version__} is installed, and hpcinv needs {DOLFINX}"
            raise SystemPartMissing(mismatch, INSTALLING)


@contextmanager
def _readable_arguments() -> Iterator[None]:
    """Context without arguments that are not UTF-8: DOLFINx, which looks for options of its own, fails with them."""
    typed = sys.argv
    sys.argv = [argument for argument in typed if is_text(argument)]
    try:
        yield
    finally:
        sys.argv = typed


with handlers_kept(), _readable_arguments():  # PETSc installs a handler of SIGTERM that ends the process
    _load_stack()


__all__ = ["MPI", "agree", "on_root"]
