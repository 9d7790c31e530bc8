"""Numbers far from anything sensible: a run ends with an answer or with words, never with a traceback or not at all."""

from __future__ import annotations

from typing import Any

import pytest
from helpers.hard_case import job, require_finite

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import SolveError
from hpcinv.job.job import Job

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")
both_ways = pytest.mark.parametrize("analysis", ["inverse", "forward"])


def block(analysis: str, *, g: float = 10.0, mu: float = 1e4, length: float = 1.0) -> Job:
    """A block on its foot under its weight."""
    sides: dict[str, Any] = dict.fromkeys(("lx", "ly", "lz"), length) | dict.fromkeys(("nx", "ny", "nz"), 2)
    return job(
        "load-on-a-held-face",
        analysis=analysis,
        mesh={"file": "../../meshes/box.py", "parameters": sides, "unit": length},
        material={"law": "neo-hookean", "mu": mu, "lam": 4 * mu},
        effects=[{"effect": "gravity", "acceleration": [0, 0, -g], "density": 1e3}],
    )


STIFF = {"weightless": {"g": 1e-300}, "stiff beyond measure": {"mu": 1e300}, "a body of 1e-30 m": {"length": 1e-30}}
SOFT = {
    "a hundred million times the weight": {"g": 1e9},
    "a weight near the largest number": {"g": 1e300},
    "a modulus near the smallest number": {"mu": 1e-300},
    "a body of 1e30 m": {"length": 1e30},
}


@pytest.mark.everyday("weightless-inverse", "beyond measure-forward", "1e-30 m-inverse")
@both_ways
@pytest.mark.parametrize("extreme", STIFF.values(), ids=STIFF)
def test_extremely_small_displacements_are_solved(
    extreme: dict[str, float], analysis: str, comm: MPI.Intracomm
) -> None:
    case = block(analysis, **extreme)
    result = hpcinv.run(case, comm)
    require_finite(result.statistics)
    usual = hpcinv.run(block(analysis, g=1e-6), comm).quantities["largest-displacement"]
    # ρ g L²/mu is what a displacement is proportional to.
    scale = extreme.get("g", 10.0) / 1e-6 * 1e4 / extreme.get("mu", 1e4) * extreme.get("length", 1.0) ** 2
    expected = usual * scale if usual * scale > 1e-290 else 0.0
    assert result.quantities["largest-displacement"] == pytest.approx(expected, rel=1e-6)


@pytest.mark.everyday("the weight-inverse", "largest number-forward", "smallest number-inverse", "1e30 m-forward")
@both_ways
@pytest.mark.parametrize("extreme", SOFT.values(), ids=SOFT)
def test_extremely_large_loads_are_reported(extreme: dict[str, float], analysis: str, comm: MPI.Intracomm) -> None:
    with pytest.raises(SolveError, match="stopped at load factor") as caught:
        hpcinv.run(block(analysis, **extreme), comm)
    print(caught.value)
    # A power series may find the largest load, of a few times the weight.
    assert float(str(caught.value).split("load factor ")[1].split(" of")[0]) < 1e-6
    assert caught.value.advice
