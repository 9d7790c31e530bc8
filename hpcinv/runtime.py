"""The parallel run time: environment and import order, agreement across ranks, and what one failing rank does.

Import this module before anything that loads MPI, PETSc or DOLFINx.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import shutil
import sys
import time
import traceback
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, NoReturn

from hpcinv.errors import HpcinvError, OutputError, SystemPartMissing

if TYPE_CHECKING:
    from mpi4py.MPI import Intracomm


def _prepare_environment() -> None:
    """Set what has to stand before MPI starts; a value that the user or site has set always wins."""
    # Threaded BLAS under MPI makes the ranks fight for cores.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    # On one machine UCX would probe for a fabric that is not there; across machines it must be left to choose.
    ranks, local = os.environ.get("PMI_SIZE"), os.environ.get("MPI_LOCALNRANKS")
    nodes = os.environ.get("SLURM_STEP_NUM_NODES", os.environ.get("SLURM_JOB_NUM_NODES", "1"))
    if ranks == local and nodes == "1":
        os.environ.setdefault("UCX_TLS", "self,sm,tcp")


def _load_stack() -> None:
    """Import the compiled stack in the one order in which it shares a single MPI, PETSc and ADIOS2."""
    if importlib.util.find_spec("dolfinx_solver"):  # the wheel; a site's own DOLFINx has no such package
        importlib.import_module("dolfinx_solver")
    for name in ("mpi4py.MPI", "petsc4py.PETSc", "dolfinx", "adios4dolfinx"):
        importlib.import_module(name)


_prepare_environment()
_load_stack()

from mpi4py import MPI  # noqa: E402  (after the order above)


def on_root[T](comm: Intracomm, function: Callable[[], T]) -> T:
    """Run ``function`` on rank 0 alone and give its result, or the exception that it raised, to every rank."""
    result: T | None = None
    error: Exception | None = None
    if comm.rank == 0:
        try:
            result = function()
        except HpcinvError as exc:
            error = exc
        except Exception as exc:  # any failure must reach the ranks that wait below
            traceback.print_exc()
            error = RuntimeError(f"rank 0: {type(exc).__name__}: {exc}")
    error = comm.bcast(error)
    if error is not None:
        raise error
    return comm.bcast(result)


def agree(comm: Intracomm, error: HpcinvError | None) -> None:
    """Raise on every rank the error of the lowest rank that has one; collective."""
    errors = [e for e in comm.allgather(error) if e is not None]
    if errors:
        raise errors[0]


def end_all_on_uncaught(comm: Intracomm) -> None:
    """Make an exception that nothing catches on one rank end the whole run instead of hanging the others."""

    def hook(kind: type[BaseException], value: BaseException, trace: TracebackType | None) -> None:
        sys.stderr.write(f"[rank {comm.rank}] " + "".join(traceback.format_exception(kind, value, trace)))
        sys.stderr.flush()
        abort(comm, 1)

    sys.excepthook = hook


def tell(comm: Intracomm, error: HpcinvError, patience: float = 20.0) -> None:
    """Print a user's error once, from rank 0; end the run if some rank did not meet the same error in time."""
    everyone = comm.Ibarrier()
    deadline = time.monotonic() + patience
    while not everyone.Test():
        if time.monotonic() > deadline:
            print(f"[rank {comm.rank}] {error}", file=sys.stderr, flush=True)
            abort(comm, error.exit_code)
        time.sleep(0.01)
    if comm.rank == 0:
        print(error, file=sys.stderr, flush=True)


def abort(comm: Intracomm, code: int) -> NoReturn:
    """End every rank of a run that cannot go on together."""
    if comm.size > 1:
        comm.Abort(code)
    os._exit(code)


def require_compiler() -> None:
    """Raise ``SystemPartMissing`` where DOLFINx would find no C compiler for its kernels."""
    compiler = os.environ.get("CC", "cc").split()[0]
    if shutil.which(compiler) is None:
        raise SystemPartMissing(
            f"no C compiler: '{compiler}' was not found, and DOLFINx compiles its kernels with it",
            "On Debian and Ubuntu: apt-get install gcc libc6-dev; elsewhere set CC to the compiler of your site.",
        )


def require_ranks(comm: Intracomm, expected: int | None) -> None:
    """Raise ``OutputError`` where the launcher did not give the number of ranks that was asked for.

    ``srun`` without a matching ``--mpi`` starts N separate runs of one rank, which would all write to one place.
    """
    if expected is not None and comm.size != expected:
        raise OutputError(
            f"--ranks {expected} was asked for, but the launcher gave {comm.size}",
            "With Slurm use 'srun --mpi=pmi2' or 'mpirun'; with mpirun check -n.",
        )


__all__ = ["MPI", "abort", "agree", "end_all_on_uncaught", "on_root", "require_compiler", "require_ranks", "tell"]
