"""Ranks of a run: environment of MPI, agreement across ranks, and failure of one rank.

This module loads MPI alone, in tenths of a second; `runtime` adds PETSc and DOLFINx.
"""

import importlib.util
import math
import os
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NoReturn

from hpcinv.base.parallel.home import provide_home
from hpcinv.base.parallel.imports import imports_explained
from hpcinv.base.parallel.launchers import adapt_to_launcher, check_size
from hpcinv.base.parallel.malloc import keep_freed_memory
from hpcinv.base.parallel.signals import CLOSED_OUTPUT, discard_output
from hpcinv.errors import HpcinvError, OutOfMemory, OutputError


def _prepare_environment() -> None:
    """Set environment variables before MPI starts; values set by the user or site have priority."""
    # Threaded BLAS under MPI would use more threads than cores.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    # On one machine UCX would search for a network that is not needed; across machines it must choose.
    ranks, local = os.environ.get("PMI_SIZE"), os.environ.get("MPI_LOCALNRANKS")
    nodes = os.environ.get("SLURM_STEP_NUM_NODES", os.environ.get("SLURM_JOB_NUM_NODES", "1"))
    if ranks == local and nodes == "1":
        os.environ.setdefault("UCX_TLS", "self,sm,tcp")
    # PETSc's signal handlers would end a run that a signal only asks to stop. Its page on options that were not used
    # would follow the message of a run that ends early.
    for option, words in (("-no_signal_handler", "-no_signal_handler"), ("-options_left", "-options_left no")):
        if option not in (options := os.environ.get("PETSC_OPTIONS", "")):
            os.environ["PETSC_OPTIONS"] = f"{options} {words}".strip()
    # NumPy asks for huge pages where it puts large arrays. Factorizations get that memory later, and on virtual
    # machines the first touch of each page takes milliseconds.
    os.environ.setdefault("NUMPY_MADVISE_HUGEPAGE", "0")
    provide_home()
    keep_freed_memory()
    _find_library()


def _find_library() -> None:
    """Name the MPI library that was installed with mpi4py, where it is in another environment than this Python's.

    An environment on top of another one, such as ``uv run --with torch`` makes, has no library of its own; mpi4py would
    take one of the system, which is not the one of PETSc.
    """
    specification = importlib.util.find_spec("mpi4py")
    if specification is not None and specification.origin is not None:
        library = Path(specification.origin).parents[3] / "libmpi.so.12"
        if library.parent != Path(sys.prefix) / "lib" and library.exists():
            os.environ.setdefault("MPI4PY_LIBMPI", str(library))


_LONGER, _LONGEST = 1.2, 2e-3
"""Growth of the pauses of a rank that waits, and the longest one (s). It begins late by 20 % of its waiting at most;
longer pauses delay it more, shorter ones take more of a processor that other ranks use."""

_prepare_environment()

import mpi4py  # noqa: E402  (in that environment)

mpi4py.rc.initialize = False  # the launcher is checked first
# Read at the import of MPI. Without MPI_Finalize, mpiexec kills all ranks as soon as the first has ended.
mpi4py.rc.finalize = True

from mpi4py import MPI as MPI  # noqa: E402


def _start_mpi() -> None:
    if MPI.Is_initialized():  # by a program that has imported MPI itself
        return
    library = MPI.Get_library_version()
    adapt_to_launcher(library, os.environ)
    MPI.Init_thread()
    check_size(library, os.environ, MPI.COMM_WORLD.size)


_start_mpi()


class RootFailure(RuntimeError):
    """An unexpected error on rank 0, which has printed it."""


