"""What a run says, and to whom."""

from __future__ import annotations

import contextlib
import fcntl
import io
import json
import os
import pty
import re
import struct
import subprocess
import termios
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from helpers.command_line import BLOCK, command, environment, hpcinv, hpcinv_here, write_job
from helpers.solutions import SOLVES

from hpcinv.output.progress import Level, Progress
from hpcinv.solver.linear.selection import Used
from hpcinv.solver.newton import NewtonIteration
from hpcinv.solver.observer import SolveEvent

DIRECT = Used("direct", "at 9 unknowns, multigrid would take about 2 times as long", None)

STATISTICS: dict[str, Any] = {
    "status": "converged",
    "solutions": [
        {
            "direction": "inverse",
            "factorizations": 4,
            "linear": None,
            "J": {"min": 0.9, "max": None},
            "strain_energy": 2e-3,
            "contacts": [],
        }
    ],
    "quantities": {"tip": [0.0, -0.1325, 1e-9], "roundness": 1.5e-6},
    "certificate": {
        "verdict": "warning",
        "lines": [
            {"name": "residual", "value": 1.234e-9, "unit": "", "verdict": "pass", "note": "", "seconds": 1.26},
            {
                "name": "overlap",
                "value": None,
                "unit": "",
                "verdict": "not checked",
                "note": "switched off",
                "seconds": 0.0,
            },
            {"name": "sag", "value": 0.5, "unit": "m", "verdict": "warning", "note": "much", "seconds": None},
        ],
        "estimate": {"quantities": {"tip": [1e-3, 0.0, 0.0]}},
    },
    "sensitivities": {
        "parameters": {"material.mu": {"value": 1e4, "sd": 1e3}},
        "quantities": {
            "tip": {"slopes": {"material.mu": [0.0, 2e-5, 0.0]}, "sd": [0.0, 0.02, 0.0]},
            "roundness": {"slopes": {"material.mu": -1e-9}, "sd": 1e-6},
        },
        "shape": {"largest": {"material.mu": 3e-5}, "sd": 0.03, "sd_at": [1.0, 0.0, 0.5]},
    },
    "unused_petsc_options": ["snes_tpye"],
    "timings": {
        "total": 12.34,
        "overhead": 0.083,
        "phases": {"tangent": {"min": 1.0, "max": 2.0}, "x": {"min": 0, "max": 0.01}},
    },
    "peak_memory": {"ranks": [250_000_000, 350_000_000], "phases": {"mesh": {"max": 3e8}, "newton": {"max": 3.5e8}}},
    "errors": {
        "expected_shape": {"max": 1.34e-14, "rms": 1e-15, "relative": 7.3e-14},
        "round_trip": {"max": 1e-12, "rms": 1e-13, "relative": 2e-12},
    },
}


def tell(progress: Progress) -> None:
    progress.begun("inverse", DIRECT)
    for solve in SOLVES:
        progress.solved(SolveEvent(solve, (), solve.load, True, 0.132456, 0.87654321))
    progress.finish(STATISTICS)


def rank(number: int) -> Any:
    """Communicator of one of two ranks."""
    return SimpleNamespace(rank=number, size=2)


def test_rank_0_prints_each_step_in_a_line_and_the_error_last() -> None:
    silent, stream = io.StringIO(), io.StringIO()
    for comm, to in ((rank(1), silent), (rank(0), stream)):
        with Progress(comm, to) as progress:
            tell(progress)
    assert silent.getvalue() == ""
    lines = stream.getvalue().splitlines()
    assert lines[0] == "inverse:"
    assert lines[1] == "  direct linear solver: at 9 unknowns, multigrid would take about 2 times as long"
    assert "not reached: an element would turn inside out" in lines[2]
    step = "  load 0.5: 2 iterations, 1 factorization, largest displacement 132.5 mm, det F^-1 > 0.8765, "
    assert lines[3].startswith(step)
    assert lines[4].startswith("  load 1: 2 iterations, 2 factorizations, ")
    assert lines[5] == "converged, 4 factorizations, 12.3 s"
    assert "  seconds: tangent 2.0" in lines
    assert "  memory: 350 MB on the fullest rank; most in newton" in lines
    assert "  inverse: J from 0.9 to not finite, strain energy 0.002 J" in lines
    at = lines.index("certificate: warning")
    assert lines[at + 1 : at + 4] == [
        "  pass: residual 1.23e-09, 1.3 s",
        "  not checked: overlap (switched off)",
        "  warning: sag 500 mm (much)",
    ]
    at = lines.index("roundness: 1.5e-06 (standard deviation 1e-06)")
    assert lines[at - 1 : at + 4] == [
        "tip: (0, -132.5, 1e-06) mm (estimated error (1, 0, 0) mm, standard deviation (0, 20, 0) mm)",
        "roundness: 1.5e-06 (standard deviation 1e-06)",
        "per SI unit of",
        "  material.mu: tip (0, 2e-05, 0) m, roundness -1e-09, shape up to 3e-05 m",
        "shape: standard deviation up to 30 mm, at (1, 0, 0.5) m",
    ]
    assert sum("snes_tpye" in line for line in lines) == 1
    assert lines[-1] == "recovered shape: 1.34e-05 nm from the expected one (7e-14 of its length)"
    assert lines[-2].startswith("round trip: closes to 0.001 nm")
    assert not any("\x1b" in line for line in lines)


