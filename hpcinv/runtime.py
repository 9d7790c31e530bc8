"""The parallel run time: environment and import order, agreement across ranks, and what one failing rank does.

Import this module before anything that loads MPI, PETSc or DOLFINx.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import re
import shlex
import shutil
import sys
import sysconfig
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, NoReturn

from hpcinv.errors import HpcinvError, OutputError, SystemPartMissing
from hpcinv.heap import keep_freed_memory
from hpcinv.signals import CLOSED_OUTPUT, discard_output

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
    keep_freed_memory()


def _load_stack() -> None:
    """Import the compiled stack in the one order in which it shares a single MPI, PETSc and ADIOS2."""
    if importlib.util.find_spec("dolfinx_solver"):  # the wheel; a site's own DOLFINx has no such package
        importlib.import_module("dolfinx_solver")
    for name in ("mpi4py.MPI", "petsc4py.PETSc", "dolfinx", "adios4dolfinx"):
        importlib.import_module(name)


_prepare_environment()
_load_stack()

from mpi4py import MPI  # noqa: E402  (after the order above)


class RootFailure(RuntimeError):
    """Something other than a user's error went wrong on rank 0, which has printed it."""


def on_root[T](comm: Intracomm, function: Callable[[], T]) -> T:
    """Run ``function`` on rank 0 alone and give its result, or the exception that it raised, to every rank."""
    result: T | None = None
    error: Exception | None = None
    if comm.rank == 0:
        try:
            result = function()
        except (HpcinvError, BrokenPipeError) as exc:
            error = exc
        except BaseException as exc:  # whatever it is, SystemExit too, must reach the ranks that wait below
            _print_traceback(comm, exc)
            error = RootFailure(f"rank 0: {type(exc).__name__}: {exc}")
    error = comm.bcast(error)
    if error is not None:
        raise error
    shared: T = comm.bcast(result)
    return shared


def agree(comm: Intracomm, error: HpcinvError | None) -> None:
    """Raise on every rank the error of the lowest rank that has one; collective."""
    errors = [e for e in comm.allgather(error) if e is not None]
    if errors:
        raise errors[0]


@contextmanager
def failing_together(comm: Intracomm, patience: float = 5.0) -> Iterator[None]:
    """Let no rank leave this block by an exception while others wait for it in vain.

    A user's error that all ranks meet is printed once and goes on as ``SystemExit`` with its code; anything else, on
    any rank, ends the run.

    Args:
        patience: seconds after which another rank will not meet the same error any more.
    """
    ending = comm.Dup()  # of its own: nothing else can take part in the agreement on how it ended
    try:
        yield
    except HpcinvError as error:
        everyone, deadline = ending.Ibarrier(), time.monotonic() + patience
        while not everyone.Test():
            if time.monotonic() > deadline:
                print(f"[rank {comm.rank}] {error}", file=sys.stderr, flush=True)
                abort(comm, error.exit_code)
            time.sleep(0.01)
        if comm.rank == 0:
            print(error, file=sys.stderr, flush=True)
        raise SystemExit(error.exit_code) from None
    except BrokenPipeError:  # nobody reads what this rank prints
        discard_output()
        abort(comm, CLOSED_OUTPUT)
    except BaseException as exc:  # SystemExit too: Python would wait in MPI_Finalize for ranks that wait for it
        if not isinstance(exc, RootFailure):
            _print_traceback(comm, exc)
        if comm.rank != 0:
            time.sleep(1.0)  # rank 0 often knows more: let it speak before all are ended
        abort(comm, 1)


def _print_traceback(comm: Intracomm, exc: BaseException) -> None:
    sys.stderr.write(f"[rank {comm.rank}] " + "".join(traceback.format_exception(exc)))
    sys.stderr.flush()


def abort(comm: Intracomm, code: int) -> NoReturn:
    """End every rank of a run that cannot go on together."""
    sys.stdout.flush()
    sys.stderr.flush()
    if comm.size > 1:
        time.sleep(0.2)  # a launcher may drop what it has not passed on yet
        comm.Abort(code)
    os._exit(code)


@contextmanager
def compilation_explained(comm: Intracomm) -> Iterator[None]:
    """Turn a kernel that could not be compiled into a ``SystemPartMissing`` on every rank.

    Asking for a compiler beforehand would refuse runs whose kernels are all in DOLFINx's cache.
    """
    try:
        yield
    except Exception as exc:
        modules = {frame.f_globals.get("__name__") for frame, _ in traceback.walk_tb(exc.__traceback__)}
        if "dolfinx.jit" in modules:  # where a failure on rank 0 is raised on all ranks
            text = str(exc)
            on_root(comm, lambda: _explain_compilation(text))
        raise


def _explain_compilation(text: str) -> None:
    packages = "On Debian and Ubuntu: apt-get install gcc libc6-dev python3-dev; elsewhere set CC to your compiler."
    compiler = shlex.split(os.environ.get("CC") or sysconfig.get_config_var("CC") or "cc")[0]
    if shutil.which(compiler) is None:
        raise SystemPartMissing(f"no C compiler '{compiler}', which DOLFINx compiles its kernels with", packages)
    if unwritten := re.search(r"(kernels cannot be written|the compiler cannot write) to .*", text):
        raise SystemPartMissing(
            unwritten[0],
            "Make room there, or name other directories: HPCINV_KERNELS for kernels, TMPDIR for the compiler's files.",
        )
    if "CompileError" in text or "LinkError" in text:
        raise SystemPartMissing(f"the C compiler '{compiler}' could not compile a kernel: {text}", packages)


def require_ranks(comm: Intracomm, expected: int | None) -> None:
    """Raise ``OutputError`` where the launcher did not give the number of ranks that was asked for.

    ``srun`` without a matching ``--mpi`` starts N separate runs of one rank, which would all write to one place.
    """
    if expected is not None and comm.size != expected:
        raise OutputError(
            f"--ranks {expected} was asked for, but the launcher gave {comm.size}",
            "With Slurm use 'srun --mpi=pmi2' or 'mpirun'; with mpirun check -n.",
        )


__all__ = [
    "MPI",
    "abort",
    "agree",
    "compilation_explained",
    "failing_together",
    "on_root",
    "require_ranks",
]
