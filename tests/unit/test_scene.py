"""What a scene asks of the compiler: nothing new for other parameters, nothing for what it does not contain."""

from __future__ import annotations

from typing import Any

import numpy as np
from dolfinx import fem
from ffcx.naming import compute_signature
from helpers.verification import box, job

from hpcinv.mesh import build_body
from hpcinv.model.scene import Scene
from hpcinv.parallel.runtime import MPI
from hpcinv.parallel.timings import Timings
from hpcinv.solver.problem import Model

GRAVITY = {"effect": "gravity", "acceleration": [0, -9.81, 0], "density": 1000}


def scene(comm: MPI.Intracomm, c1: str = "10 kPa", **data: Any) -> Scene:
    case = job(
        mesh=box((1, 1, 1)),
        material={"law": "mooney-rivlin", "c1": c1, "c2": "5 kPa", "d1": "1 MPa"},
        supports=[{"region": "x0", "fix": ["x", "y", "z"]}],
        **data,
    )
    body = build_body(case.mesh, case.regions, comm, resolve=case.resolve)
    return Model(case, body, Timings()).scene("inverse")


def signatures(scene: Scene) -> tuple[str, str]:
    """What DOLFINx's cache knows the residual and the stress by."""
    points = np.array([[0.25, 0.25, 0.25]])
    return scene.residual.signature(), compute_signature([(scene.cauchy_stress[0][0], points)], "")


def test_other_values_need_no_other_kernels(comm: MPI.Intracomm) -> None:
    first = scene(comm, effects=[GRAVITY])
    for _ in range(120):  # UFL's running numbers get another digit
        fem.Constant(first.unknowns.mesh, 1.0)
    later = scene(comm, c1="20 kPa", effects=[GRAVITY | {"density": 5}])
    assert signatures(later) == signatures(first)


def test_what_is_not_listed_leaves_nothing_behind(comm: MPI.Intracomm) -> None:
    bare = scene(comm)
    loaded = scene(comm, effects=[GRAVITY])
    assert len(bare.residual.constants()[0].value) == 1 + 3  # load factor, c1 c2 d1
    assert len(loaded.residual.constants()[0].value) == 1 + 3 + 4
    assert bare.residual.signature() != loaded.residual.signature()