def test_without_a_stream_nothing_is_printed(capfd: pytest.CaptureFixture[str]) -> None:
    with Progress(rank(0), None) as progress:
        progress.note("a note")
        tell(progress)
    assert capfd.readouterr() == ("", "")


def test_a_terminal_shows_a_bar_and_has_its_cursor_back_after_a_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    ours, theirs = pty.openpty()
    seen: list[bytes] = []
    reader = threading.Thread(target=read_to_the_end, args=(ours, seen))
    reader.start()  # a terminal holds only 4 kB that nobody has read
    with os.fdopen(theirs, "w") as terminal, contextlib.suppress(RuntimeError), Progress(rank(0), terminal) as progress:
        progress.begun("forward", DIRECT)
        progress.solved(SolveEvent(SOLVES[1], (), 0.5, True, 0.1, 0.9))
        raise RuntimeError
    reader.join()
    os.close(ours)
    shown = b"".join(seen).decode()
    assert "━" in shown
    assert "load 0.5: 2 iterations" in shown
    hidden, back = "\x1b[?25l", "\x1b[?25h"
    assert shown.rindex(back) > shown.rindex(hidden)


def read_to_the_end(terminal: int, seen: list[bytes]) -> None:
    """Reads what is written to a pseudo-terminal until its other side is closed, which Linux reports as an error."""
    with contextlib.suppress(OSError):
        while piece := os.read(terminal, 4096):
            seen.append(piece)


class Comm:
    """Of one rank."""

    rank, size = 0, 1

    def gather(self, value: object) -> list[object]:
        return [value]


def alone() -> Any:
    return Comm()


def go_through_phases(progress: Progress) -> None:
    with progress.phase("meshing", "body.py"):
        progress.detail("about 7 cells expected")
        progress.detail("6 cells")
    with progress.phase("programs"):
        pass
    with progress.phase("solving", announced=False):
        progress.begun("inverse", DIRECT)
        progress.iteration(NewtonIteration(0.5, 2.0, 1e-3, True))
    with progress.phase("checking"):
        progress.detail("stability")
        progress.warn("look at this")


def without_seconds(text: str) -> list[str]:
    return [re.sub(r"\d+\.\d s$", "0.0 s", line) for line in text.splitlines()]


def test_each_phase_is_a_line_that_grows_and_ends_with_its_time() -> None:
    stream = io.StringIO()
    with Progress(alone(), stream) as progress:
        with progress.phase("meshing", "body.py"):
            progress.detail("about 7 cells expected")
            assert stream.getvalue() == "meshing body.py: about 7 cells expected"  # there before it ends
        stream.truncate(0)
        stream.seek(0)
        go_through_phases(progress)
    assert without_seconds(stream.getvalue()) == [
        "meshing body.py: about 7 cells expected, 6 cells; 0.0 s",
        "programs: 0.0 s",
        "inverse:",
        "  direct linear solver: at 9 unknowns, multigrid would take about 2 times as long",
        "  solving: 0.0 s",
        "checking: stability",
        "warning: look at this",
        "  checking: 0.0 s",
    ]


def test_a_quiet_run_says_warnings_and_how_it_ended_and_a_verbose_one_every_iteration() -> None:
    for level, expected in (
        (
            Level.QUIET,
            ["warning: look at this", "  warning: sag 500 mm (much)", "converged, certificate warning, 12.3 s"],
        ),
        (Level.VERBOSE, ["    iteration: correction 0.5 of 2, residual 0.001, new tangent"]),
    ):
        stream = io.StringIO()
        with Progress(alone(), stream, level) as progress:
            go_through_phases(progress)
            progress.finish(STATISTICS)
        lines = stream.getvalue().splitlines()
        assert (lines if level is Level.QUIET else [line for line in lines if "iteration" in line]) == expected


def test_an_error_ends_the_line_of_its_phase() -> None:
    stream = io.StringIO()
    with contextlib.suppress(RuntimeError), Progress(alone(), stream) as progress, progress.phase("checking"):
        raise RuntimeError
    assert stream.getvalue() == "checking:\n"


