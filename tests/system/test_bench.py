"""``hpcinv bench``: its arithmetic on runs whose figures are known, and one section from the command line."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import environment, hpcinv

from hpcinv.bench.bodies import beam, block, block_unknowns
from hpcinv.bench.costmodel import CostModel, Line, Machine, Power, Start
from hpcinv.bench.halo import Halo, halo, tetrahedra
from hpcinv.bench.linear import crossover, linear
from hpcinv.bench.phases import phases
from hpcinv.bench.ranks import ranks
from hpcinv.bench.runs import Run
from hpcinv.bench.samples import Sample
from hpcinv.bench.scalingplot import draw
from hpcinv.bench.strategies import PAPER, strategies
from hpcinv.job.job import parse

ROOT = Path(__file__).parents[2]


def run(unknowns: int = 50_000, scale: float = 1.0, memory: tuple[int, ...] = (10**9,), applied: int = 0) -> Run:
    """A run of which a second of each phase is ``scale`` seconds."""
    seconds = {
        "mesh": 2.0,
        "compile": 100.0,
        "tangent": 4.0,
        "factorization": 3.0,
        "linear solve": 2.0,
        "residual": 0.5,
        "newton": 0.4,
        "admissibility check": 0.1,
        "certificate": 6.0,
    }
    summary = {
        "status": "converged",
        "mesh": {"unknowns": unknowns},
        "legs": [{"factorizations": 3, "newton_iterations": 5}],
        "timings": {
            "phases": {name: {"min": 0.0, "max": scale * s} for name, s in seconds.items()},
            "total": scale * 120.0,
            "overhead": 0.04,
        },
        "peak_memory": {"ranks": list(memory), "phases": {}},
    }
    return Run(scale * 22.0, scale * 20.0, summary, {"PCApply": [{"count": applied}]}, "")


class Played:
    """Stands in for a `Bench`: gives runs that are known."""

    def __init__(self, runs: Mapping[str, Run], directory: Path) -> None:
        self.runs, self.directory = runs, directory

    def note(self, text: str) -> None:
        pass

    def compile(self, name: str, job: Mapping[str, Any]) -> None:
        pass

    def must_run(self, name: str, job: Mapping[str, Any], ranks: int = 1, *, log: bool = False) -> Run:
        (self.results() / "shape.msh").parent.mkdir(exist_ok=True)
        (self.results() / "shape.msh").write_text("")
        return run()

    def bandwidth(self, ranks: int) -> float:
        return 40e9 if ranks == 1 else 44e9

    def results(self) -> Path:
        return self.directory / "results"

    def run(self, job: Mapping[str, Any], ranks: int = 1, *, log: bool = False) -> Run:
        return self.runs[job["solver"]["linear"]]

    def in_turns(self, jobs: Mapping[str, Any], repeat: int) -> dict[str, list[Run]]:
        """The median is the second of three."""
        sizes = {name: self.runs[name].unknowns for name in jobs}
        return {name: [run(n, scale=0.1), self.runs[name], run(n, scale=1e3)] for name, n in sizes.items()}


def test_figures_of_a_run() -> None:
    found = run()
    assert found.solver == pytest.approx(10.0)  # without mesh, compilation and certificate
    assert found.outside_in_solver == pytest.approx(0.05)
    assert found.total == pytest.approx(20.0)
    assert run(memory=(3, 5)).peak_memory == 8
    assert run(memory=(3, 5)).fullest_rank == 5


def test_strategies_are_compared_by_their_medians(tmp_path: Path) -> None:
    known = {
        "inverse, default": run(),
        "inverse, paper": run(scale=7.0),
        "forward, default": run(scale=2.0),
        "forward, paper": run(scale=4.0),
    }
    found = strategies(Played(known, tmp_path), size=7_000, repeat=3)  # type: ignore[arg-type]
    assert found.data["ratios"]["inverse"]["solver"] == pytest.approx(7.0)
    assert found.data["ratios"]["forward"]["whole run"] == pytest.approx(2.0)
    assert "inverse, paper / default, solver: 7.0 times (at least 6: met)" in found.notes
    assert "forward, paper / default, solver: 2.0 times (at least 2.5: MISSED)" in found.notes


def test_ranks_and_phases(tmp_path: Path) -> None:
    played = {
        "beam, 7000, 1": run(),
        "beam, 7000, 2": run(scale=0.5),
        "block, 7000, 1": run(10_000),
        "block, 7000, 2": run(10_000, scale=0.8),
    }
    found = ranks(Played(played, tmp_path), sizes=[7_000], repeat=3)  # type: ignore[arg-type]
    assert found.data["ratios"]["beam, 7000"]["tangent"] == pytest.approx(2.0)
    assert found.rows[1][:5] == ("block, 10000", "10.00", "8.00", "1.25", "1.25")
    assert found.notes == [
        "beam, 50000 unknowns, solver: 2.00 times (at least 1.8: met)",
        "block, 10000 unknowns, solver: 1.25 times (at least 1.8: MISSED)",
        "memory: 40.0 GB/s on 1 rank, 44.0 GB/s on 2: 1.10 times",
    ]
    each = phases(Played({"beam": run(), "block": run(10_000)}, tmp_path), size=7_000, repeat=3)  # type: ignore[arg-type]
    table = {row[0]: row[1:] for row in each.rows}
    assert table["tangent"] == ("80.00", "400.00")  # 4 s over 50,000 and 10,000 unknowns
    assert table["mesh"] == ("40.00", "200.00")
    # Of 120 s 6 for the certificate; 4 + 3 + 2 + 0.5 + 0.1 s of work, and 100 s to make kernels.
    assert each.data["outside before certificate"]["beam"] == pytest.approx(1 - 109.6 / 114.0)
    assert each.notes == ["beam: 4.0% outside (at most 5%: met)"]  # the block is too small to be judged


def test_linear_solvers_cross(tmp_path: Path) -> None:
    sizes = [1e3, 1e4, 1e5]
    # 1e-6 n^2 and 1e-3 n^1.1 are equal where n^0.9 is 1000.
    at = crossover(sizes, [1e-6 * n**2 for n in sizes], [1e-3 * n**1.1 for n in sizes])
    assert at == pytest.approx(1000 ** (1 / 0.9))
    assert crossover(sizes, [1.0, 1.0, 1.0], [2.0, 2.0, 2.0]) is None
    failed = Run(1.0, 1.0, None, {}, "exit code 3: out of memory")
    found = linear(Played({"direct": run(), "iterative": failed}, tmp_path), sizes=[7_000], repeat=2)  # type: ignore[arg-type]
    assert found.rows[0][:4] == ("beam", "50000", "10.00", "-")
    assert "beam, about 7000 unknowns, iterative: exit code 3: out of memory" in found.notes


def samples() -> list[Sample]:
    """Of a machine and a solver that do exactly what the model has."""

    def one(n: int, p: int) -> Sample:
        m, around = n / p, _HALOS[p]
        return Sample(
            unknowns=n,
            ranks=p,
            newton=5,
            iterations=round(10 + 4 * math.log(n)),
            setups=3,
            messages_per_iteration=around.neighbours * (1 + 2 * math.log(n)),
            bytes_per_iteration=30.0 * around.surface * m ** (2 / 3),
            messages_per_setup=around.neighbours * 5 * math.log(n),
            bytes_per_setup=50.0 * around.surface * m ** (2 / 3),
            reductions_per_setup=40.0,
            seconds={"tangent": 3 * (0.01 + 5e-5 * n), "residual": 5 * 1e-6 * n, "mesh": 0.1 + 1e-5 * n},
            memory=2e8 + 3e3 * m,
        )

    return [one(n, p) for n in (1_000, 4_000, 16_000, 64_000) for p in (1, 2, 4)]


_HALOS = {1: Halo(0.0, 0.0), 2: Halo(1.0, 1.4), 4: Halo(3.0, 2.2), 1_000: Halo(15.0, 4.0)}


def test_the_model_finds_the_laws_that_it_is_made_of(tmp_path: Path) -> None:
    model = CostModel.fitted(samples(), _HALOS)
    n, p, machine = 10**8, 1_000, Machine(2e-6, 1e10, 2e4)
    terms = model.terms(n, p, _HALOS[p], machine, Start(0.5, 8_000))
    iterations = 10 + 4 * math.log(n)
    assert terms["tangents"] == pytest.approx(3 * (0.01 + 5e-5 * 1e5))
    assert terms["residuals"] == pytest.approx(5 * 1e-6 * 1e5)
    assert terms["mesh, read and checked by one rank"] == pytest.approx(0.1 + 1e-5 * n)
    assert terms["start: imports, files of all ranks from one file system"] == pytest.approx(400.0)
    # Iterations are whole numbers, which the fit sees rounded.
    assert terms["Krylov, messages"] == pytest.approx(iterations * 15 * (1 + 2 * math.log(n)) * 2e-6, rel=0.03)
    assert terms["Krylov, bytes"] == pytest.approx(iterations * 30 * 4 * 1e5 ** (2 / 3) / 1e10, rel=0.03)
    assert terms["preconditioner, messages"] == pytest.approx(3 * 15 * 5 * math.log(n) * 2e-6)
    assert terms["preconditioner, reductions"] == pytest.approx(3 * 40 * math.log2(p) * 2e-6)
    assert model.memory.at(1e5) == pytest.approx(2e8 + 3e8)
    draw(tmp_path / "scaling.png", {"weak": samples(), "strong": samples()}, model, _HALOS, machine, Start(0.0, 0.0))
    assert (tmp_path / "scaling.png").read_bytes().startswith(b"\x89PNG")


def test_fits() -> None:
    x = np.linspace(1.0, 9.0, 9)
    exact = Line.through(list(x), list(3 + 2 * x))
    assert (exact.a, exact.b) == pytest.approx((3.0, 2.0))
    assert exact.error(100.0) == pytest.approx(0.0, abs=1e-10)
    noisy = Line.through([0.0, 1.0, 2.0], [0.0, 1.5, 2.0])  # residuals -1/6, 1/3, -1/6: variance 1/6 with one left over
    assert noisy.error(1.0) == pytest.approx(math.sqrt(1 / 6 / 3))  # at the mean of x
    power = Power.through([10, 100, 1000], [2e2, 2e4, 2e6])
    assert (power.a, power.q) == pytest.approx((2.0, 2.0))


def test_halo_of_two_halves_and_of_a_brick() -> None:
    assert len({tuple(sorted(cell)) for cell in tetrahedra(2).tolist()}) == 48
    assert set(tetrahedra(1).ravel()) == set(range(8))
    halves = halo(2)  # a cube of 5 × 5 × 5 bricks
    assert halves.neighbours == 1.0
    # A plane through the middle has 36 vertices, of the 126 and more of a half.
    assert 36 / 126 ** (2 / 3) * 0.9 < halves.surface < 36 / 126 ** (2 / 3) * 1.6
    assert 2.0 < halo(8).neighbours <= 7.0


def test_the_jobs_of_the_set_are_valid() -> None:
    for data in (
        beam(7_000),
        beam(7_000, analysis="forward", solver=PAPER),
        block(5_000, solver={"linear": "iterative"}),
    ):
        parse(data, ROOT / "bench.yaml")
    assert block(4_209)["mesh"]["parameters"] == {"nx": 5, "ny": 5, "nz": 5}
    assert block_unknowns(5) == 3 * 11**3 + 6**3


def test_from_the_command_line(tmp_path: Path) -> None:
    # Not under mpirun: it starts that itself.

    command = [
        sys.executable,
        "-m",
        "hpcinv",
        "bench",
        "linear",
        "--sizes",
        "80",
        "--repeat",
        "1",
        "--out",
        "found.json",
    ]
    done = subprocess.run(command, cwd=tmp_path, env=environment(), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "found.json").read_text())["linear"]["series"]
    assert found["block"][0]["unknowns"] == block_unknowns(1)
    assert found["block"][0]["direct seconds"] > 0
    assert found["block"][0]["iterative Krylov iterations"] >= found["block"][0]["iterative Newton iterations"]
    assert done.stdout.startswith("linear: inverse, 1 rank, medians of 1\n")
    refused = hpcinv(2, "bench", "linear", cwd=tmp_path)
    assert refused.returncode == 2
    assert "bench starts the ranks itself" in refused.stderr
