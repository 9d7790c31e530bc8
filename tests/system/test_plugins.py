"""Laws and effects from outside the package: a Python file next to the job, or an installed package's entry point."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from helpers.command_line import ROOT, hpcinv, hpcinv_here, write_job

PLUGIN = """
from typing import Any, ClassVar, Literal

from hpcinv.physics.effects import Effect
from hpcinv.physics.materials.isochoric import IsochoricLaw
from hpcinv.base.quantity import Acceleration, DensityField, ModulusField, Triple


class Gel(IsochoricLaw):
    '''A gel.'''

    formula = "mu/2*(I1_bar - 3)"
    example: ClassVar = {"law": "gel", "mu": "1 kPa", "kappa": "3 kPa"}

    law: Literal["gel"] = "gel"
    mu: ModulusField

    def shear_modulus(self, par: Any) -> Any:
        return par.mu


class Tide(Effect):
    '''A pull that differs from place to place.'''

    example: ClassVar = {"effect": "tide", "pull": [0, 0, 1], "density": 1}

    effect: Literal["tide"] = "tide"
    pull: Triple[Acceleration]
    density: DensityField

    def virtual_work(self, k: Any, v: Any, load: Any, par: Any) -> Any:
        return k.dV(load * par.density * sum(g * v[i] for i, g in enumerate(par.pull)))
"""
BUILT_IN: Mapping[str, Any] = {
    "job": "block",
    "mesh": {"file": str(ROOT / "meshes" / "box.py"), "parameters": {"nx": 2, "ny": 2, "nz": 2}},
    "material": {"law": "isochoric-neo-hookean", "mu": "5 kPa*(1 + X/(1 m))", "kappa": "9 kPa"},
    "effects": [{"effect": "gravity", "acceleration": [0, 0, -1], "density": "1 g/cm^3"}],
    "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
    "discretisation": {"formulation": "displacement", "displacement": 1},
    "certificate": {"estimate": False},  # a coarse body is enough here
    "solver": {"strategy": "fixed", "steps": 2},
    "quantities": [{"name": "droop", "of": "uz", "on": "x1", "reduce": "mean"}],
    "output": {"mesh": ["msh"], "fields": False},
}
OWN = {
    "material": dict(BUILT_IN["material"]) | {"law": "gel"},
    "effects": [{"effect": "tide", "pull": [0, 0, -1], "density": "1 g/cm^3"}],
}


def droop(run: Path) -> float:
    value: float = json.loads((run / "summary.json").read_text())["quantities"]["droop"]
    return value


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> float:
    """What the built-in law and effect give."""
    place = tmp_path_factory.mktemp("built-in")
    done = hpcinv_here("run", write_job(place / "job.yaml", BUILT_IN), "--output", "run", cwd=place)
    assert done.returncode == 0, done.stderr
    assert droop(place / "run") < -0.05
    return droop(place / "run")


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A directory with a plugin, a job next to it that uses it, and a place to run from."""
    for name in ("jobs", "laws", "elsewhere"):
        (tmp_path / name).mkdir()
    (tmp_path / "laws" / "gel.py").write_text(PLUGIN)
    write_job(tmp_path / "jobs" / "gel.yaml", BUILT_IN, **OWN, plugins=["../laws/gel.py"])
    return tmp_path


@pytest.mark.release
def test_a_file_next_to_the_job_serves_all_ranks_and_a_resume(project: Path, expected: float) -> None:
    place = project / "elsewhere"
    done = hpcinv(2, "run", "../jobs/gel.yaml", "--output", "run", cwd=place)
    assert done.returncode == 0, done.stderr
    run = place / "run"
    print(f"own law and effect: {droop(run)} m, built-in ones: {expected} m")
    assert droop(run) == pytest.approx(expected, rel=1e-11)

    # As it was half-way.
    newest = max((run / "checkpoints").iterdir())
    assert json.loads((newest / "state.json").read_text())["position"]["load"] == 1.0
    shutil.rmtree(newest)
    (run / "summary.json").unlink()
    done = hpcinv(1, "resume", "run", cwd=place)
    assert done.returncode == 0, done.stderr
    assert "at load factor 0.5" in done.stdout
    assert droop(run) == pytest.approx(expected, rel=1e-11)


@pytest.mark.release
def test_another_law_under_the_same_name_is_another_problem(project: Path) -> None:
    done = hpcinv(1, "run", project / "jobs" / "gel.yaml", "--output", "run", cwd=project)
    assert done.returncode == 0, done.stderr
    (project / "run" / "summary.json").unlink()
    (project / "laws" / "gel.py").write_text(PLUGIN.replace("mu/2*", "mu/3*"))
    done = hpcinv(1, "resume", "run", cwd=project)
    assert done.returncode == 4, done.stderr
    assert "plugins[0]: " in done.stderr


