"""Compilation of the certificate's kernels in a child process, while this one compiles the solve's kernels, and solves.

Whichever process comes to a kernel first compiles it; the other waits, and loads it. If the child fails, this process
compiles all kernels itself.
"""

import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from hpcinv.parallel.children import ending_with_this
from hpcinv.parallel.jit import at_first_missing_kernel
from hpcinv.parallel.runtime import MPI
from hpcinv.preparation import Prepared

_PROGRAM = "hpcinv.cli.certificate_kernels"
_MANY = 100_000  # cells; the solve of more takes far longer than compilation, and the child would copy their mesh
_PATIENCE = 5.0  # s that the child has to remove its temporary files; then it is killed
_LAUNCHER = ("PMI", "MPI_LOCAL", "HYD", "OMPI_")  # variables by which the child would take itself for a rank


@contextmanager
def certificate_kernels_ahead(prepared: Prepared) -> Iterator[None]:
    """Context in which the first kernel that is missing starts the child process, on rank 0; collective.

    There is none without an idle second processor, for a large mesh, or without a certificate.
    """
    job, source, comm = prepared.job, prepared.body.source, prepared.body.mesh.comm
    forecast = prepared.equations[0].chooser.forecast
    is_small = not source.is_partitioned and len(source.cells) <= _MANY
    node = comm.Split_type(MPI.COMM_TYPE_SHARED)
    ranks = node.size
    node.Free()
    if comm.rank or job.certificate.level == "off" or not (is_small and _has_idle_processor(ranks)):
        yield
        return
    children = list[subprocess.Popen[bytes]]()

    def start() -> None:
        with suppress(OSError):  # a full disk, or too many processes: this process compiles all
            children.append(_start(pickle.dumps((job, source, forecast))))

    with at_first_missing_kernel(start):
        try:
            yield
        finally:
            for child in children:
                _end(child)


def _has_idle_processor(ranks: int) -> bool:
    """Return whether a further processor can be used, and was idle in the last minute: the child has work of its own.

    Args:
        ranks: number of ranks on this node. Slurm may leave them free to use processors of other jobs, so that only
            its variable shows whether one is left. Elsewhere, ranks that wait for a kernel leave theirs to the child.
    """
    allocated = os.environ.get("SLURM_CPUS_ON_NODE", "")
    if allocated.isdecimal() and int(allocated) <= ranks:
        return False
    if sys.platform != "linux":
        return True
    processors = len(os.sched_getaffinity(0))
    return processors > 1 and os.getloadavg()[0] < processors - 0.5


def _start(data: bytes) -> subprocess.Popen[bytes]:
    """Start the child process, which reads ``data``."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(_LAUNCHER)}
    places = (str(Path(__file__).parents[1]), environment.get("PYTHONPATH"))
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, places))
    with tempfile.TemporaryFile() as file:
        file.write(data)
        file.seek(0)
        command = ending_with_this([sys.executable, "-P", "-m", _PROGRAM])
        return subprocess.Popen(
            command, stdin=file, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment
        )


def _end(child: subprocess.Popen[bytes]) -> None:
    """End the child process and wait for it."""
    child.terminate()
    try:
        child.wait(_PATIENCE)
    except subprocess.TimeoutExpired:
        child.kill()
        child.wait()
