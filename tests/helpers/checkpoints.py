"""What tests of checkpoints write: the problem of a checkpoint, and two fields by formulas."""

from __future__ import annotations

import numpy as np
from dolfinx import fem

from hpcinv.mesh import Body

PROBLEM = {"material": {"law": "neo-hookean", "mu": 1.0}}


def fields(body: Body, degree: int, *, filled: bool) -> dict[str, fem.Function]:
    """A vector of some degree and a scalar of one less, by formulas of the position."""

    def wave(x: np.ndarray) -> np.ndarray:
        return np.sin(3 * x[0]) + np.cos(2 * x[1]) * x[2] + x[0] * x[1]

    u = fem.Function(fem.functionspace(body.mesh, ("Lagrange", degree, (3,))))
    p = fem.Function(fem.functionspace(body.mesh, ("Lagrange", max(degree - 1, 1))))
    if filled:
        u.interpolate(lambda x: np.stack([wave(x), wave(x) ** 2, wave(-x)]))
        p.interpolate(wave)
    return {"displacement-0": u, "pressure-0": p}
