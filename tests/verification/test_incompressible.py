"""Fully incompressible bodies: they keep their volume, and come back, for both laws, tetrahedra and hexahedra."""

from __future__ import annotations

from typing import Any

import pytest
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI

LAWS: dict[str, dict[str, Any]] = {
    "neo-hookean": {"law": "neo-hookean", "mu": "30 kPa", "lam": "incompressible"},
    "mooney-rivlin": {"law": "mooney-rivlin", "c1": "10 kPa", "c2": "5 kPa", "d1": "incompressible"},
}


@pytest.mark.release
@pytest.mark.parallel([2, 1])
def test_bent_block_keeps_its_volume_and_comes_back(comm: MPI.Intracomm) -> None:
    for number, (law, material) in enumerate(LAWS.items()):
        for hexahedra in (False, True):
            # One direction first: each law and each kind of cells has both.
            for first in (("inverse", "forward")[number ^ hexahedra],):
                mesh = box((3, 1, 2), lx=2.0, hexahedra=hexahedra) | {"geometry_degree": 2}
                result = hpcinv.run(
                    job(
                        analysis="round_trip",
                        first=first,
                        mesh=mesh,
                        material=material,
                        effects=[{"effect": "gravity", "acceleration": [0, -3.0, 0], "density": "1 g/cm^3"}],
                        supports=[{"region": "x0", "fix": ["x", "y", "z"]}],
                        quantities=[{"name": "sag", "of": "uy", "on": "x1", "reduce": "mean"}],
                    ),
                    comm,
                )
                closure, sag = result.errors["round_trip"]["relative"], result.quantities["sag"]
                cells = "hexahedra" if hexahedra else "tetrahedra"
                print(f"{law}, {cells}, {first}: sag {sag:.3f} m, closes to {closure:.1e}")
                assert sag < -0.2
                assert closure < 1e-10
                for solution in result.solutions:
                    volume_ratio = solution.J.x.array
                    assert abs(comm.allreduce(volume_ratio.mean(), op=MPI.SUM) / comm.size - 1) < 5e-3
