"""A law that ends at a limit of strain: a load beyond it is reported, a load below it is solved."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.closed_forms import root
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import SolveError

JM = 0.2


def pulled(stretch: float, **data: Any) -> Any:
    """A block with every point of its boundary moved to its place in a uniaxial stretch."""
    return job(
        analysis="forward",
        mesh=box((2, 2, 2)),
        material={"law": "gent", "mu": "10 kPa", "jm": JM, "kappa": "30 kPa"},
        supports=[{"region": "boundary", "displacement": [f"{stretch - 1!r}*x", 0, 0]}],
        discretisation={"displacement": 1},
        **data,
    )


def test_stretches_are_solved_below_the_limit_and_reported_above(comm: MPI.Intracomm) -> None:
    limit = root(lambda a: a ** (-2 / 3) * (a**2 + 2) - 3 - JM, 1.0, 3.0)
    assert hpcinv.run(pulled(0.995 * limit), comm).solutions[0].J_range == pytest.approx(
        (0.995 * limit,) * 2, rel=1e-10
    )
    with pytest.raises(SolveError, match="leave the range of the material law") as caught:
        hpcinv.run(pulled(1.5 * limit, solver={"rescue": []}), comm)
    print(f"limit {limit:.4f}: {caught.value}")
    reached = float(str(caught.value).split("load factor ")[1].split(" of")[0])
    assert 0.9 * (limit - 1) < reached * (1.5 * limit - 1) < (limit - 1) * (1 + 1e-6)  # it is printed with six digits
    assert np.isfinite(reached)
