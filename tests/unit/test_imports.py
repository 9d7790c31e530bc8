"""Checking a job must work, at once, where there is neither MPI nor DOLFINx."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import pytest

from hpcinv.job.body_kinds import KINDS
from hpcinv.on_demand import FUNCTIONS, on_demand
from hpcinv.physics.effects import effects
from hpcinv.physics.materials import laws

JOBS = Path(__file__).parents[2] / "jobs"

MODULES = "hpcinv.job.job, hpcinv.physics.materials, hpcinv.physics.effects, hpcinv.studies.study.study_plan"
MODULES += ", hpcinv.studies.sweep.sweep_plan, hpcinv.studies.batch.ledger.ledger"
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


def test_the_version_is_printed_without_the_modules_of_commands() -> None:
    code = "import atexit, sys; atexit.register(lambda: print(*sys.modules)); from hpcinv.__main__ import main; "
    version, loaded = run(f"{code}main(['--version'])").splitlines()
    assert re.fullmatch(r"\d+\.\d+\.\d+", version)
    assert "pydantic" not in loaded
    assert "hpcinv.cli" not in loaded


PROGRAM = """
import sys
from pathlib import Path
from hpcinv.__main__ import main

main(sys.argv[2:])
names = (name for name, module in sys.modules.items() if getattr(module, "__file__", None))
Path(sys.argv[1]).write_text(" ".join(names))
"""
JOB_PACKAGES = {"annotated_types", "pydantic", "pydantic_core", "typing_extensions", "typing_inspection", "yaml"}
RUN_PACKAGES = JOB_PACKAGES | {
    "adios2",
    "adios4dolfinx",
    "basix",
    "cffi",
    "dolfinx",
    "dolfinx_solver",
    "ffcx",
    "gmsh",
    "h5py",
    "mpi4py",
    "numpy",
    "packaging",
    "petsc4py",
    "pycparser",
    "rich",
    "ufl",
}
"""packages of others; each takes from 10 ms to half a second"""
UNNEEDED_BY_A_JOB = {
    "hpcinv.studies.batch",
    "hpcinv.driver",
    "hpcinv.output",
    "hpcinv.studies.study",
    "hpcinv.studies.sweep",
    "hpcinv.mesh",
}
UNNEEDED_BY_A_RUN = {
    "hpcinv.studies.batch",
    "hpcinv.studies.fitting",
    "hpcinv.studies.identification",
    "hpcinv.geometry.imaging",
    "hpcinv.studies.study",
    "hpcinv.studies.sweep",
    "hpcinv.geometry.workshop",
    "http.client",
    "numpy.f2py",
}


ALWAYS_LOADED = {"hpcinv.model.cavities", "hpcinv.output.function_files", "hpcinv.physics.points.form_programs"}
"""rooms of checkpoints, that an empty cache needs, or that registered unknown numbers of loads import"""


def imported_modules(tmp_path: Path, *arguments: str) -> set[str]:
    """Names of the modules that a command has imported."""
    listed = tmp_path / "modules.txt"
    command = [sys.executable, "-c", PROGRAM, str(listed), *arguments]
    subprocess.run(command, check=True, capture_output=True, text=True, cwd=tmp_path)
    return set(listed.read_text().split())


def foreign_packages(modules: set[str]) -> set[str]:
    """Names of packages that belong neither to Python nor to the project."""
    names = {name.partition(".")[0] for name in modules} - sys.stdlib_module_names - {"__main__", "hpcinv"}
    return {name for name in names if not name.startswith("_")}


def members(package: str, names: Iterable[str], modules: set[str]) -> set[str]:
    """Names of the laws or effects whose modules are among those that were imported."""
    return {name for name in names if f"{package}.{name.replace('-', '_')}" in modules}


def test_validate_imports_no_more_than_it_needs(tmp_path: Path) -> None:
    modules = imported_modules(tmp_path, "validate", str(JOBS / "single-tetrahedron.yaml"))
    law = {"neo-hookean", "isochoric-neo-hookean"}  # the second is named by the first
    assert members("hpcinv.physics.materials", laws(), modules) == law
    in_rules = {"contact", "pressure"}
    assert members("hpcinv.physics.effects", effects(), modules) == {"gravity", *in_rules}
    assert foreign_packages(modules) == JOB_PACKAGES
    assert not UNNEEDED_BY_A_JOB & modules
    assert {name for name in modules if name.startswith("hpcinv.cli.")} <= {"hpcinv.cli.help", "hpcinv.cli.validate"}


def test_a_run_imports_no_more_than_it_needs(tmp_path: Path) -> None:
    modules = imported_modules(tmp_path, "run", str(JOBS / "single-tetrahedron.yaml"), "--output", "results")
    assert foreign_packages(modules) <= RUN_PACKAGES
    assert not UNNEEDED_BY_A_RUN & modules
    rooms = {place.partition(":")[0] for place in FUNCTIONS.values()} - ALWAYS_LOADED
    assert not rooms & modules
    commands = {name for name in modules if name.startswith("hpcinv.cli.")}
    assert commands == {"hpcinv.cli.help", "hpcinv.cli.options", "hpcinv.cli.run"}


@pytest.mark.parametrize("is_installed", [True, False])
def test_another_petsc_in_the_environment_is_refused(is_installed: bool, tmp_path: Path) -> None:
    if is_installed:
        metadata = tmp_path / "petsc4py-3.20.dist-info"
        metadata.mkdir()
        (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: petsc4py\nVersion: 3.20\n")
    else:
        (tmp_path / "petsc4py").mkdir()
        (tmp_path / "petsc4py" / "__init__.py").touch()
    command = [sys.executable, "-m", "hpcinv", "run", str(JOBS / "single-tetrahedron.yaml")]
    path = f"{tmp_path}:{JOBS.parent}"
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=os.environ | {"PYTHONPATH": path})
    assert done.returncode == 5, done.stderr
    assert done.stderr.startswith("dolfinx_solver cannot be imported: petsc4py ")
    assert "Traceback" not in done.stderr


def test_the_driver_leaves_slow_imports_to_the_runs_and_ranks_that_need_them() -> None:
    loaded = set(run("import sys, hpcinv.driver; print(*sys.modules)").split())
    assert "dolfinx" in loaded
    assert not {"scipy.spatial", "gmsh", "h5py", "pyvista", "rich"} & loaded


AT_IMPORT = """
import importlib, os, sys

