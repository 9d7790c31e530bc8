"""No undeformed shape, two of them, one that no body can have, and loaded states that nobody can have seen."""

from __future__ import annotations

from math import log
from pathlib import Path
from typing import Any

import pytest
from helpers.closed_forms import root
from helpers.command_line import NO_CERTIFICATE
from helpers.command_line import hpcinv_here as command
from helpers.hard_case import FINE, JOBS, effort, fail, solve
from helpers.silicone_beam import C1, C2, DIAMETER, GRAVITY, LENGTH, weight

from hpcinv.base.parallel.runtime import MPI
from hpcinv.output.result import Result
from hpcinv.solver.diagnosis import Diagnosis
from hpcinv.trust.certificate import Line, Verdict


def finding(result: Result, name: str) -> Line:
    """The line of a certificate whose name begins like this."""
    (line,) = (line for line in result.certificate.lines if line.name.startswith(name))
    print(f"{line.name}: {line.value} ({line.verdict.value}) {line.note}")
    return line


def reached(text: str) -> float:
    return float(text.split("load factor ")[1].split(" of")[0])


# A sphere beyond its limit


@pytest.mark.release
def test_a_sphere_that_no_cavity_can_have_been(comm: MPI.Intracomm, run_directory: Path) -> None:
    """Closed form: the cavity vanishes at ``p = mu/2 (4/λ_b + 1/λ_b⁴)``, ``λ_b = b/(b³ - a³)^(1/3)``."""
    stretch = 1.5 / (1.5**3 - 1) ** (1 / 3)
    limit = 0.5 * (4 / stretch + stretch**-4) / 2.5
    code, text = fail("sphere-beyond-its-limit", comm, run_directory)
    print(f"limit at load factor {limit:.4f}: {text}")
    assert code == 3
    assert Diagnosis.NO_UNDEFORMED_SHAPE.text in text
    assert 0.75 * limit < reached(text) < limit


# Two shapes

MU, LAM, SEEN = 10e3, 1e6, 1.0


def traction(stretch: float) -> float:
    return MU * (stretch - 1 / stretch) + LAM * log(stretch) / stretch


def slope(stretch: float) -> float:
    return MU * (1 + stretch**-2) + LAM * (1 - log(stretch)) / stretch**2


LIMIT_POINT = root(slope, 2.0, 5.0)  # the stretch at which the traction is largest


@pytest.mark.everyday("beyond a limit point")
@pytest.mark.parametrize(
    ("solver", "low", "high"),
    [
        ({}, 1.0, LIMIT_POINT),
        ({"strategy": "arc-length"}, 1.0, LIMIT_POINT),
        ({"strategy": "arc-length", "limit_points": 1}, LIMIT_POINT, 12.0),
    ],
    ids=["default", "arc-length", "beyond a limit point"],
)
def test_each_of_two_undeformed_lengths_is_found(
    solver: dict[str, Any], low: float, high: float, comm: MPI.Intracomm
) -> None:
    exact = 1 / root(lambda s: traction(s) - 380e3, low, high)
    certificate = NO_CERTIFICATE | {"stability": True}
    result = solve("two-undeformed-lengths", comm, solver=solver, certificate=certificate)
    value = result.quantities["length-at-rest"]
    print(f"{value:.9f} m, closed form {exact:.9f} m; {effort(result)}")
    assert value == pytest.approx(exact, rel=1e-9)
    # In the softening branch the bar lengthens by itself, with one of the three.
    beyond = low == LIMIT_POINT
    assert finding(result, "stability").value == beyond
    assert finding(result, "limit points").value == beyond


def test_the_limit_point_is_reported_with_the_load_it_carries(comm: MPI.Intracomm, run_directory: Path) -> None:
    load = {"effect": "traction", "region": "x1", "traction": [400e3, 0, 0], "area_in": "current"}
    code, text = fail("two-undeformed-lengths", comm, run_directory, effects=[load], solver={"strategy": "arc-length"})
    print(f"closed form {traction(LIMIT_POINT) / 400e3:.7f}: {text}")
    assert code == 3
    assert Diagnosis.LIMIT_POINT.text in text
    assert reached(text) == pytest.approx(traction(LIMIT_POINT) / 400e3, abs=2e-6)


# A shape that overlaps itself


def test_a_coil_that_passes_through_itself_is_reported(comm: MPI.Intracomm) -> None:
    """By theory (test_hard_beams.py) the axis turns more than once around, on a radius less than the beam is thick."""
    result = solve("coil-through-itself", comm, certificate=NO_CERTIFICATE | {"overlap": True})
    assert result.solutions[0].J_range[0] > 0.5  # nothing in the interior says so
    crossing = finding(result, "boundary facets")
    assert crossing.verdict is Verdict.FAIL
    assert crossing.value is not None
    assert crossing.value > 10


@pytest.mark.release
def test_half_a_turn_does_not_overlap(comm: MPI.Intracomm) -> None:
    half = weight(2.0)
    result = solve("coil-through-itself", comm, effects=[half], certificate=NO_CERTIFICATE | {"overlap": True})
    assert finding(result, "boundary facets").verdict is Verdict.PASS


# Instability


@pytest.mark.release
@pytest.mark.parametrize(
    ("share", "unstable"), [(0.95, 0), (1.05, 2), pytest.param(6.9, 2, marks=pytest.mark.release), (7.5, 4)]
)
def test_a_column_higher_than_can_stand_is_reported(share: float, unstable: int, comm: MPI.Intracomm) -> None:
    """Greenhill: it falls at ``q L³/(E I) = 7.8373``; its second mode is at 55.98, 7.14 times as much."""
    stiffness = 3 * 2 * (C1 + C2) * DIAMETER**2 / 16
    density = share * 7.8373 * stiffness / (GRAVITY * LENGTH**3)
    load = {"effect": "gravity", "acceleration": [-9.81, 0, 0], "density": density}
    result = solve("standing-beam", comm, effects=[load], certificate=NO_CERTIFICATE | {"stability": True}, **FINE)
    line = finding(result, "stability")
    assert line.value == unstable
    assert line.verdict is (Verdict.FAIL if unstable else Verdict.PASS)


@pytest.mark.release
def test_the_command_line_ends_with_6(tmp_path: Path) -> None:
    """The straight column is an answer, and is written; but its certificate fails."""
    ended = command("run", JOBS / "standing-beam.yaml", cwd=tmp_path)
    assert ended.returncode == 6, ended.stdout + ended.stderr
    assert "buckle" in ended.stdout
    assert (tmp_path / "results" / "standing-beam" / "shape.msh").exists()
