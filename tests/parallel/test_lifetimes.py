"""What equations hold goes with them: MPICH has 2,048 communicators for a process, and each mesh has some."""

from __future__ import annotations

import gc
from weakref import ref

import pytest
from helpers.verification import box, job

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.mesh import build_body
from hpcinv.solver.equations import Equations


@pytest.mark.parametrize("linear", ["direct", "iterative"])
@pytest.mark.parametrize("modulus", ["40 kPa", "incompressible"])
def test_a_mesh_goes_with_equations_that_have_solved_and_were_not_destroyed(linear: str, modulus: str) -> None:
    given = job(
        mesh=box((1, 1, 1), hexahedra=True),
        material={"law": "neo-hookean", "mu": "10 kPa", "lam": modulus},
        effects=[{"effect": "gravity", "acceleration": [0, 0, -1], "density": 200}],
        supports=[{"region": "z0", "fix": ["x", "y", "z"]}],
        solver={"linear": linear},
    )
    equations = Equations(given, build_body(given.mesh, given.regions, MPI.COMM_SELF, resolve=given.resolve), Timings())
    equilibrium = equations.equilibrium(equations.weak_form("forward"))
    system = equilibrium.system
    system.set_load(1.0)
    system.linearise(1.0)
    system.residual(system.rhs)
    equilibrium.linear.factorize()
    assert equilibrium.linear.back_substitute(system.rhs, system.rhs.duplicate())
    mesh = ref(equations.body)
    del equations, equilibrium, system
    gc.collect()
    assert mesh() is None
