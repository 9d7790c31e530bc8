"""Whether the forces of a solution balance: the equilibrium residual relative to the load."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import hpcinv.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
import numpy as np

from hpcinv.certificate.check import Line, Verdict, at_most
from hpcinv.parallel.runtime import MPI

if TYPE_CHECKING:
    from hpcinv.solver.equilibrium import Equilibrium
    from hpcinv.solver.problem import Model

NAME = "equilibrium residual, relative to the load"


def balance(model: Model, equilibrium: Equilibrium) -> Iterator[Line]:
    """Compare ``‖R‖`` at the displacements that are free with the nodal loads and reactions; collective.

    The load is the difference that the load factor makes to ``R``, or the reactions of the supports where those are
    larger (prescribed motion is no force).
    """
    comm = model.body.mesh.comm
    dofs = model.unknowns.owned_displacement_dofs
    held = [prescribed.dofs for prescribed in model.supports.prescribed]
    free = np.setdiff1d(dofs, np.concatenate(held)) if held else dofs

    def norm(forces: np.ndarray, where: np.ndarray) -> float:
        return float(np.sqrt(comm.allreduce(float(np.sum(forces[where] ** 2)), op=MPI.SUM)))

    none, full = equilibrium.system.forces(0.0), equilibrium.system.forces(1.0)
    load = max(norm(full - none, dofs), norm(full, dofs))
    left = norm(full, free)
    if load == 0.0:
        yield Line(NAME, 0.0, "", "", Verdict.PASS, "nothing loads the body")
    else:
        yield at_most(NAME, left / load, warn=1e-7, fail=1e-3)
