"""The benchmarks: their arithmetic on runs whose figures are known, and one of them from the command line."""

from __future__ import annotations

import importlib
import json
import math
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import machine
import numpy as np
import pytest
from bench_runs import Findings, MeasuredRun
from helpers.command_line import ROOT, environment
from machine import bodies, crossover, linear, ranks, setup

from hpcinv.errors import OutputError, SolveError
from hpcinv.job.job import parse

SECONDS = {
    "mesh": 2.0,
    "programs": 100.0,
    "tangent": 4.0,
    "factorization": 3.0,
    "linear solve": 2.0,
    "residual": 0.5,
    "newton": 0.4,
    "admissibility check": 0.1,
    "certificate": 6.0,
}


def run(unknowns: int = 50_000, scale: float = 1.0) -> MeasuredRun:
    """A run of which a second of each phase is ``scale`` seconds."""
    summary = {
        "status": "converged",
        "mesh": {"unknowns": unknowns},
        "solutions": [{"factorizations": 3, "newton_iterations": 5, "linear": {"iterations": 0}}],
        "timings": {
            "phases": {name: {"min": 0.0, "max": scale * s} for name, s in SECONDS.items()},
            "total": scale * 120.0,
            "overhead": 0.04,
        },
        "peak_memory": {"ranks": [3 * 10**8, 7 * 10**8], "phases": {}},
    }
    return MeasuredRun(scale * 22.0, summary, "")


class Played:
    """Stands in for a `Bench`: gives runs that are known."""

    def __init__(self, runs: Mapping[str, MeasuredRun], directory: Path, probe: str = "") -> None:
        self.runs, self.directory, self.results, self.probe = runs, directory, directory, probe

    def note(self, text: str) -> None:
        pass

    def output(self, module: str, *arguments: object, ranks: int = 1) -> str:
        return self.probe

    def must_run(self, name: str, job: Mapping[str, Any], ranks: int = 1) -> MeasuredRun:
        (self.results / "shape.msh").write_text("")
        return run()

    def run(self, name: str, job: Mapping[str, Any], ranks: int = 1) -> MeasuredRun:
        return self.runs[job["solver"]["linear"]]

    def alternating(self, jobs: Mapping[str, Any], repeat: int) -> dict[str, list[MeasuredRun]]:
        """The median is the second of three."""
        sizes = {name: self.runs[name].unknowns for name in jobs}
        return {name: [run(n, scale=0.1), self.runs[name], run(n, scale=1e3)] for name, n in sizes.items()}


