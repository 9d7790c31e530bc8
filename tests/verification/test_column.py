"""A confined column standing under its own weight: no lateral motion, so that the problem is one-dimensional.

Stress balance over the height gives the numbers below (quadrature and root finding, 8 digits).
"""

from __future__ import annotations

import pytest
from helpers.verification import Solved, box, job

from hpcinv.base.parallel.runtime import MPI

pytestmark = pytest.mark.fast

SPATIAL, REFERENCE = 1.0802799, 1.0846655  # undeformed length for a density per current, per reference volume


@pytest.mark.parametrize(("density_in", "length"), [("current", SPATIAL), ("reference", REFERENCE)])
def test_undeformed_length_of_the_column(density_in: str, length: float, comm: MPI.Intracomm) -> None:
    solved = Solved(
        job(
            mesh=box((1, 1, 16), lx="0.2 m", ly="0.2 m"),
            material={"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
            effects=[
                {
                    "effect": "gravity",
                    "acceleration": [0, 0, "-9.81 m/s^2"],
                    "density": "1 g/cm^3",
                    "density_in": density_in,
                }
            ],
            supports=[{"region": "boundary", "fix": ["x", "y"]}, {"region": "z0", "fix": ["z"]}],
        ),
        comm,
    )
    u = solved.model.unknowns.displacement()
    shortening = comm.allreduce(-u.x.array.min() * solved.body.length_scale, op=MPI.MAX)
    print(f"density per {density_in} volume: {1 + shortening:.8f} m, closed form {length} m")
    assert 1 + shortening == pytest.approx(length, rel=1e-6)


def test_density_per_current_volume_means_the_same_in_a_forward_analysis(comm: MPI.Intracomm) -> None:
    solved = Solved(
        job(
            analysis="forward",
            mesh=box((1, 1, 32), lx="0.2 m", ly="0.2 m", lz=f"{SPATIAL} m"),
            material={"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
            effects=[{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 1000, "density_in": "current"}],
            supports=[{"region": "boundary", "fix": ["x", "y"]}, {"region": "z0", "fix": ["z"]}],
        ),
        comm,
    )
    u = solved.model.unknowns.displacement()
    sag = comm.allreduce(-u.x.array.min() * solved.body.length_scale, op=MPI.MAX)
    print(f"forward, density per current volume: {SPATIAL - sag:.8f} m, closed form 1 m")
    assert SPATIAL - sag == pytest.approx(1.0, rel=1e-6)
