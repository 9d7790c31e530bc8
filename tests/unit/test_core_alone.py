"""The core without the packages that plug into it, and without the extras."""

import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from helpers.command_line import ROOT, environment

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
CONTRACTS = PROJECT["tool"]["importlinter"]["contracts"]
(CONTRACT,) = (contract for contract in CONTRACTS if contract["type"] == "forbidden")
EXTRAS = PROJECT["project"]["optional-dependencies"]
IMPORT_ALL = """
import importlib, sys
import hpcinv.base.parallel.runtime
for name in sys.argv[1:]:
    importlib.import_module(name)
"""


def modules_of(package: str) -> list[str]:
    """Return the names of a package's modules, or of a module."""
    place = ROOT / package.replace(".", "/")
    files = sorted(place.rglob("*.py")) or [place.with_suffix(".py")]
    names = [".".join(file.relative_to(ROOT).with_suffix("").parts) for file in files]
    return [name.removesuffix(".__init__") for name in names if not name.endswith("isolated_reader")]


def modules_of_extras() -> set[str]:
    """Return the names of the modules that extras other than ``checkpoints`` install."""
    lines = [line for extra, lines in EXTRAS.items() if extra != "checkpoints" for line in lines]
    needed = {line.partition("==")[0] for line in lines}
    owners = packages_distributions()
    names = {module for module in owners if needed.intersection(map(str.lower, owners[module]))}
    assert {"SimpleITK", "matplotlib", "pyvista", "vtkmodules"} <= names
    return {name for name in names if name.isidentifier()}


@pytest.fixture
def core(tmp_path: Path) -> Path:
    """Directory of a package ``hpcinv`` without what plugs in, by links."""
    package = tmp_path / "hpcinv"
    package.mkdir()
    left_out = {name.removeprefix("hpcinv.") for name in CONTRACT["forbidden_modules"]}
    assert all((ROOT / "hpcinv" / name).exists() for name in left_out)
    for path in (ROOT / "hpcinv").iterdir():
        if path.name not in left_out:
            (package / path.name).symlink_to(path)
    return tmp_path


def python(core: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *arguments]
    variables = environment(PYTHONPATH=str(core))
    return subprocess.run(command, capture_output=True, text=True, cwd=core, env=variables, check=False)


def test_every_module_of_the_core_is_imported_without_what_plugs_in(core: Path) -> None:
    names = [name for package in CONTRACT["source_modules"] for name in modules_of(package)]
    assert len(names) > 300
    done = python(core, "-c", IMPORT_ALL, *names)
    assert done.returncode == 0, done.stderr


def test_the_core_alone_solves_a_job_without_extras(core: Path) -> None:
    for name in modules_of_extras():
        error = f"ModuleNotFoundError(\"No module named '{name}'\", name='{name}')"
        (core / f"{name}.py").write_text(f"raise {error}")
    text = (ROOT / "jobs" / "single-tetrahedron.yaml").read_text()
    mesh = (ROOT / "meshes" / "single_tetrahedron.msh").as_posix()
    job = core / "job.yaml"
    job.write_text(text.replace("../meshes/single_tetrahedron.msh", mesh) + "output: {report: false}\n")
    done = python(core, "-m", "hpcinv", "run", str(job), "--output", "results")
    assert done.returncode == 0, done.stderr
    assert "apex-displacement: -0.224839 m" in done.stdout