def on_root[T](comm: MPI.Intracomm, function: Callable[[], T]) -> T:
    """Run ``function`` on rank 0 only, and return its result or raise its exception on every rank; collective."""
    result: T | None = None
    error: Exception | None = None
    if comm.rank == 0:
        try:
            with imports_explained():
                result = function()
        except (HpcinvError, BrokenPipeError) as exc:
            error = exc
        except MemoryError as exc:
            error = OutOfMemory.describing(exc)
        except BaseException as exc:  # also SystemExit: the other ranks wait below
            _print_traceback(comm, exc)
            error = RootFailure(f"rank 0: {type(exc).__name__}: {exc}")
    wait_for_all(comm)
    error = comm.bcast(error)
    if error is not None:
        raise error
    shared: T = comm.bcast(result)
    return shared


def wait_for_all(comm: MPI.Intracomm, patience: float = math.inf) -> bool:
    """Wait until all ranks come here, and let processors free meanwhile; ``False`` after ``patience`` (s).

    MPI itself waits busily: ranks that outnumber the cores would take turns with those that still work.
    """
    everyone, pause, deadline = comm.Ibarrier(), 1e-5, time.monotonic() + patience
    while not everyone.Test():
        if time.monotonic() > deadline:
            return False
        time.sleep(pause)
        pause = min(_LONGER * pause, _LONGEST)
    return True


def agree(comm: MPI.Intracomm, error: HpcinvError | None) -> None:
    """Raise on every rank the error of the lowest rank that has one; collective."""
    errors = [e for e in comm.allgather(error) if e is not None]
    if errors:
        raise errors[0]


@contextmanager
def failing_together(comm: MPI.Intracomm) -> Iterator[None]:
    """Context in which an exception on one rank ends all ranks, so that none waits forever.

    An ``HpcinvError`` on all ranks is printed once and becomes ``SystemExit`` with its exit code; any other exception,
    on any rank, ends the run.
    """
    ending = comm.Dup()  # a separate communicator for the agreement on errors
    try:
        with imports_explained():
            yield
    except HpcinvError as error:
        if not wait_for_all(ending, patience=5.0):
            print(f"[rank {comm.rank}] {error}", file=sys.stderr, flush=True)
            abort(comm, error.exit_code)
        if comm.rank == 0:
            print(error, file=sys.stderr, flush=True)
        raise SystemExit(error.exit_code) from None
    except BrokenPipeError:  # the output of this rank is not read any more
        discard_output()
        abort(comm, CLOSED_OUTPUT)
    except MemoryError as exc:
        shortage = OutOfMemory.describing(exc)
        print(f"[rank {comm.rank}] {shortage}", file=sys.stderr, flush=True)
        abort(comm, shortage.exit_code)
    except BaseException as exc:  # also SystemExit: otherwise MPI_Finalize would wait for ranks that wait for this one
        if not isinstance(exc, RootFailure):
            _print_traceback(comm, exc)
        if comm.rank != 0:
            time.sleep(1.0)  # the message of rank 0 often says more: let it print first
        abort(comm, 1)


def _print_traceback(comm: MPI.Intracomm, exc: BaseException) -> None:
    sys.stderr.write(f"[rank {comm.rank}] " + "".join(traceback.format_exception(exc)))
    sys.stderr.flush()


def abort(comm: MPI.Intracomm, code: int) -> NoReturn:
    """End all ranks of a run with an exit code."""
    with suppress(OutputError):
        sys.stdout.flush()
    sys.stderr.flush()
    if comm.size > 1:
        time.sleep(0.2)  # a launcher may drop output that it has not forwarded yet
        comm.Abort(code)
    os._exit(code)


def require_ranks(comm: MPI.Intracomm, expected: int | None) -> None:
    """Raise ``OutputError`` if the launcher did not start the requested number of ranks.

    ``srun`` without a matching ``--mpi`` starts N separate runs of one rank, which would all write to the same place.
    """
    if expected is not None and comm.size != expected:
        raise OutputError(
            f"--ranks {expected} was requested, but the launcher started {comm.size}",
            "With Slurm use 'srun --mpi=pmi2' or 'mpirun'; with mpirun check -n.",
        )