class Watch:
    def find_spec(self, name, *_):
        if name == "numpy":
            print(os.environ.get("OMP_NUM_THREADS"), os.environ.get("NUMPY_MADVISE_HUGEPAGE"), flush=True)
            os._exit(0)  # the imports that follow take seconds

sys.meta_path.insert(0, Watch())
importlib.import_module(sys.argv[1])
"""


@pytest.mark.parametrize(
    "module", ["hpcinv.base.parallel.runtime", "hpcinv.driver", "hpcinv.model.assembly.tangent_product"]
)
def test_numpy_is_imported_with_one_thread_and_without_huge_pages(module: str) -> None:
    names = {"OMP_NUM_THREADS", "NUMPY_MADVISE_HUGEPAGE"}
    environment = {name: value for name, value in os.environ.items() if name not in names}
    command = [sys.executable, "-c", AT_IMPORT, module]
    done = subprocess.run(command, check=True, capture_output=True, text=True, env=environment)
    assert done.stdout.split("\n")[0] == "1 0"


def test_no_test_file_imports_from_another() -> None:
    """What several test files need is in tests/helpers."""
    tests = Path(__file__).parents[1]
    for path in tests.rglob("test_*.py"):
        imported = re.findall(
            r"^\s*(?:from|import) +(?:tests\.|\w+\.)*(test_\w+|tests)\b", path.read_text(), re.MULTILINE
        )
        assert {*imported} <= {path.stem}, path


@pytest.mark.parametrize("made", FUNCTIONS)
def test_what_is_made_on_demand_exists(made: str) -> None:
    assert callable(on_demand(made))


def test_each_room_on_demand_is_asked_for() -> None:
    texts = [path.read_text() for path in (JOBS.parent / "hpcinv").rglob("*.py") if path.name != "on_demand.py"]
    kinds = [f"{what} of a {kind}" for what in ("mesh", "finer problem") for kind in KINDS]
    assert [made for made in FUNCTIONS if made not in kinds and not any(f'"{made}"' in text for text in texts)] == []
