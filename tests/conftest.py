"""What all tests share: the import order of the stack, mpirun on the path, and a directory that all ranks see."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from hpcinv.parallel.runtime import MPI

ROOT = Path(__file__).parents[1]
UNIT = ROOT / "tests" / "unit"

# mpi-pytest starts "mpiexec" by name, and the one that belongs to this Python is beside it.
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
# A rank that fails alone leaves the others waiting: let mpiexec end them, so that the test fails instead of hanging.
os.environ.setdefault("MPIEXEC_TIMEOUT", "300")
# Without byte code each of some thousand processes would compile all that it imports: twice its processor time.
if os.environ.pop("PYTHONDONTWRITEBYTECODE", ""):
    os.environ["PYTHONPYCACHEPREFIX"] = str(ROOT / ".pytest_cache" / "bytecode")


def pytest_xdist_auto_num_workers() -> int:
    """Two tests at a time, so that kernels compile side by side; the ranks of a parallel test share its one process."""
    return 0 if "_PYTEST_MPI_CHILD_PROCESS" in os.environ else min(2, os.cpu_count() or 1)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark as fast what is in tests/unit, unless it is slow or starts several ranks: ``pytest -m fast``."""
    for item in items:
        if UNIT in item.path.parents and not any(item.iter_markers("slow")) and not any(item.iter_markers("parallel")):
            item.add_marker("fast")


@pytest.fixture
def comm() -> MPI.Intracomm:
    """All ranks of the test."""
    return MPI.COMM_WORLD


@pytest.fixture
def run_directory(tmp_path: Path, comm: MPI.Intracomm) -> Path:
    """A temporary directory that is the same on all ranks."""
    return comm.bcast(tmp_path)


@pytest.fixture
def meshes() -> Path:
    """The meshes that come with the project."""
    return ROOT / "meshes"
