"""What a user sees of an error: one message from one rank, an exit code, and nothing left behind or hanging."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from helpers.command_line import BLOCK, CUBE, NO_CERTIFICATE, ROOT, environment, hpcinv, hpcinv_here, write_job

import hpcinv as api
from hpcinv.__main__ import main
from hpcinv.base.parallel.runtime import MPI

UNREACHABLE: dict[str, Any] = {"solver": {"strategy": "fixed", "steps": 2, "maximum_iterations": 1}}

# Something goes wrong on rank 1 alone, while rank 0 waits for it.
ON_RANK_1 = """
import sys
from hpcinv.base.parallel import runtime
from hpcinv.errors import MeshError
from hpcinv.solver.equations import Equations
from hpcinv.__main__ main

steps = Equations.steps

def fail(self):
    if runtime.MPI.COMM_WORLD.rank == 1:
        {action}
    return steps.fget(self)

Equations.steps = property(fail)
sys.exit(main())
""".replace("hpcinv.__main__ main", "hpcinv.__main__ import main")


@pytest.fixture
def cube(run_directory: Path) -> Path:
    return write_job(run_directory / "cube.yaml", CUBE)


def files_in(directory: Path) -> set[str]:
    return {str(p.relative_to(directory)) for p in directory.rglob("*")}


def refused(done: subprocess.CompletedProcess[str], code: int, *texts: str) -> None:
    """It ended with this code, and each text stands once in a message without a traceback."""
    assert done.returncode == code, done.stdout + done.stderr
    for text in texts:
        assert done.stderr.count(text) == 1, done.stderr
    assert "Traceback" not in done.stderr
    assert "Traceback" not in done.stdout


@pytest.mark.parallel([1, 3])
def test_every_error_in_a_job_is_reported_once_and_nothing_is_left(run_directory: Path) -> None:
    write_job(
        run_directory / "wrong.yaml",
        CUBE,
        mesh={"file": "no-such-mesh.msh"},
        material={"law": "neohookean", "young": 1e6, "poisson": 0.3},
    )
    before = files_in(run_directory)
    done = hpcinv_here("run", "wrong.yaml", cwd=run_directory)
    refused(done, 2, "wrong.yaml: mesh.file: there is no file", "wrong.yaml: material.law: ", "neo-hookean'?")
    assert files_in(run_directory) == before


@pytest.mark.parallel([2])
def test_a_job_that_is_not_there_is_reported(run_directory: Path) -> None:
    refused(hpcinv_here("run", "nowhere.yaml", cwd=run_directory), 2, "nowhere.yaml")
    assert files_in(run_directory) == set()


@pytest.mark.parallel([3])
def test_a_region_that_matches_nothing_is_reported_before_anything_is_written(run_directory: Path) -> None:
    supports = [{"region": "clamp", "fix": ["x", "y", "z"]}]
    write_job(run_directory / "job.yaml", CUBE, regions={"clamp": "x < -1 m"}, supports=supports)
    refused(hpcinv_here("run", "job.yaml", "--output", "out", cwd=run_directory), 2, "'clamp'")
    assert files_in(run_directory) == {"job.yaml"}


def test_results_go_to_the_first_free_place_and_no_other_run_is_touched(cube: Path, tmp_path: Path) -> None:
    for name in ("cube", "cube-2"):
        done = hpcinv_here("run", "cube.yaml", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert f"results in results/{name}\n" in done.stdout
    run = tmp_path / "results" / "cube"
    assert {p.name for p in run.iterdir()} == {
        "checkpoints",
        "fields",
        "surface.npz",
        "interior.npz",
        "job.yaml",
        "origin.json",
        "run.log",
        "shape.msh",
        "shape.vtu",
        "summary.h5",
        "summary.json",
    }
    (run / "notes.txt").write_text("mine")
    before = {p: p.read_bytes() for p in run.rglob("*") if p.is_file()}

    refused(hpcinv_here("run", cube, "--output", run, cwd=tmp_path), 2, "holds the results of another run")
    wrong = write_job(tmp_path / "wrong.yaml", CUBE, supports=[])
    refused(hpcinv_here("run", wrong, "--output", run, "--overwrite", cwd=tmp_path), 2, "supports")
    assert {p: p.read_bytes() for p in run.rglob("*") if p.is_file()} == before

    changed = write_job(cube, CUBE, output={"mesh": ["vtu"], "fields": False})
    done = hpcinv_here("run", changed, "--overwrite", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "results in results/cube\n" in done.stdout
    assert {p.name for p in run.iterdir()} >= {"shape.vtu", "summary.json", "notes.txt"}
    assert not (run / "shape.msh").exists()
    assert not (run / "fields").exists()


def test_overwrite_never_removes_what_is_not_of_a_run(cube: Path, tmp_path: Path) -> None:
    valuable = tmp_path / "home" / "thesis.tex"
    valuable.parent.mkdir()
    valuable.write_text("years of work")
    done = hpcinv_here("run", cube, "--output", valuable.parent, "--overwrite", cwd=tmp_path)
    refused(done, 2, "holds files that are not of a run")
    assert valuable.read_text() == "years of work"


@pytest.mark.parallel([2])
def test_an_output_that_cannot_be_a_directory_is_reported(cube: Path, run_directory: Path) -> None:
    (run_directory / "file").write_text("")
    refused(hpcinv_here("run", cube, "--output", "file", cwd=run_directory), 2, "file: is a file")
    refused(hpcinv_here("run", cube, "--output", "file/run", cwd=run_directory), 2, "cannot be written")


def test_a_full_disk_is_reported(tmp_path: Path) -> None:
    """A limit on the size of files stands for it; two ranks: in `test_checkpoints_on_full_disks.py`."""
    job = write_job(tmp_path / "job.yaml", CUBE, mesh=CUBE["mesh"] | {"parameters": {"nx": 3, "ny": 3, "nz": 3}})
    script = tmp_path / "limited.py"
    script.write_text(
        "import resource, sys\n"
        "from hpcinv import driver\nfrom hpcinv.__main__ import main\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000))\n"
        "sys.exit(main())\n"
    )
    env = {"PYTHONDONTWRITEBYTECODE": "1"}  # or Python would keep byte code that is cut off
    done = hpcinv(1, "run", job, "--output", "out", cwd=tmp_path, script=script, **env)
    assert done.returncode == 2, done.stdout + done.stderr
    assert "cannot be written" in done.stderr
    assert "Make room there" in done.stderr
    assert not (tmp_path / "out" / "checkpoints" / "0001").exists()


@pytest.mark.parallel([2])
def test_another_number_of_ranks_than_asked_for_is_reported(cube: Path, run_directory: Path) -> None:
    refused(
        hpcinv_here("run", cube, "--ranks", 3, cwd=run_directory),
        2,
        "--ranks 3 was requested, but the launcher started 2",
    )
    assert not (run_directory / "results").exists()


@pytest.mark.parallel([2])
def test_directories_without_a_run_cannot_be_resumed(run_directory: Path) -> None:
    refused(hpcinv_here("resume", ".", cwd=run_directory), 2, "is not the directory of a run")


@pytest.mark.parallel([2])
def test_a_load_that_is_not_reached_ends_with_a_diagnosis(run_directory: Path) -> None:
    write_job(run_directory / "job.yaml", CUBE, **UNREACHABLE)
    done = hpcinv_here("run", "job.yaml", "--output", "out", cwd=run_directory)
    refused(done, 3, "stopped at load factor 0 of 1: Newton's method took too many iterations", "Raise solver.max")
    summary = json.loads((run_directory / "out" / "summary.json").read_text())
    assert summary["status"] == "Newton's method took too many iterations"
    assert [s["outcome"] for s in summary["solutions"][0]["solves"]] == ["ITERATION_LIMIT"]
    # A resume with better settings reaches it.
    write_job(run_directory / "better.yaml", CUBE)
    done = hpcinv_here("resume", "out", "--job", "better.yaml", cwd=run_directory)
    assert done.returncode == 0, done.stderr
    assert json.loads((run_directory / "out" / "summary.json").read_text())["status"] == "converged"


@pytest.mark.everyday("MeshError")  # and, of a failure that nobody expects, the test below
@pytest.mark.parametrize(
    ("action", "code", "text"),
    [
        ("raise ZeroDivisionError('on one rank')", 1, "ZeroDivisionError: on one rank"),
        ("sys.exit(0)", 1, "SystemExit"),
        ("raise MeshError('on one rank')", 2, "[rank 1] on one rank"),
    ],
)
def test_failure_on_one_rank_ends_all_within_seconds(
    action: str, code: int, text: str, cube: Path, tmp_path: Path
) -> None:
    script = tmp_path / "script.py"
    script.write_text(ON_RANK_1.format(action=action))
    begin = time.monotonic()
    done = hpcinv(2, "run", cube, cwd=tmp_path, script=script)
    assert time.monotonic() - begin < 30
    assert done.returncode == code, done.stderr
    assert text in done.stderr


def test_failure_in_a_task_of_rank_0_ends_all(cube: Path, tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "import sys\nimport hpcinv.cli.run\nfrom hpcinv.__main__ import main\n"
        "hpcinv.cli.run.load = lambda path: sys.exit('rank 0 has gone')\n"
        "sys.exit(main())\n"
    )
    done = hpcinv(2, "run", cube, cwd=tmp_path, script=script)
    assert done.returncode == 1, done.stderr
    assert done.stderr.count("SystemExit: rank 0 has gone\n") == 1


NO_COMPILER = {"PATH": str(Path(sys.executable).parent), "CC": ""}  # nothing else is found there
BROKEN_COMPILER = {"CC": "false"}


@pytest.mark.everyday("broken")
@pytest.mark.parametrize(
    ("ranks", "analysis", "compiler", "said"),
    [(2, "inverse", NO_COMPILER, "no C compiler 'cc'"), (1, "forward", BROKEN_COMPILER, "'false' could not compile")],
    ids=["none", "broken"],
)
def test_without_a_compiler_or_a_cache_the_run_is_the_same(
    tmp_path: Path, ranks: int, analysis: str, compiler: dict[str, str], said: str
) -> None:
    """Nobody can make a directory in /proc, so that no program is kept either."""
    small = {**BLOCK["mesh"], "parameters": {"nx": 1, "ny": 1, "nz": 1}}
    write_job(tmp_path / "job.yaml", BLOCK, analysis=analysis, mesh=small)
    assert hpcinv_here("run", "job.yaml", "--output", "with", cwd=tmp_path).returncode == 0
    nowhere = {"XDG_CACHE_HOME": "/proc/none", "HOME": "/proc/none"}
    done = hpcinv(ranks, "run", "job.yaml", "--output", "without", cwd=tmp_path, **compiler, **nowhere)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count(": NumPy evaluates laws and loads, which takes longer (docs/how-to/start-up.md)") == 1
    assert said in done.stdout.splitlines()[0]
    expected, found = (
        json.loads((tmp_path / name / "summary.json").read_text())["quantities"]["top"] for name in ("with", "without")
    )
    assert found == pytest.approx(expected, rel=1e-12)


@pytest.mark.parallel([1, 2])
def test_too_low_a_quadrature_is_reported_once_and_nothing_is_left(run_directory: Path) -> None:
    mesh = {**CUBE["mesh"], "parameters": {"nx": 1, "ny": 1, "nz": 1, "hexahedra": True}}
    write_job(run_directory / "job.yaml", CUBE, mesh=mesh, discretisation={"quadrature": 3})
    refused(
        hpcinv_here("run", "job.yaml", cwd=run_directory),
        2,
        "job.yaml: discretisation.quadrature: must be at least 4 on hexahedra of degree 2, not 3, or ",
    )
    assert files_in(run_directory) == {"job.yaml"}


@pytest.mark.release
@pytest.mark.parallel([2])
def test_options_that_petsc_does_not_know_are_reported(run_directory: Path) -> None:
    petsc = {"snes_linesearch_type": "l2", "snes_lineserch_type": "l2"}
    write_job(run_directory / "job.yaml", CUBE, solver={"petsc": petsc})
    done = hpcinv_here("run", "job.yaml", "--output", "out", cwd=run_directory)
    assert done.returncode == 0, done.stderr
    assert "solver.petsc: nothing asked for snes_lineserch_type:" in done.stdout
    summary = json.loads((run_directory / "out" / "summary.json").read_text())
    assert summary["unused_petsc_options"] == ["snes_lineserch_type"]


def python(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *arguments], cwd=ROOT, env=environment(), capture_output=True, text=True, check=False
    )


@pytest.mark.everyday("few")
@pytest.mark.parametrize("count", [4, 1000], ids=["few", "all"])
def test_checking_shipped_jobs_loads_neither_mpi_nor_the_solver(count: int) -> None:
    """Few of them, from all over the alphabet, each day: tests/unit/test_job.py checks all, within this process.

    Without the one of ten thousand cases. A CAD file, whose faces are listed, needs what reads meshes.
    """
    left_out = ("paper-monte-carlo.yaml", "mount.yaml")
    jobs = [str(p) for p in sorted((ROOT / "jobs").glob("*.yaml")) if p.name not in left_out]
    jobs = jobs[1 :: len(jobs) // count] if count < len(jobs) else jobs
    code = (
        f"import sys; from hpcinv.__main__ import main; c = main(['validate', *{jobs}]); print(*sys.modules); exit(c)"
    )
    done = python("-c", code)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count(": valid\n") == len(jobs)
    assert not {"mpi4py", "petsc4py", "dolfinx", "dolfinx_solver", "gmsh", "ufl"} & set(done.stdout.split())


@pytest.mark.release
def test_validate_goes_on_after_a_wrong_job(tmp_path: Path) -> None:
    wrong = write_job(tmp_path / "wrong.yaml", CUBE, supports=[])
    done = python("-m", "hpcinv", "validate", str(wrong), "jobs/pdms-beam.yaml")
    refused(done, 2, "wrong.yaml: supports: ")
    assert "jobs/pdms-beam.yaml: valid" in done.stdout


@pytest.mark.release
def test_a_command_that_does_not_exist_ends_with_2() -> None:
    assert python("-m", "hpcinv", "fly").returncode == 2


@pytest.mark.parametrize(
    ("typed", "completed"),
    [
        ("va", "validate"),
        ("run ''", ""),  # names of files
        ("run --strict --cer", "--certificate"),
        ("run job.yaml --certificate f", "full"),
        ("sweep st", "status statistics"),
        ("mesh gather --un", "--untrusted"),
    ],
)
def test_bash_completes_commands_options_and_choices(typed: str, completed: str, script: str) -> None:
    begin = f"{script}\nCOMP_WORDS=(hpcinv {typed}); COMP_CWORD=$((${{#COMP_WORDS[*]}} - 1)); _hpcinv"
    done = subprocess.run(
        ["bash", "-c", f'{begin}; echo "${{COMPREPLY[*]}}"'], capture_output=True, text=True, check=True
    )
    assert done.stdout == f"{completed}\n"
    assert not done.stderr


@pytest.fixture(scope="module")
def script() -> str:
    return python("-m", "hpcinv", "completion").stdout


@pytest.mark.parametrize(
    ("typed", "usage", "error"),
    [
        (["run", "--strct", "job.yaml"], "run", "unrecognized arguments: --strct. Did you mean '--strict'?"),
        (["run", "--fast", "job.yaml"], "run", "unrecognized arguments: --fast"),
        (["run", "job.yaml", "other.yaml"], "run", "unrecognized arguments: other.yaml"),
        (
            ["mesh", "partition", "a.msh", "b.bp", "--parts=2", "--units=mm"],
            "mesh partition",
            "unrecognized arguments: --units=mm. Did you mean '--unit'?",
        ),
    ],
)
def test_unknown_options_are_refused_with_the_usage_of_the_command(
    typed: list[str], usage: str, error: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(typed)
    assert ended.value.code == 2
    printed = capsys.readouterr().err
    assert printed.startswith(f"usage: hpcinv {usage} [-h]")
    assert printed.endswith(f"\nhpcinv {usage}: error: {error}\n")


def test_without_a_command_all_are_listed() -> None:
    refused(python("-m", "hpcinv"), 2, "check job, study and sweep files")


def test_from_python_a_run_gives_its_result_and_writes_nothing(
    cube: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    result = api.run(api.load(cube), MPI.COMM_SELF, progress=False)
    assert result.statistics["status"] == "converged"
    assert result.statistics["solutions"][0]["factorizations"] == result.solutions[0].factorizations > 0
    assert result.directory is None
    assert files_in(tmp_path) == {"cube.yaml"}
    assert capsys.readouterr().out == ""


@pytest.mark.everyday("certificate1")
@pytest.mark.parametrize("certificate", [NO_CERTIFICATE, {}])
def test_a_quantity_that_is_not_finite_costs_no_run_its_results(certificate: dict[str, Any], tmp_path: Path) -> None:
    quantities = [
        {"name": "bad", "of": "1/(ux-ux)", "on": "block", "reduce": "mean"},
        {"name": "pole", "of": "1/x", "at": [0, 0, 1]},
        *BLOCK["quantities"],
    ]
    sensitivities = {"effects[0].density": {"sd": 1}}
    job = write_job(
        tmp_path / "job.yaml", BLOCK, quantities=quantities, certificate=certificate, sensitivities=sensitivities
    )
    ended = hpcinv_here("run", job, "--output", "out", "--report", cwd=tmp_path)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert "warning: quantities without a finite value 2" in ended.stdout
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["quantities"]["bad"] is summary["quantities"]["pole"] is None
    assert summary["quantities"]["top"] < 0
    (line,) = [
        entry for entry in summary["certificate"]["lines"] if entry["name"] == "quantities without a finite value"
    ]
    assert "bad: '1/(ux-ux)' has no finite value somewhere on 'block'; pole: '1/x' has no finite value" in line["note"]


@pytest.mark.parallel([2])
def test_a_body_that_a_contact_does_not_hold_is_reported_with_file_and_state(run_directory: Path) -> None:
    """An obstacle holds the body along its normal in a forward solve; an inverse one knows the pressure alone."""
    obstacle = {"shape": "plane", "point": [0, 0, 1], "normal": [0, 0, -1]}
    layer = {"effect": "contact", "region": "z1", "stiffness": "1 kPa/mm", "stand_off": "1 mm", "obstacle": obstacle}
    states = [{"name": "cast", "given": True, "effects": [layer]}, {"name": "free"}]
    data = {key: BLOCK[key] for key in ("mesh", "material")} | {"states": states}
    supports = [{"region": "x0", "fix": ["x"]}, {"region": "y0", "fix": ["y"]}]
    write_job(run_directory / "job.yaml", data, supports=supports)
    ended = hpcinv_here("run", "job.yaml", cwd=run_directory)
    assert ended.returncode == 2
    assert ended.stderr.count("job.yaml: in state 'cast': supports: leave the body free to move along z") == 1
    assert "Traceback" not in ended.stderr
