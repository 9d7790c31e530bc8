"""What a run says, and to whom."""

from __future__ import annotations

import contextlib
import io
import os
import pty
import threading
from types import SimpleNamespace
from typing import Any

import pytest
from legs import SOLVES

from hpcinv.linear.choice import Used
from hpcinv.progress import Progress

DIRECT = Used("direct", "at 9 unknowns, multigrid would take about 2 times as long", None)

STATISTICS: dict[str, Any] = {
    "status": "converged",
    "legs": [
        {
            "direction": "inverse",
            "factorizations": 4,
            "linear": None,
            "J": {"min": 0.9, "max": None},
            "strain_energy": 2e-3,
        }
    ],
    "quantities": {"tip": [0.0, -0.1325, 1e-9], "roundness": 1.5e-6},
    "certificate": {
        "verdict": "warning",
        "lines": [
            {"name": "residual", "value": 1.234e-9, "unit": "", "verdict": "pass", "note": ""},
            {"name": "overlap", "value": None, "unit": "", "verdict": "not checked", "note": "switched off"},
            {"name": "sag", "value": 0.5, "unit": "m", "verdict": "warning", "note": "much"},
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
    progress.leg("inverse", DIRECT)
    for solve in SOLVES:
        progress.solve(solve, 0.132456, 0.87654321)
    progress.finish(STATISTICS)


def rank(number: int) -> Any:
    """Communicator of one of two ranks."""
    return SimpleNamespace(rank=number, size=2)


def test_rank_0_tells_each_step_in_a_line_and_the_error_last() -> None:
    silent, stream = io.StringIO(), io.StringIO()
    for comm, to in ((rank(1), silent), (rank(0), stream)):
        with Progress(comm, to) as progress:
            tell(progress)
    assert silent.getvalue() == ""
    lines = stream.getvalue().splitlines()
    assert lines[0] == "inverse:"
    assert lines[1] == "  direct linear solver: at 9 unknowns, multigrid would take about 2 times as long"
    assert "not reached: an element would turn inside out" in lines[2]
    step = "  load 0.5: 2 iterations, 1 factorization, largest displacement 0.1325 m, det F^-1 > 0.8765, "
    assert lines[3].startswith(step)
    assert lines[4].startswith("  load 1: 2 iterations, 2 factorizations, ")
    assert lines[5] == "converged, 4 factorizations, 12.3 s"
    assert "  seconds: tangent 2.0" in lines
    assert "  memory: 350 MB on the fullest rank; most in newton" in lines
    assert "  inverse: J from 0.9 to not finite, strain energy 0.002 J" in lines
    at = lines.index("certificate: warning")
    assert lines[at + 1 : at + 4] == [
        "  pass: residual 1.23e-09",
        "  not checked: overlap (switched off)",
        "  warning: sag 0.5 m (much)",
    ]
    at = lines.index("roundness: 1.5e-06 (standard deviation 1e-06)")
    assert lines[at - 1 : at + 4] == [
        "tip: (0, -0.1325, 1e-09) m (estimated error (0.001, 0, 0) m, standard deviation (0, 0.02, 0) m)",
        "roundness: 1.5e-06 (standard deviation 1e-06)",
        "per SI unit of",
        "  material.mu: tip (0, 2e-05, 0) m, roundness -1e-09, shape up to 3e-05 m",
        "shape: standard deviation up to 0.03 m, at (1, 0, 0.5) m",
    ]
    assert sum("snes_tpye" in line for line in lines) == 1
    assert lines[-1] == "recovered shape: 1.34e-14 m from the expected one (7e-14 of its length)"
    assert lines[-2].startswith("round trip: closes to 1e-12 m")
    assert not any("\x1b" in line for line in lines)


def test_without_a_stream_nothing_is_said(capfd: pytest.CaptureFixture[str]) -> None:
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
        progress.leg("forward", DIRECT)
        progress.solve(SOLVES[1], 0.1, 0.9)
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
