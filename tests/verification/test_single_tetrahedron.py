"""One linear tetrahedron, its nodes with y = 0 fixed, a body force along y: the paper's table 1, for both laws.

Part I solves forward, then inverse from what that gave; part II the other way round. Here ``u = x - X`` in both
directions, so the paper's error ‖u' + u‖ is the norm of the difference.
"""

from __future__ import annotations

import numpy as np
import pytest
from helpers.verification import job

import hpcinv
from hpcinv.base.parallel.runtime import MPI

pytestmark = pytest.mark.fast

LAWS = {
    "neo-hookean": {"law": "neo-hookean", "young": "10 kPa", "poisson": 0.3},
    "mooney-rivlin": {"law": "mooney-rivlin", "c1": "2 kPa", "c2": "1 kPa", "d1": "20 kPa"},
}


@pytest.mark.everyday(
    "neo-hookean-forward-current",
    "neo-hookean-inverse-reference",
)
@pytest.mark.parametrize("density_in", ["reference", "current"])
@pytest.mark.parametrize("first", ["forward", "inverse"])
@pytest.mark.parametrize("law", LAWS)
def test_round_trips_of_a_tetrahedron_close(first: str, law: str, density_in: str, comm: MPI.Intracomm) -> None:
    for acceleration in (-9.81, 2.5):
        weight = {"effect": "gravity", "acceleration": [0, acceleration, 0], "density": 1000, "density_in": density_in}
        result = hpcinv.run(
            job(
                analysis="round_trip",
                first=first,
                mesh={"file": "../meshes/single_tetrahedron.msh"},
                regions={"base": "y < 1e-9"},
                material=LAWS[law],
                effects=[weight],
                supports=[{"region": "base", "fix": ["x", "y", "z"]}],
                discretisation={"formulation": "displacement", "displacement": 1},
            ),
            comm,
        )
        there, back = result.solutions
        assert (there.direction, back.direction)[0] == first
        assert np.abs(there.u).max() > 1e-2  # not a test of nothing
        error = np.linalg.norm(back.u - there.u)
        print(f"{law}, {first} first, {density_in} density, {acceleration} m/s²: error {error:.1e} m")
        assert error <= 1e-10
