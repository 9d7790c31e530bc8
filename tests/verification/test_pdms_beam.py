"""The paper's silicone beam: how far it sags, and that it comes back straight, on any number of ranks."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import silicone_beam
from helpers.silicone_beam import C1, C2, DENSITY, DIAMETER, GRAVITY, LENGTH
from helpers.verification import HERE, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh import reorder_to_source
from hpcinv.output.result import Result


def beam(size: str, comm: MPI.Intracomm, **changes: object) -> Result:
    data = silicone_beam.beam(size) | {"analysis": "forward", "quantities": [silicone_beam.TIP]}
    return hpcinv.run(job(**data | changes), comm)


def elastica_tip(steps: int = 400) -> float:
    """Tip displacement of an inextensible, shear-rigid cantilever under its weight.

    ``θ'' = -K (1 - s) cos θ``, ``θ(0) = θ'(1) = 0``, ``K = ρ g A L³/(E I)``, by shooting with Runge and Kutta's method.
    """
    young = 3 * 2 * (C1 + C2)
    K = DENSITY * GRAVITY * LENGTH**3 / (young * DIAMETER**2 / 16)

    def slope(s: float, y: np.ndarray) -> np.ndarray:
        return np.array([y[1], -K * (1 - s) * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])])

    def end(curvature: float) -> np.ndarray:
        y, h = np.array([0.0, curvature, 0.0, 0.0]), 1 / steps
        for s in np.arange(steps) * h:
            a = slope(s, y)
            b = slope(s + h / 2, y + h / 2 * a)
            c = slope(s + h / 2, y + h / 2 * b)
            y = y + h / 6 * (a + 2 * b + 2 * c + slope(s + h, y + h * c))
        return y

    low, high = 0.0, K
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (low, middle) if end(middle)[1] > 0 else (middle, high)
    x, y = end(low)[2:]
    return float(np.hypot(1 - x, y) * LENGTH)


def test_tip_converges_and_to_what_beam_theory_gives(comm: MPI.Intracomm) -> None:
    """The paper prints 132.52 mm, which its own data do not give: beam theory with them has 129.58 mm.

    The body is a little stiffer than the beam of the theory, since its clamp also keeps the section from contracting.
    """
    tips = [beam(size, comm).quantities["tip"] for size in ("4 mm", "3 mm")]
    print(f"tip displacement {[f'{1e3 * t:.3f} mm' for t in tips]}, beam theory {1e3 * elastica_tip():.3f} mm")
    assert abs(tips[1] - tips[0]) < 0.4e-3  # of 0.7 mm to the theory
    assert tips[1] == pytest.approx(elastica_tip(), rel=8e-3)


@pytest.mark.release
@pytest.mark.parallel([1, 2, 3])
def test_beam_comes_back_straight_and_every_number_of_ranks_agrees(comm: MPI.Intracomm) -> None:
    result = beam("5.5 mm", comm, analysis="round_trip", first="forward")
    print(f"{comm.size} rank(s): round trip closes to {result.errors['round_trip']['max']:.1e} m")
    assert result.errors["round_trip"]["max"] < 1e-9 * LENGTH
    assert result.solutions[0].factorizations <= 9
    assert result.solutions[1].factorizations <= 6
    # The same shape from one rank alone.
    nodes = reorder_to_source(result.body, result.shape)
    if comm.rank == 0 and comm.size > 1:
        alone = beam("5.5 mm", MPI.COMM_SELF)
        assert np.abs(nodes - reorder_to_source(alone.body, alone.shape)).max() < 1e-9


@pytest.mark.release
def test_shipped_shape_gives_the_straight_beam(comm: MPI.Intracomm) -> None:
    result = hpcinv.run(hpcinv.load(HERE.parents[1] / "jobs" / "pdms-beam.yaml").with_({"certificate": "off"}), comm)
    assert result.errors["expected_shape"]["relative"] < 1e-9
    assert abs(result.quantities["out-of-round"]) < 1e-9 * LENGTH
    assert result.quantities["length"] == pytest.approx(LENGTH, rel=1e-9)
