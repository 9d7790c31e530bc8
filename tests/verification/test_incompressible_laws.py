"""Every law that can be fully incompressible: a block stretched in two directions, whose third one follows.

With ``λ1`` and ``λ2`` prescribed and the faces across z free, ``λ3 = 1/(λ1 λ2)`` and σ33 = 0, whatever the law; fibres
along the axes leave the state homogeneous.
"""

from __future__ import annotations

import numpy as np
import pytest
from helpers.verification import Solved, box, job

from hpcinv.base.parallel.runtime import MPI
from hpcinv.physics.materials import laws
from hpcinv.physics.materials.isochoric import IsochoricLaw

AXES = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
STRETCHES = 1.12, 0.97
SPLIT = [name for name, kind in laws().items() if issubclass(kind, IsochoricLaw)]


@pytest.mark.parametrize(
    "law", [law if law == "mooney-rivlin" else pytest.param(law, marks=pytest.mark.release) for law in SPLIT]
)
def test_the_third_stretch_follows(law: str, comm: MPI.Intracomm) -> None:
    material = laws()[law].example | {"kappa": "incompressible"}
    families = laws()[law].model_validate(material).families
    first, second = STRETCHES
    solved = Solved(
        job(
            mesh=box((1, 1, 1)),
            fibres={name: {"direction": a, "given_on": "current"} for name, a in zip(families, AXES, strict=False)},
            material=material,
            supports=[
                *({"region": f"{axis}0", "fix": [axis]} for axis in "xyz"),
                {"region": "x1", "displacement": [f"{1 - 1 / first!r}*x", None, None]},
                {"region": "y1", "displacement": [None, f"({1 - 1 / second!r})*y", None]},
            ],
        ),
        comm,
    )
    inverse = np.diag([1 / first, 1 / second, first * second])  # X = F⁻¹x
    error = solved.relative_error(solved.displacement, solved.constant(np.eye(3) - inverse) * solved.x)
    stress = solved.cauchy_stress
    free = abs(solved.integral(stress[2, 2])) / abs(solved.integral(stress[0, 0]))
    print(f"{law}: displacement {error:.1e}, stress across the free faces {free:.1e}")
    assert error < 1e-11
    assert free < 1e-10
