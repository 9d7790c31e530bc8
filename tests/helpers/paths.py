"""Bodies whose path of equilibria turns, and everything that is tried on the way along it."""

from __future__ import annotations

from typing import Any

import numpy as np

from helpers.closed_forms import LAM, MU, NEO_HOOKEAN, root
from helpers.verification import HERE, box, job
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.job.job import Job
from hpcinv.mesh import build_body
from hpcinv.solver.equations import Equations
from hpcinv.solver.methods import DirectMethod
from hpcinv.solver.newton import Solve

# An octant of a thick sphere.

INNER, OUTER = 1.0, 1.5
SPHERE: dict[str, Any] = {
    "file": "../meshes/thick_sphere.py",
    "parameters": {"inner": INNER, "outer": OUTER, "radial": 2, "along": 2, "hexahedra": True, "shells": False},
    "geometry_degree": 2,
}
OCTANT = [{"region": f"{i}0", "fix": [i]} for i in "xyz"]

# A cube under tension from all sides, homogeneous on every mesh: its tension has a maximum at J = 2.94.


def tension(J: float) -> float:
    """``σ = (μ (J^⅔ - 1) + λ ln J) / J``, in Pa."""
    return float((MU * (J ** (2 / 3) - 1) + LAM * np.log(J)) / J)


J_LIMIT = root(lambda J: LAM * (np.log(J) - 1) - MU * (1 - J ** (2 / 3) / 3), 2.0, 4.0)
LIMIT = tension(J_LIMIT)


def cube(share: float, analysis: str = "inverse", **solver: Any) -> Job:
    """Under a share of the tension that it carries, by arc-length continuation."""
    mesh = box((2, 1, 1), hexahedra=True)
    return job(
        analysis=analysis,
        mesh=mesh | {"file": str((HERE.parent / mesh["file"]).resolve())},
        material=NEO_HOOKEAN,
        effects=[{"effect": "pressure", "region": f"{i}1", "pressure": -share * LIMIT} for i in "xyz"],
        supports=[{"region": f"{i}0", "fix": [i]} for i in "xyz"],
        discretisation={"formulation": "displacement"},
        solver={"strategy": "arc-length"} | solver,
    )


def tried(job: Job, comm: MPI.Intracomm) -> list[Solve]:
    """Every solve of a job's first solution, whether it reaches the full load or not."""
    body = build_body(job.mesh, job.regions, comm, resolve=job.resolve)
    method = DirectMethod(Equations(job, body, Timings()), job.directions[0])
    solves = list(method.solves())
    method.equilibrium.destroy()
    return solves
