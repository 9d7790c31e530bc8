"""A cantilever beam that comes to rest on a rigid plane below it (Signorini's problem for a beam).

A beam of stiffness EI under its weight q per length, at a gap g above a plane, is clamped at x = 0. Where the tip has
come down far enough, the beam lies flat from x = a on. With ``w(a) = g``, ``w'(a) = 0`` and ``w''(a) = 0``,

    a⁴ = 72 EI g/q,      F = q a/3 at x = a,      p = q from there on,

so the plane carries ``q (L - 2 a/3)`` (Kikuchi & Oden, Contact Problems in Elasticity, 1988,
doi:10.1137/1.9781611970845, for the problem). Strains of shear and the thickness add terms of the order of (h/a)².
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI

LENGTH, WIDTH, HEIGHT, YOUNG = 1.0, 0.1, 0.04, 1e5
STIFFNESS = YOUNG * WIDTH * HEIGHT**3 / 12
GAP = 0.002


def resting(comm: MPI.Intracomm, detached: float, divisions: int, **contact: Any) -> tuple[float, float, float]:
    """Return force over weight, largest gap of the part that should lie flat, and largest overlap, both over the gap.

    Args:
        detached: length of the part that should not lie on the plane.
    """
    weight = 72 * STIFFNESS * GAP / detached**4  # per length
    plane = {"shape": "plane", "point": [0, 0, -GAP], "normal": [0, 0, 1]}
    given = {
        "analysis": "forward",
        "mesh": box((divisions, 1, 1), lx=LENGTH, ly=WIDTH, lz=HEIGHT, hexahedra=True),
        "material": {"law": "neo-hookean", "young": YOUNG, "poisson": 0.0},
        "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
        "effects": [
            {"effect": "gravity", "acceleration": [0, 0, -1], "density": weight / (WIDTH * HEIGHT)},
            {"effect": "contact", "region": "z0", "obstacle": plane, **contact},
        ],
    }
    (solution,) = hpcinv.run(job(**given), comm).solutions
    x, u = solution.mesh_nodes, solution.u[:, 2]
    gaps = np.where(x[:, 2] < 1e-9, GAP + u, 0.0)
    flat = x[:, 0] > detached + 2 * LENGTH / divisions
    above, below = (
        comm.allreduce(float(most), op=MPI.MAX)
        for most in (np.abs(gaps[flat]).max(initial=0.0), -gaps.min(initial=0.0))
    )
    return solution.contacts[0].force[2] / (weight * LENGTH), above / GAP, below / GAP


@pytest.mark.release
@pytest.mark.parametrize("detached", [0.6, 0.8])
def test_part_of_the_weight_lies_on_the_plane(detached: float, comm: MPI.Intracomm) -> None:
    force, above, below = resting(comm, detached, 40)
    print(f"Signorini beam, a = {detached} L: force / weight {force:.4f}, gap {above:.1e} and overlap {below:.1e} of g")
    assert force == pytest.approx(1 - 2 * detached / 3, rel=0.02)
    assert above < 0.02
    assert below < 0.02
