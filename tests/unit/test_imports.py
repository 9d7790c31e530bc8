"""Checking a job must work, at once, where there is neither MPI nor DOLFINx."""

from __future__ import annotations

import os
import resource
import subprocess
import sys

import pytest

MODULES = "hpcinv.job.job, hpcinv.materials, hpcinv.effects, hpcinv.study.study_plan, hpcinv.sweep.sweep_plan"
MODULES += ", hpcinv.batch.ledger.ledger"
HEAVY = {
    "dolfinx",
    "dolfinx_solver",
    "petsc4py",
    "mpi4py",
    "gmsh",
    "ufl",
    "basix",
    "adios2",
    "h5py",
    "numpy",
    "pyvista",
    "scipy",
}


def run(code: str) -> str:
    return subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout


def test_specs_import_neither_mpi_nor_the_solver() -> None:
    loaded = set(run(f"import sys, {MODULES}; print(*sys.modules)").split())
    assert not HEAVY & loaded


def test_importing_the_specs_takes_less_than_a_second_of_cpu() -> None:
    def used() -> float:
        usage = resource.getrusage(resource.RUSAGE_CHILDREN)
        return usage.ru_utime + usage.ru_stime

    before = used()
    run(f"import {MODULES}")
    assert used() - before < 1.0


def test_the_driver_leaves_slow_imports_to_the_runs_and_ranks_that_need_them() -> None:
    loaded = set(run("import sys, hpcinv.driver; print(*sys.modules)").split())
    assert "dolfinx" in loaded
    assert not {"scipy.spatial", "gmsh", "h5py", "pyvista", "rich"} & loaded


AT_IMPORT = """
import importlib, os, sys

class Watch:
    def find_spec(self, name, *_):
        if name == "numpy":
            print(os.environ.get("OMP_NUM_THREADS"), os.environ.get("NUMPY_MADVISE_HUGEPAGE"))

sys.meta_path.insert(0, Watch())
importlib.import_module(sys.argv[1])
"""


@pytest.mark.parametrize("module", ["hpcinv.parallel.runtime", "hpcinv.driver", "hpcinv.assembly.tangent_product"])
def test_numpy_is_imported_with_one_thread_and_without_huge_pages(module: str) -> None:
    names = {"OMP_NUM_THREADS", "NUMPY_MADVISE_HUGEPAGE"}
    environment = {name: value for name, value in os.environ.items() if name not in names}
    command = [sys.executable, "-c", AT_IMPORT, module]
    done = subprocess.run(command, check=True, capture_output=True, text=True, env=environment)
    assert done.stdout.split("\n")[0] == "1 0"
