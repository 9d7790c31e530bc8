"""`hpcinv explain`: what a scene contains, counted independently, and costs that are those of its parts."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from helpers.command_line import CUBE, hpcinv, write_job
from helpers.verification import box, job

from hpcinv.cli.scene_costs import explain
from hpcinv.parallel.runtime import MPI

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
    found = explain(case, comm)
    law, gravity, pressure = found.rows
    assert (found.cells, found.displacements, found.pressures) == (12, 36, 0)
    assert (law.integrals, law.constants, law.fields) == ({"volume": 1}, 1 + 2, 0)
    assert (gravity.integrals, gravity.constants) == ({}, 3 + 1)
    assert (pressure.integrals, pressure.constants) == ({"surface": 1}, 1)
    assert found.total.integrals == {"volume": 1, "surface": 1}
    assert found.total.compile > 0
    assert found.total.assembly > 0
    assert found.linear_solver == "direct"
    assert found.iteration > found.factorization > 0


@pytest.mark.parallel(2)
def test_the_iterative_solver_is_timed_as_well(comm: MPI.Intracomm) -> None:
    case = job(
        mesh=box((3, 3, 3)),
        material={"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
        supports=HELD,
        discretisation={"displacement": 1},  # which compiles in a moment, while the other rank waits
        solver={"linear": "iterative"},
    )
    found = explain(case, comm)
    assert found.linear_solver == "iterative"
    assert min(found.factorization, found.solution) > 0


def test_from_the_command_line(tmp_path: Path) -> None:
    path = write_job(tmp_path / "cube.yaml", CUBE, effects=[GRAVITY])
    done = hpcinv(1, "explain", path, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("cube: forward, 48 cells, 375 displacements\n")
    assert re.search(r"^effects\[0\] gravity +- +\+4 +\+0 ", done.stdout, re.MULTILINE)
    assert not any(tmp_path.glob("results*")), "explaining leaves no results"
    wrong = write_job(tmp_path / "wrong.yaml", CUBE, effects=[{**PRESSURE, "region": "nowhere"}])
    done = hpcinv(2, "explain", wrong, cwd=tmp_path)
    assert done.returncode == 2
    assert "nowhere" in done.stderr