def test_the_log_has_all_that_a_quiet_run_does_not_say_and_its_error(tmp_path: Path) -> None:
    for _ in range(2):  # the second time as a resume does
        with contextlib.suppress(RuntimeError), Progress(alone(), None, Level.QUIET) as progress:
            go_through_phases(progress)
            progress.open_log(alone(), tmp_path, "hpcinv 1.2.3")
            progress.finish(STATISTICS)
            raise RuntimeError("out of luck")
    text = (tmp_path / "run.log").read_text()
    assert all(re.match(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d ", line) for line in text.splitlines())
    for line in (
        "meshing body.py ...\n",
        "  6 cells\n",
        "programs: ",
        "iteration: correction 0.5 of 2",
        "hpcinv 1.2.3; 1 rank on ",
        "  pass: residual 1.23e-09, 1.3 s\n",
        "warning: look at this\n",
        "RuntimeError: out of luck\n",
    ):
        assert text.count(line) == 2, line


def test_a_log_that_cannot_be_written_does_not_end_the_run(tmp_path: Path) -> None:
    stream = io.StringIO()
    with Progress(alone(), stream) as progress:
        progress.open_log(alone(), tmp_path / "none", "")
        progress.note("a note")
    assert stream.getvalue().splitlines() == [
        "warning: run.log cannot be written: No such file or directory",
        "a note",
    ]


@pytest.mark.release
def test_a_run_under_mpirun_prints_and_logs_its_phases(tmp_path: Path) -> None:
    job = write_job(tmp_path / "job.yaml", BLOCK, output={"fields": False, "mesh": ["msh"]})
    done = hpcinv(2, "run", job, "--output", "run", "-v", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    timed = [line for line in done.stdout.splitlines() if line.endswith(" s") and "  pass: " not in line]
    phases = [line.partition(":")[0].split()[0] for line in timed]
    wanted = ["meshing", "programs", "load", "solving", "writing", "checking", "converged"]
    assert [phase.rstrip(",") for phase in phases] == wanted
    assert re.search(r"^meshing .*box.py: about \d+ cells expected, 48 cells; \d+\.\d s$", done.stdout, re.MULTILINE)
    assert re.search(
        r"^checking: equilibrium, .*stability, limit points, ineffective loads; \d+\.\d s$", done.stdout, re.MULTILINE
    )
    assert "\x1b" not in done.stdout
    log = (tmp_path / "run" / "run.log").read_text()
    assert "python -m hpcinv run " in log
    assert "; 2 ranks on " in log
    iterations = json.loads((tmp_path / "run" / "summary.json").read_text())["solutions"][0]["newton_iterations"]
    assert done.stdout.count("    iteration: ") == log.count("    iteration: ") == iterations
    for line in done.stdout.splitlines():
        assert line in log or line.lstrip().startswith(("meshing", "checking", "writing")), line

    wrong = hpcinv_here("run", job, "--output", "run", "-q", cwd=tmp_path)
    assert (wrong.returncode, wrong.stdout) == (2, "")
    assert (tmp_path / "run" / "run.log").read_text() == log  # the other run's
    finished = hpcinv_here("resume", "run", cwd=tmp_path)
    assert "this run is finished" in finished.stdout


def on_a_terminal(line: str, cwd: Path) -> str:
    """What a terminal of 90 columns shows of a command line."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 90, 0, 0))
    seen: list[bytes] = []
    reader = threading.Thread(target=read_to_the_end, args=(ours, seen))
    reader.start()
    shell = ["timeout", "100", "sh", "-c", line]
    env = environment(TERM="xterm")
    subprocess.run(shell, cwd=cwd, env=env, stdin=theirs, stdout=theirs, stderr=theirs, check=True)
    os.close(theirs)
    reader.join()
    os.close(ours)
    return b"".join(seen).decode()


@pytest.mark.release
def test_a_bar_is_shown_through_mpirun_where_its_output_is_a_terminal_and_only_there(tmp_path: Path) -> None:
    job = write_job(tmp_path / "job.yaml", BLOCK, output={"fields": False, "mesh": ["msh"]})
    run = " ".join(command(2, "run", job, "--overwrite", "--output", "run"))
    shown = on_a_terminal(run, tmp_path)
    assert "━" in shown
    assert "\x1b[?25l" not in shown  # a killed mpirun could not give the cursor back
    assert re.search(r"meshing [^\n]*about \d+ cells expected, 48 cells; \d+\.\d s", shown)
    redirected = on_a_terminal(f"{run} > out", tmp_path)
    assert "\x1b" not in redirected + (tmp_path / "out").read_text()
    assert "\x1b" not in on_a_terminal(f"{run} | cat", tmp_path)
