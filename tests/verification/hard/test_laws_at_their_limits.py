"""Laws that end at a limit, or stiffen exponentially: what Newton's method does far from the answer must not matter."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.closed_forms import root
from helpers.hard_case import effort, fail, job, solve

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.model.outcome import Outcome

MU, JM = 1e4, 0.5
LIMIT = root(lambda s: s**2 + 2 / s - 3 - JM, 1.0, 3.0)


def gent(stretch: float) -> float:
    """Nominal stress of an incompressible bar."""
    return MU * JM / (JM - (stretch**2 + 2 / stretch - 3)) * (stretch - 1 / stretch**2)


def pull(stress: float, stretch: float, analysis: str) -> list[dict[str, object]]:
    """A nominal stress as the traction that the analysis has on its mesh."""
    area = {"forward": "reference", "inverse": "current"}[analysis]
    traction = stress if analysis == "forward" else stress * stretch
    return [{"effect": "traction", "region": "x1", "traction": [traction, 0, 0], "area_in": area}]


@pytest.mark.everyday("0.999-forward", "0.999-inverse")
@pytest.mark.parametrize("analysis", ["forward", "inverse"])
@pytest.mark.parametrize("share", [0.9, 0.999])
def test_gent_is_solved_next_to_its_limit(share: float, analysis: str, comm: MPI.Intracomm) -> None:
    stretch = 1 + share * (LIMIT - 1)
    quantities = [{"name": "length", "of": "x" if analysis == "forward" else "X", "at": [1, 0, 0]}]
    load = pull(gent(stretch), stretch, analysis)
    result = solve("gent-near-its-limit", comm, analysis=analysis, effects=load, quantities=quantities)
    exact = stretch if analysis == "forward" else 1 / stretch
    error = result.quantities["length"] / exact - 1
    print(f"{analysis}, {share} of the way to the limit: {error:.1e} off; {effort(result)}")
    assert abs(error) < 1e-9


def test_the_job_of_gent_has_the_stretch_in_its_header(comm: MPI.Intracomm) -> None:
    assert solve("gent-near-its-limit", comm).quantities["stretch"] == pytest.approx(1.4588020, abs=1e-7)


def test_newton_from_rest_would_leave_the_domain_of_the_law(comm: MPI.Intracomm) -> None:
    """The case is hard: the first correction is the linear answer, a stretch of 180."""
    first = hpcinv.run(job("gent-near-its-limit"), comm).solutions[0].solves[0].iterations[0]
    assert first.correction > 10 * (LIMIT - 1)


@pytest.mark.everyday("series")
@pytest.mark.parametrize("continuation", ["steps", "series"])
def test_gent_beyond_its_limit_is_reported(continuation: str, comm: MPI.Intracomm, run_directory: Path) -> None:
    """A load that nears a bound without end has no limit point."""
    code, text = fail("gent-beyond-its-limit", comm, run_directory, solver={"continuation": continuation})
    print(text)
    assert code == 3
    assert Outcome.OUTSIDE_LAW.text in text
    reached = float(text.split("load factor ")[1].split(" of")[0])
    limit = (LIMIT - 1) / 0.5
    assert 0.98 * limit < reached < limit + 1e-6  # as it is printed


def fibres(stretch: float, k2: float) -> float:
    """Nominal stress of the incompressible bar."""
    E = stretch**2 - 1
    return (MU * (stretch**2 - 1 / stretch) + 2 * 2e3 * stretch**2 * E * np.exp(k2 * E**2)) / stretch


@pytest.mark.everyday("50-1.1-inverse", "100-1.15-forward")
@pytest.mark.parametrize("analysis", ["forward", "inverse"])
@pytest.mark.parametrize(("k2", "stretch"), [(50, 1.1), (100, 1.1), (100, 1.15)])
def test_stiff_exponential_fibres(k2: float, stretch: float, analysis: str, comm: MPI.Intracomm) -> None:
    law = {"law": "holzapfel-gasser-ogden", "mu": MU, "k1": 2e3, "k2": k2, "dispersion": 0, "kappa": "incompressible"}
    quantities = [{"name": "length", "of": "x" if analysis == "forward" else "X", "at": [1, 0, 0]}]
    load = pull(fibres(stretch, k2), stretch, analysis)
    # At 1.15 the load is 4900 times the shear modulus of the ground substance, and its thousandth still 5 times.
    solver = {"initial_step": 1e-3, "minimum_step": 1e-6} if stretch > 1.1 else {}
    result = solve(
        "stiff-fibres",
        comm,
        analysis=analysis,
        material=law | {"fibres": ["along"]},
        effects=load,
        quantities=quantities,
        solver=solver,
    )
    error = result.quantities["length"] / (stretch if analysis == "forward" else 1 / stretch) - 1
    load_ratio = fibres(stretch, k2) / MU
    print(f"{analysis}, k2 = {k2}, stretch {stretch}, P/mu = {load_ratio:.0f}: {error:.1e}; {effort(result)}")
    assert abs(error) < 1e-9


def test_the_job_of_stiff_fibres_has_the_length_in_its_header(comm: MPI.Intracomm) -> None:
    assert solve("stiff-fibres", comm).quantities["length-at-rest"] == pytest.approx(1 / 1.1, rel=1e-9)
