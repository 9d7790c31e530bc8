"""`hpcinv explain`: contents of a job, counted independently, and costs that are sums over its parts."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest
from helpers.command_line import CUBE, hpcinv_here, write_job
from helpers.verification import box, job

from hpcinv.base.parallel.runtime import MPI
from hpcinv.cli.explain import show
from hpcinv.cli.form_costs import Explanation, PartCosts, explain

PRESSURE = {"effect": "pressure", "region": "x1", "pressure": "1 kPa"}
GRAVITY = {"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 1000}
HELD = [{"region": "x0", "fix": ["x", "y", "z"]}]


@pytest.mark.release
def test_parts_bring_what_they_must_and_nothing_else(comm: MPI.Intracomm) -> None:
    case = job(
        mesh=box((2, 1, 1)),
        material={"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
        effects=[GRAVITY, PRESSURE],
        supports=HELD,
        discretisation={"displacement": 1},
    )
    explanation = explain(case, comm)
    law, gravity, pressure = explanation.rows
    assert (explanation.cells, explanation.displacements, explanation.pressures) == (12, 36, 0)
    assert (law.integrals, law.constants, law.fields) == ({"volume": 1}, 1 + 2, 0)
    assert (gravity.integrals, gravity.constants) == ({}, 3 + 1)
    assert (pressure.integrals, pressure.constants) == ({"surface": 1}, 1)
    assert explanation.total.integrals == {"volume": 1, "surface": 1}
    assert explanation.total.made > 0
    assert explanation.total.assembly > 0
    assert explanation.linear_solver == "direct"
    assert explanation.iteration > explanation.factorization > 0


@pytest.mark.parallel(2)
def test_the_iterative_solver_is_timed_as_well(comm: MPI.Intracomm) -> None:
    case = job(
        mesh=box((3, 3, 3)),
        material={"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
        supports=HELD,
        discretisation={"displacement": 1},  # which compiles in a moment, while the other rank waits
        solver={"linear": "iterative"},
    )
    explanation = explain(case, comm)
    assert explanation.linear_solver == "iterative"
    assert min(explanation.factorization, explanation.solution) > 0


def test_costs_below_what_is_measured_are_not_negative(capsys: pytest.CaptureFixture[str]) -> None:
    """On a loaded machine the weak form without an effect may take longer than the whole one."""
    law = PartCosts("neo-hookean", Counter(volume=1), 3, 0, 1.0, 2e-3, 5e-3)
    effect = PartCosts("effects[0] gravity", Counter(), 4, 0, -0.2, -1e-4, 3e-4)
    case = job(mesh=box((1, 1, 1)), material={"law": "neo-hookean", "mu": 1e4, "lam": 4e4}, supports=HELD)
    explanation = Explanation("forward", 6, 24, 0, (), (law, effect), law, "direct", 1e-3, 1e-4)
    show(case, explanation)
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("effects[0] gravity")]
    assert re.fullmatch(r"effects\[0\] gravity +- +\+4 +\+0 +~0 +~0 +\+0\.3 ms +\+2\.5%", line.strip())


def test_explain_runs_from_the_command_line(tmp_path: Path) -> None:
    path = write_job(tmp_path / "cube.yaml", CUBE, effects=[GRAVITY])
    done = hpcinv_here("explain", path, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("cube: forward, 48 cells, 375 displacements\n")
    assert re.search(r"^effects\[0\] gravity +- +\+4 +\+0 ", done.stdout, re.MULTILINE)
    assert not any(tmp_path.glob("results*")), "explaining leaves no results"
    wrong = write_job(tmp_path / "wrong.yaml", CUBE, effects=[{**PRESSURE, "region": "nowhere"}])
    done = hpcinv_here("explain", wrong, cwd=tmp_path)
    assert done.returncode == 2
    assert "nowhere" in done.stderr