@pytest.mark.release
def test_a_job_with_plugins_comes_back_from_json_pickle_and_its_run_directory(project: Path) -> None:
    """In a process of its own: what a plugin defines stays for as long as the process."""
    script = project / "there_and_back.py"
    script.write_text(f"""
import json, pickle, subprocess, sys
from pathlib import Path
import hpcinv
from hpcinv.job.job import parse
from hpcinv.output.run_directory import RunDirectory

if len(sys.argv) > 1:  # as another rank, which has not read the job
    copy = pickle.loads(Path(sys.argv[1]).read_bytes())
    print(type(copy.material).__name__, copy.effects[0].effect, copy.path)
    sys.exit()
job = hpcinv.load(Path({str(project)!r}) / "jobs" / "gel.yaml")
plain = json.loads(json.dumps(job.model_dump(mode="json", exclude_unset=True)))
directory = RunDirectory(Path("run"))
directory.create(job, overwrite=False)
print(parse(plain, job.path) == job, pickle.loads(pickle.dumps(job)) == job, directory.job(None) == job)
Path("pickled").write_bytes(pickle.dumps(job))
subprocess.run([sys.executable, __file__, "pickled"], check=True)
""")
    done = hpcinv(1, cwd=project / "elsewhere", script=script)
    assert done.returncode == 0, done.stderr
    there, elsewhere = sorted(done.stdout.splitlines())
    assert there == f"Gel tide {project / 'jobs' / 'gel.yaml'}"
    assert elsewhere == "True True True"


FAULTS: dict[str, tuple[str, str]] = {
    "syntax": ("class Gel(:\n", r"SyntaxError: invalid syntax \(gel.py, line 1\)"),
    "import": (
        "\nimport nothing_of_that_name\n",
        r"ModuleNotFoundError: No module .*'nothing_of_that_name' \(line 2\)",
    ),
    "code": ("def f():\n    return 1/0\n\nf()\n", r"ZeroDivisionError: division by zero \(line 2\)"),
    "exit": ("raise SystemExit(3)\n", r"SystemExit: 3 \(line 1\)"),
}


def test_faults_in_a_plugin_file_are_reported_with_their_line(project: Path) -> None:
    expected = []
    for name, (text, message) in FAULTS.items():
        (project / "laws" / name).mkdir()
        plugin = project / "laws" / name / "gel.py"
        plugin.write_text(text)
        job = write_job(project / "jobs" / f"{name}.yaml", BUILT_IN, plugins=[f"../laws/{name}/gel.py"])
        expected.append((job, rf"'{re.escape(str(plugin))}' cannot be imported: {message}"))
    for name, plugin_file, message in (
        ("gone", "../laws/gell.py", "there is no file '"),
        ("yaml", "gel.yaml", "'gel.yaml' is not a Python file"),
    ):
        expected.append((write_job(project / "jobs" / f"{name}.yaml", BUILT_IN, plugins=[plugin_file]), message))
    done = hpcinv(1, "validate", *(job for job, _ in expected), cwd=project)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    for job, message in expected:
        (line,) = (line for line in done.stderr.splitlines() if line.startswith(f"{job}: "))
        assert re.match(rf"{re.escape(str(job))}: plugins\[0\]: {message}", line), line


@pytest.mark.release
def test_plugin_fault_is_reported_once_on_two_ranks(project: Path) -> None:
    (project / "laws" / "gel.py").write_text("import nothing_of_that_name\n")
    done = hpcinv(2, "run", "jobs/gel.yaml", cwd=project)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert done.stderr.count("ModuleNotFoundError") == 1
    assert not (project / "results").exists()


def test_a_name_that_is_taken_is_reported_with_both_files(project: Path) -> None:
    (project / "laws" / "gel.py").write_text(PLUGIN.replace('"gel"', '"neo-hookean"'))
    done = hpcinv(1, "validate", "jobs/gel.yaml", cwd=project)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert "jobs/gel.yaml: material: " in done.stderr
    assert "neo_hookean.py" in done.stderr
    assert f"Gel ({project / 'laws' / 'gel.py'})" in done.stderr
    assert "have the same law 'neo-hookean'; rename one of them" in done.stderr


# installed packages


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """What pip makes of a package with an entry point."""
    site = tmp_path / "site"
    metadata = site / "gels-1.0.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: gels\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text("[hpcinv.plugins]\ngel = gel_laws\n")
    (site / "gel_laws.py").write_text(PLUGIN)
    return site


def test_an_installed_package_adds_laws_and_effects_to_every_job(site: Path, tmp_path: Path, expected: float) -> None:
    path = f"{site}:{ROOT}"
    file = write_job(tmp_path / "job.yaml", BUILT_IN, **OWN)
    assert hpcinv(1, "validate", file, cwd=tmp_path).returncode == 2  # it is not installed there
    done = hpcinv(1, "run", file, "--output", "run", cwd=tmp_path, PYTHONPATH=path)
    assert done.returncode == 0, done.stderr
    assert droop(tmp_path / "run") == pytest.approx(expected, rel=1e-11)
    listed = hpcinv(1, "laws", cwd=tmp_path, PYTHONPATH=path)
    assert re.search(r"^\s*gel\b.*A gel", listed.stdout, re.MULTILINE), listed.stdout


def test_an_installed_package_that_fails_is_named(site: Path, tmp_path: Path) -> None:
    (site / "gel_laws.py").write_text("import nothing_of_that_name\n")
    file = write_job(tmp_path / "job.yaml", BUILT_IN)
    for command in (("validate", file), ("laws",)):
        done = hpcinv(1, *command, cwd=tmp_path, PYTHONPATH=f"{site}:{ROOT}")
        assert done.returncode == 2, done.stderr
        assert "Traceback" not in done.stderr
        assert "the installed plugin 'gel' of the package 'gels' cannot be imported: ModuleNotFoundError" in done.stderr
