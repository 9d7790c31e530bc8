"""Environments other than a user's terminal: services, containers, launchers of another MPI."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.command_line import MPIRUN, ROOT, command, environment

TETRAHEDRON = ROOT / "jobs" / "single-tetrahedron.yaml"
OPEN_MPI = shutil.which("mpirun.openmpi")


def run(words: list[str], place: Path, *without: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run a command in an environment that lacks some variables."""
    settings = {name: value for name, value in environment(**variables).items() if name not in without}
    return subprocess.run(words, cwd=place, env=settings, capture_output=True, text=True, timeout=120, check=False)


def hpcinv(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "hpcinv", *map(str, arguments)]


def assert_refused(done: subprocess.CompletedProcess[str], code: int, *texts: str) -> None:
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    for text in texts:
        assert done.stderr.count(text) == 1, done.stderr


@pytest.mark.release
@pytest.mark.parametrize("home", [None, "/dev/null"])
def test_a_run_needs_no_home(home: str | None, tmp_path: Path) -> None:
    """ADIOS2, which writes checkpoints, ends the process where HOME is not set."""
    words = hpcinv("run", TETRAHEDRON, "--output", "results")
    done = run(words, tmp_path, "HOME") if home is None else run(words, tmp_path, HOME=home)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "results" / "summary.json").exists()


@pytest.mark.release
def test_options_of_dolfinx_that_cannot_be_read_do_not_matter(tmp_path: Path) -> None:
    (tmp_path / "dolfinx_jit_options.json").write_text("{")
    done = run(hpcinv("run", TETRAHEDRON, "--output", "results"), tmp_path, XDG_CONFIG_HOME="/dev/null")
    assert done.returncode == 0, done.stderr


def test_a_working_directory_that_was_removed_is_reported(tmp_path: Path) -> None:
    words = ["sh", "-c", 'mkdir gone; cd gone; rmdir ../gone; exec "$@"', "sh", *hpcinv("run", TETRAHEDRON)]
    assert_refused(run(words, tmp_path), 2, "the working directory cannot be used: No such file or directory")


@pytest.mark.everyday("1")
@pytest.mark.parametrize("ranks", [1, 2])
@pytest.mark.skipif(OPEN_MPI is None, reason="Open MPI is not installed (Debian's package openmpi-bin)")
def test_the_launcher_of_open_mpi_is_refused(ranks: int, tmp_path: Path) -> None:
    assert OPEN_MPI is not None
    launcher = [OPEN_MPI, "--allow-run-as-root", "--oversubscribe", "-n", str(ranks)]
    done = run([*launcher, *hpcinv("run", TETRAHEDRON, "--output", "results")], tmp_path)
    message = "Open MPI's mpirun speaks PMIx, which MPICH"
    assert_refused(done, 5, message, f"Start it by {MPIRUN}, or under Slurm by 'srun --mpi=pmi2'.")
    assert "Abort(" not in done.stderr
    assert not (tmp_path / "results").exists()


@pytest.mark.everyday("variables0-the launcher (PMIX_NAMESPACE is set)")
@pytest.mark.parametrize(
    ("variables", "launcher"),
    [({}, "the launcher (PMIX_NAMESPACE is set)"), ({"SLURM_JOB_ID": "7"}, "srun --mpi=pmix")],
)
def test_any_launcher_of_pmix_is_refused(variables: dict[str, str], launcher: str, tmp_path: Path) -> None:
    pmix = {"PMIX_NAMESPACE": "slurm.7.0", "PMIX_RANK": "0"}
    done = run(hpcinv("run", TETRAHEDRON, "--output", "results"), tmp_path, **pmix, **variables)
    assert_refused(done, 5, f"{launcher} speaks PMIx, which MPICH", "srun --mpi=pmi2")


def test_variables_of_pmix_around_the_right_launcher_do_not_matter(tmp_path: Path) -> None:
    words = command(2, "run", TETRAHEDRON, "--output", "results")
    done = run(words, tmp_path, PMIX_NAMESPACE="slurm.7.0", PMIX_RANK="0")
    assert done.returncode == 0, done.stderr
    assert "2 ranks" in done.stdout


@pytest.mark.release
def test_a_rank_that_ends_first_leaves_time_to_the_others(tmp_path: Path) -> None:
    """Without MPI_Finalize, mpiexec would kill the other ranks, and sometimes return 9 after a complete run."""
    script = tmp_path / "late.py"
    script.write_text(
        "import time\n"
        "from pathlib import Path\n"
        "from hpcinv.base.parallel.ranks import MPI\n"
        "if MPI.COMM_WORLD.rank == 1:\n"
        "    time.sleep(1.0)\n"
        "    Path('last.txt').write_text('written')\n"
    )
    ended = run(command(2, script=script), tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert (tmp_path / "last.txt").read_text() == "written"
