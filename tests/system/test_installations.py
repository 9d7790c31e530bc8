"""Installations other than the wheels: a DOLFINx that does not fit, and what the page on installing says to install."""

import importlib
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml
from helpers.command_line import COLUMN, command, environment, write_job

from hpcinv.base.parallel.imports import imports_explained
from hpcinv.base.parallel.runtime import DOLFINX
from hpcinv.errors import SystemPartMissing
from hpcinv.version import __version__

ROOT = Path(__file__).parents[2]
# What a site's own DOLFINx comes with.
OF_THE_SITE = {"adios2", "adios4dolfinx", "dolfinx-solver-real", "h5py", "mpi4py", "mpich", "numpy"}

RECIPE = ROOT / "containers" / "conda" / "recipe.yaml"
IN_CONDA = {"dolfinx-solver-real": "fenics-dolfinx", "gmsh": "python-gmsh"}
"""names in conda-forge that differ from PyPI's"""

WITHOUT_MPI = """
from types import SimpleNamespace
bindings = SimpleNamespace(is_built_with_mpi=False, __version__="2.10.0")
"""


def _with_part(module: str, text: str, place: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a command in an installation in which a package is another."""
    (place / module).mkdir(exist_ok=True)
    (place / module / "__init__.py").write_text(text)
    command = [sys.executable, "-m", "hpcinv", *arguments]
    settings = environment(PYTHONPATH=os.pathsep.join([str(place), str(ROOT)]))
    return subprocess.run(command, cwd=place, env=settings, capture_output=True, text=True, timeout=120, check=False)


def test_another_dolfinx_is_refused(tmp_path: Path) -> None:
    arguments = ["run", str(ROOT / "jobs" / "column.yaml"), "--output", "out"]
    ended = _with_part("dolfinx", "__version__ = '0.9.0'", tmp_path, *arguments)
    assert ended.returncode == 5, ended.stderr
    assert "DOLFINx 0.9.0 is installed, and hpcinv needs 0.11" in ended.stderr
    assert "docs/start/installing.md" in ended.stderr
    assert "Traceback" not in ended.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.everyday("adios2-text0-adios2 cannot be imported: version 2.10.0 was built without MPI")
@pytest.mark.parametrize(
    ("module", "text", "message"),
    [
        ("adios2", WITHOUT_MPI, "adios2 cannot be imported: version 2.10.0 was built without MPI"),
        ("adios4dolfinx", "raise ImportError('no such library')", "adios4dolfinx cannot be imported: no such library"),
    ],
)
def test_a_run_without_the_packages_of_checkpoints_ends_without_them(
    tmp_path: Path, module: str, text: str, message: str
) -> None:
    """Plain pip does not install adios4dolfinx."""
    write_job(tmp_path / "column.yaml", COLUMN | {"checkpoint": {"every": 1, "seconds": 0}})
    ended = _with_part(module, text, tmp_path, "run", "column.yaml", "--output", "out")
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.count(f"no checkpoints: {message}") == 1
    assert "docs/start/installing.md" in ended.stdout
    assert ("pip install --no-deps" in ended.stdout) == (module == "adios4dolfinx")
    assert (tmp_path / "out" / "summary.json").is_file()


@pytest.mark.release
def test_a_resume_without_the_packages_of_checkpoints_is_refused(tmp_path: Path) -> None:
    write_job(tmp_path / "column.yaml", COLUMN | {"checkpoint": {"every": 1, "seconds": 0}})
    _with_part("nothing", "", tmp_path, "run", "column.yaml", "--output", "out")
    assert list((tmp_path / "out" / "checkpoints").iterdir())
    (tmp_path / "out" / "summary.json").unlink()
    ended = _with_part("adios4dolfinx", "raise ImportError('no such library')", tmp_path, "resume", "out")
    assert ended.returncode == 5, ended.stderr
    assert "adios4dolfinx cannot be imported: no such library" in ended.stderr
    assert "Traceback" not in ended.stderr
    assert list((tmp_path / "out" / "checkpoints").iterdir())


@pytest.mark.everyday("arguments0-pydantic")
@pytest.mark.parametrize(
    ("arguments", "missing"),
    [
        (["laws"], "pydantic"),
        (["validate", "column.yaml"], "yaml"),
        (["run", "column.yaml"], "mpi4py"),
        (["run", "column.yaml"], "numpy"),
    ],
)
def test_a_package_that_is_missing_is_named_without_a_traceback(
    arguments: list[str], missing: str, tmp_path: Path
) -> None:
    ended = _without(missing, [sys.executable, "-m", "hpcinv", *arguments], tmp_path)
    assert ended.returncode == 5, ended.stderr
    message, advice = ended.stderr.splitlines()
    assert message == f"{missing} cannot be imported: No module named '{missing}'"
    assert sys.executable in advice
    assert "docs/start/installing.md" in advice


@pytest.mark.everyday("pydantic")
@pytest.mark.parametrize("missing", ["pydantic", "rich"])
def test_a_missing_package_is_named_once_on_several_ranks(missing: str, tmp_path: Path) -> None:
    """Only rank 0 imports rich."""
    ended = _without(missing, command(2, "run", "column.yaml"), tmp_path)
    assert ended.returncode == 5, ended.stderr
    assert ended.stderr.count(f"{missing} cannot be imported") == 1
    assert len(ended.stderr.splitlines()) == 2, ended.stderr


def test_a_sweep_names_a_missing_package_of_its_solver_processes(tmp_path: Path) -> None:
    sweep = {"sweep": "column", "job": "column.yaml", "store": "store", "axes": [{"grid": {"material.mu": [1e4, 2e4]}}]}
    (tmp_path / "sweep.yaml").write_text(json.dumps(sweep))
    ended = _without("cffi", command(1, "sweep", "run", "sweep.yaml"), tmp_path)
    assert ended.returncode == 5, ended.stderr
    assert ended.stderr.startswith("dolfinx cannot be imported: No module named 'cffi'\n")
    assert "Traceback" not in ended.stdout + ended.stderr


def test_errors_in_imports_of_hpcinv_or_python_stay_what_they_are() -> None:
    for name in ("hpcinv.job.nothing", "asyncio.nothing"):
        with pytest.raises(ModuleNotFoundError), imports_explained():
            importlib.import_module(name)


def _without(missing: str, program: list[str], place: Path) -> subprocess.CompletedProcess[str]:
    """Run a program in an installation that lacks a package, in the directory of the job ``column.yaml``."""
    write_job(place / "column.yaml", COLUMN)
    lacking = place / "lacking"
    lacking.mkdir()
    error = f"ModuleNotFoundError(\"No module named '{missing}'\", name='{missing}')"
    (lacking / f"{missing}.py").write_text(f"raise {error}")
    settings = environment(PYTHONPATH=os.pathsep.join([str(lacking), str(ROOT)]))
    return subprocess.run(program, cwd=place, env=settings, capture_output=True, text=True, timeout=120, check=False)


def test_the_page_names_every_package_that_a_site_lacks() -> None:
    needed = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    line = re.search(r"--no-deps \. && pip install (.*)", (ROOT / "docs" / "start" / "installing.md").read_text())
    assert line
    assert set(line[1].split()) == {name.split("==")[0] for name in needed} - OF_THE_SITE


def test_all_extras_are_one_and_installed_by_the_first_command() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    extras = project["project"]["optional-dependencies"]
    (everything,) = extras["all"]
    assert everything == f"hpcinv[{','.join(sorted(extras.keys() - {'all', 'checkpoints'}))}]"
    assert "hpcinv[all,checkpoints]" in project["dependency-groups"]["dev"]


@pytest.mark.parametrize("module", ["vtkmodules.util", "pyvista"])
def test_a_missing_extra_is_one_message_with_its_command(module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    packages, extras = ("pyvista==0.49.1", "vtk==9.7.2"), ("all", "vtk")
    lines = [f"{package}; extra == '{extra}'" for package in packages for extra in extras]
    lines += ["numpy==2.4.6", "lib3mf==2.5.0; extra == 'all'"]
    monkeypatch.setattr("importlib.metadata.requires", lambda name: lines)
    with pytest.raises(SystemPartMissing) as caught, imports_explained():
        raise ModuleNotFoundError(f"No module named '{module}'", name=module)
    package = module.partition(".")[0]
    assert caught.value.message == f"{package} cannot be imported: No module named '{module}'"
    assert caught.value.advice == "Install it by: pip install 'hpcinv[vtk]'"
    assert caught.value.exit_code == 5


def test_messages_name_extras_instead_of_their_packages() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    packages = {line.partition("==")[0] for name, lines in extras.items() if name != "checkpoints" for line in lines}
    text = "\n".join(path.read_text() for path in sorted((ROOT / "hpcinv").rglob("*.py")))
    named = re.findall(r"pip install '?([\w.-]+)(?:\[(\w+)\])?", text)
    assert {extra for _, extra in named if extra} >= {"imaging", "tables", "vtk", "posterior"}
    assert {extra for _, extra in named if extra} <= extras.keys()
    assert not packages & {name for name, _ in named}


def test_dependencies_can_be_installed_by_pip_alone() -> None:
    """adios4dolfinx asks for a package that no index has: the page installs it by a line of its own."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert not any(name.startswith("adios4dolfinx") for name in project["dependencies"])
    (pinned,) = project["optional-dependencies"]["checkpoints"]
    name, _, release = pinned.partition("==")
    line = re.search(r"pip install --no-deps '(.*)\.\*'", (ROOT / "docs" / "start" / "installing.md").read_text())
    assert line
    assert line[1] == f"{name}=={DOLFINX}"
    assert release.startswith(DOLFINX)


@pytest.mark.parametrize(
    ("file", "line"),
    [
        ("CITATION.cff", "version: {}"),
        ("codemeta.json", '  "version": "{}",'),
        ("containers/conda/recipe.yaml", '  version: "{}"'),
    ],
)
def test_the_version_is_the_same_in_each_file(file: str, line: str) -> None:
    assert line.format(__version__) in (ROOT / file).read_text().splitlines()


def uv(*arguments: str, directory: Path) -> subprocess.CompletedProcess[str]:
    """Run uv without the environment of the tests; skip the test if it is missing."""
    program = os.environ.get("UV") or shutil.which("uv")  # the first under "uv run"
    if not program:
        pytest.skip("needs uv")
    bare = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    return subprocess.run([program, *arguments], cwd=directory, env=bare, capture_output=True, text=True, check=False)


@pytest.mark.release
@pytest.mark.parametrize("version", ["3.12", "3.13"])
def test_the_wheel_alone_runs_a_job_in_a_bare_python(version: str, tmp_path: Path) -> None:
    """Without extras or a clone; several minutes where the packages are not in uv's cache."""
    python = interpreter(version, tmp_path)
    built = uv("build", "--python", python, "--wheel", "--out-dir", str(tmp_path), str(ROOT), directory=tmp_path)
    assert built.returncode == 0, built.stderr
    (wheel,) = tmp_path.glob("*.whl")
    start = ("tool", "run", "--python", python, "--from", str(wheel), "hpcinv")
    write_job(tmp_path / "column.yaml", COLUMN)
    ended = uv(*start, "run", "column.yaml", directory=tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert "certificate: pass" in ended.stdout
    for line in ("new part part.yaml", "run part.yaml --certificate off"):
        ended = uv(*start, *line.split(), directory=tmp_path)
        assert ended.returncode == 0, ended.stderr
    assert str(ROOT) not in (tmp_path / "part.yaml").read_text()
    assert (tmp_path / "results" / "part" / "shape.msh").is_file()


def interpreter(version: str, directory: Path) -> str:
    """Return a Python that is not of an environment, from uv, the path or pyenv; skip the test if there is none."""
    found = uv("python", "find", "--no-project", "--system", "--no-python-downloads", version, directory=directory)
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    of_pyenv = sorted(pyenv.glob(f"{version}.*/bin/python"))
    if found.returncode and not of_pyenv:
        pytest.skip(f"needs Python {version}")
    return str(of_pyenv[-1]) if found.returncode else found.stdout.strip()


RENDER = """
import json, sys
from rattler_build import Stage0Recipe, VariantConfig

(variant,) = Stage0Recipe.from_file(sys.argv[1]).render(VariantConfig({"python": ["3.12.* *_cpython"]}))
json.dump(variant.recipe.to_dict(), sys.stdout)
"""


@pytest.mark.release
def test_rattler_build_renders_the_recipe_of_conda(tmp_path: Path) -> None:
    """A build needs packages of conda-forge; rendering does not."""
    (tmp_path / "render.py").write_text(RENDER)
    start = ("run", "--no-project", "--isolated", "--python", "3.12", "--with", "py-rattler-build==0.73.0")
    done = uv(*start, "python", "render.py", str(RECIPE), directory=tmp_path)
    assert done.returncode == 0, done.stderr
    rendered = json.loads(done.stdout)
    assert rendered["package"] == {"name": "hpcinv", "version": __version__}
    assert rendered["build"]["noarch"] == "python"
    assert set(IN_CONDA.values()) <= {line.split()[0] for line in rendered["requirements"]["run"]}
    assert all((ROOT / name).is_file() for name in rendered["about"]["license_file"])
    assert (RECIPE.parent / rendered["source"][0]["path"]).resolve() == ROOT


def test_the_recipe_of_conda_has_all_dependencies_by_their_names_there() -> None:
    recipe = yaml.safe_load(RECIPE.read_text())
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    needed = {line.partition("==")[0] for line in project["project"]["dependencies"]}
    named = {line.split()[0] for line in recipe["requirements"]["run"]}
    assert {IN_CONDA.get(name, name) for name in needed} <= named
    backend = {line.partition("==")[0] for line in project["build-system"]["requires"]}
    assert backend <= {line.split()[0] for line in recipe["requirements"]["host"]}