@pytest.fixture
def benchmark_script(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    return importlib.import_module


def test_figures_of_a_run(benchmark_script: Any) -> None:
    result = run()
    assert result.solver == pytest.approx(10.0)  # without mesh, compilation and certificate
    assert benchmark_script("strategies").total(result) == pytest.approx(20.0)
    assert result.memory == [3 * 10**8, 7 * 10**8]


def test_ranks_are_compared_by_their_medians(tmp_path: Path) -> None:
    played = Played({"a, 7000, on 1": run(), "a, 7000, on 2": run(scale=0.5)}, tmp_path)
    table = ranks(played, {"a": lambda size: {}}, [7_000], [1, 2], 3)  # type: ignore[arg-type]
    assert table.rows[1] == ("a", "50000", "2", "5.00", *5 * ("2.00",), "700")
    assert table.notes == ["a, 50000 unknowns: fastest from command to prompt on 2"]


def test_linear_solvers_cross(tmp_path: Path) -> None:
    sizes = [1e3, 1e4, 1e5]
    # 1e-6 n^2 and 1e-3 n^1.1 are equal where n^0.9 is 1000.
    at = crossover(sizes, [1e-6 * n**2 for n in sizes], [1e-3 * n**1.1 for n in sizes])
    assert at == pytest.approx(1000 ** (1 / 0.9))
    assert crossover(sizes, [1.0, 1.0, 1.0], [2.0, 2.0, 2.0]) is None
    failed = MeasuredRun(1.0, None, "exit code 3: out of memory")
    played = Played({"direct": run(), "iterative": failed}, tmp_path)
    table = linear(played, {"a": lambda size: {}}, [7_000], 2)  # type: ignore[arg-type]
    assert table.rows[0] == ("a", "50000", "10.00", "-", "1000", "-", "- / -")
    assert "a, about 7000 unknowns, iterative: exit code 3: out of memory" in table.notes


def test_ranks_that_do_not_find_each_other_are_named(tmp_path: Path) -> None:
    alone = '{"ranks": 1, "imports": 1.0, "bandwidth": 1e10}\n'
    assert setup(Played({}, tmp_path, alone), [1]).data["1"]["ranks"] == 1  # type: ignore[arg-type]
    with pytest.raises(SolveError, match="2 separate processes"):
        setup(Played({}, tmp_path, 2 * alone), [2])  # type: ignore[arg-type]


@pytest.mark.release
def test_benchmarks_run_from_the_command_line(tmp_path: Path) -> None:
    # Not under mpirun: it starts that itself.
    arguments = ["linear", "--sizes", "80", "--repeat", "1", "--out", "found.json"]
    command = [sys.executable, str(ROOT / "benchmarks/machine.py"), *arguments]
    done = subprocess.run(command, cwd=tmp_path, env=environment(), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    content = json.loads((tmp_path / "found.json").read_text())["linear"]["series"]
    assert content["cube"][0]["unknowns"] == 3 * 3**3 + 2**3
    assert content["rod"][0]["unknowns"] == 3 * 3 * 3 * 21 + 2 * 2 * 11
    assert content["cube"][0]["direct seconds"] > 0
    assert content["cube"][0]["iterative Krylov iterations"] >= content["cube"][0]["iterative Newton iterations"]
    assert done.stdout.startswith("linear: inverse, 1 rank, medians of 1\n")


def test_figures_on_a_full_disk_are_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "setup", lambda *_: Findings("setup", ("ranks",), [("1",)]))
    monkeypatch.setattr(sys, "argv", ["machine.py", "setup", "--ranks", "1", "--out", "/dev/full"])
    with pytest.raises(OutputError, match="/dev/full: cannot be written: No space left on device"):
        machine.main()


def test_jobs_are_valid(tmp_path: Path, benchmark_script: Any) -> None:
    scripts, strategies = benchmark_script("bodies"), benchmark_script("strategies")
    of_bench = bodies(Played({}, tmp_path))  # type: ignore[arg-type]
    for data in (
        *(body(7_000) for body in of_bench.values()),
        scripts.beam(7_000),
        scripts.beam(7_000, analysis="forward", solver=strategies.PAPER),
        scripts.block(5_000, solver={"linear": "iterative"}),
    ):
        parse(data, ROOT / "bench.yaml")
    assert scripts.block(4_209)["mesh"]["parameters"] == {"nx": 5, "ny": 5, "nz": 5}


def test_the_scaling_model_finds_what_it_is_made_of(benchmark_script: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    scaling = benchmark_script("scaling")
    halos = {1: (0.0, 0.0), 2: (1.0, 1.4), 4: (3.0, 2.2), 1_000: (15.0, 4.0)}

    def sample(n: int, p: int) -> Any:
        m, (neighbours, surface) = n / p, halos[p]
        return scaling.Sample(
            n,
            p,
            newton=5,
            iterations=10 + 4 * math.log(n),
            setups=3,
            messages=(neighbours * (1 + 2 * math.log(n)), neighbours * 5 * math.log(n)),
            bytes=(30.0 * surface * m ** (2 / 3), 50.0 * surface * m ** (2 / 3)),
            reductions=(2, 40.0),
            seconds={"tangent": 3 * (0.01 + 5e-5 * n), "residual": 5 * 1e-6 * n, "mesh": 0.1 + 1e-5 * n},
            memory=2e8 + 3e3 * m,
        )

    assert len({tuple(sorted(cell)) for cell in scaling.tetrahedra(2).tolist()}) == 48
    neighbours, surface = scaling.halo(2)  # of a cube of 5 × 5 × 5 bricks
    assert neighbours == 1.0
    # A plane through the middle has 36 vertices, of the 126 and more of a half.
    assert 36 / 126 ** (2 / 3) * 0.9 < surface < 36 / 126 ** (2 / 3) * 1.6

    monkeypatch.setattr(scaling, "halo", halos.__getitem__)
    samples = [sample(n, p) for n in (1_000, 4_000, 16_000, 64_000) for p in (1, 2, 4)]
    terms, figures = scaling.predicted(samples, n := 10**8, 1_000, 0.5)
    iterations = 10 + 4 * math.log(n)
    expected = {
        "tangents": 3 * (0.01 + 5e-5 * 1e5),
        "residuals": 5 * 1e-6 * 1e5,
        "mesh, read and checked by one rank": 0.1 + 1e-5 * n,
        "start: imports, files of all ranks from one file system": 400.0,
        "Krylov, messages": iterations * 15 * (1 + 2 * math.log(n)) * 2e-6,
        "Krylov, bytes": iterations * 30 * 4 * 1e5 ** (2 / 3) / 1e10,
        "preconditioner, messages": 3 * 15 * 5 * math.log(n) * 2e-6,
        "preconditioner, reductions": 3 * 40 * math.log2(1_000) * 2e-6,
    }
    assert {name: terms[name] for name in expected} == pytest.approx(expected)
    assert figures["memory of a rank"] == pytest.approx(2e8 + 3e8)
    np.testing.assert_allclose(scaling.power([10, 100, 1000], [2e2, 2e4, 2e6]), (2.0, 2.0))
