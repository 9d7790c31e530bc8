"""One door: `Equations.put` alone writes the state, and looking something up changes nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.verification import box, job

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.mesh import build_body
from hpcinv.solver.equations import Equations

WRITES = {
    "mesh": "model.body.mesh.geometry.x[0] = 1.0",
    "unknowns": "model.unknowns.state.x.array[:] = 1.0",
    "unknowns by PETSc": "model.unknowns.state.x.petsc_vec.array[:] = 1.0",
    "parameters": "weak_form.parameters.constant.value[0] = 1.0",
    "load factor": "weak_form.parameters.set_load(0.5)",
    "supports": "model.supports.scale(0.5)",
}


def one_cell(**changes: Any) -> Equations:
    given = job(
        mesh=box((1, 1, 1), hexahedra=True),
        material={"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
        effects=[{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 200}],
        **{"supports": [{"region": "z0", "displacement": [0, 0, "1 mm"]}]} | changes,
    )
    return Equations(given, build_body(given.mesh, given.regions, MPI.COMM_SELF, resolve=given.resolve), Timings())


def copies(model: Equations) -> list[np.ndarray]:
    constants = [form.parameters.constant.value for form in (model.weak_form("inverse"), model.weak_form("forward"))]
    supports = [entry.now.x.array for entry in model.supports.prescribed]
    return [array.copy() for array in (model.body.nodes, model.unknowns.state.x.array, *constants, *supports)]


@pytest.mark.parametrize("write", WRITES.values(), ids=list(WRITES))
def test_writes_of_the_package_around_the_door_raise_or_have_no_effect(write: str) -> None:
    model = one_cell()
    before = copies(model)
    elsewhere = {"__name__": "hpcinv.elsewhere", "model": model, "weak_form": model.weak_form("forward")}
    if "petsc_vec" in write:
        exec(write, elsewhere)
    else:
        with pytest.raises(ValueError, match="read-only"):
            exec(write, elsewhere)
    assert all(np.array_equal(a, b) for a, b in zip(before, copies(model), strict=True))


def test_put_sets_the_load_factor_of_weak_forms_and_supports_made_before_and_after() -> None:
    model = one_cell()
    early = model.weak_form("inverse")
    state = model.state(load=0.25)
    model.put(state)
    for form in (early, model.weak_form("forward")):
        assert form.parameters.constant.value[0] == 0.25
    held = model.supports.prescribed[2]
    assert np.array_equal(held.now.x.array, 0.25 * held.full)
    assert np.abs(held.full).max() > 0


def test_looking_up_a_weak_form_leaves_the_direction_of_supports() -> None:
    model = one_cell(supports=[{"region": "x0", "fix": ["normal"]}, {"region": "z0", "fix": ["x", "y", "z"]}])
    system = model.equilibrium(model.weak_form("inverse")).system
    system.set_load(0.5)
    assert model.supports.sliding is not None
    assert model.supports.sliding.sign == -1
    model.weak_form("forward")
    assert model.supports.sliding.sign == -1
    system.destroy()
