"""Every effect: a consistent tangent, exact round trips, and nothing left behind where it is not asked for.

The registry drives the tests: a new effect is tested by its ``example``, on a block that stands on its face z0.
"""

from __future__ import annotations

import json
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from ffcx.naming import compute_signature
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.job.job import Job
from hpcinv.mesh import build_body
from hpcinv.model.weak_form import WeakForm
from hpcinv.physics.effects import Effect, effects
from hpcinv.solver.equations import Equations

MATERIAL = {"law": "neo-hookean", "mu": "30 kPa", "lam": "120 kPa"}
DIRECTIONS = ("forward", "inverse")
EXAMPLES: dict[str, Effect] = {
    name: effect.model_validate(effect.example) for name, effect in effects().items() if not effect.only_of_kind
}

of_every_effect = pytest.mark.parametrize("name", EXAMPLES)
on_both_cells = pytest.mark.parametrize(
    "hexahedra", [False, pytest.param(True, marks=pytest.mark.release)], ids=["tetrahedra", "hexahedra"]
)


def case(*names: str, hexahedra: bool = False, **changes: Any) -> Job:
    """A block of linear cells under the examples of these effects, with the fibres that they need."""
    families = dict.fromkeys(family for name in names for family in EXAMPLES[name].families)
    return job(
        mesh=box((2, 2, 2), hexahedra=hexahedra),
        fibres={f: {"direction": [1, "0.3*X/(1 m)", 0.2 + i], "given_on": "reference"} for i, f in enumerate(families)},
        material=MATERIAL,
        effects=[EXAMPLES[name].example for name in names],
        supports=[{"region": "z0", "fix": ["x", "y", "z"]}],
        discretisation={"displacement": 1},
        **changes,
    )


def names_with_a_load(name: str) -> tuple[str, ...]:
    """The effect, with gravity if the effect only holds the body."""
    return (name, "gravity") if EXAMPLES[name].holds else (name,)


def model(case: Job, comm: MPI.Intracomm) -> Equations:
    return Equations(case, build_body(case.mesh, case.regions, comm, resolve=case.resolve), Timings())


@pytest.mark.everyday("inverse")
@on_both_cells
@pytest.mark.parametrize("direction", DIRECTIONS)
@of_every_effect
def test_tangent_is_the_derivative_of_the_residual(
    name: str, direction: Any, hexahedra: bool, comm: MPI.Intracomm
) -> None:
    """Taylor: what the tangent leaves of the residual's change is of second order."""
    block = model(case(*names_with_a_load(name), hexahedra=hexahedra), comm)
    weak_form = block.weak_form(direction)
    block.put_load(0.7)
    equilibrium = block.equilibrium(weak_form)
    snes, state = equilibrium.snes, weak_form.unknowns.state

    random = np.random.default_rng(7)
    held = np.concatenate([condition.dof_indices()[0] for condition in block.supports.conditions])
    fields = []
    for size in (0.02, 1.0):
        values = random.normal(scale=size, size=state.x.array.size)
        values[held] = 0
        field = equilibrium.system.rhs.duplicate()
        field.array[:] = values
        fields.append(field)
    start, change = fields

    def residual(x: Any) -> np.ndarray:
        vector = equilibrium.system.rhs.duplicate()
        snes.computeFunction(x, vector)
        return np.array(vector.array)

    snes.computeJacobian(start, equilibrium.system.matrix)
    before, slope = residual(start), np.array((equilibrium.system.matrix * change).array)
    steps = [1e-3 / 2**k for k in range(4)]
    left = [np.linalg.norm(residual(start + h * change) - before - h * slope) for h in steps]
    rates = np.log2(np.array(left[:-1]) / left[1:])
    print(f"{name}, {direction}: remainders {left[0]:.1e} to {left[-1]:.1e}, rates {rates.round(3)}")
    assert equilibrium.system.min_mesh_J() > 0
    assert np.abs(rates - 2).max() < 0.05
    equilibrium.destroy()


@pytest.mark.everyday("=1-pressure")
@pytest.mark.parallel([2, 1])
@of_every_effect
def test_round_trips_close_under_each_effect(name: str, comm: MPI.Intracomm) -> None:
    for hexahedra, first in ((False, "forward"), (True, "inverse")):
        given = case(*names_with_a_load(name), hexahedra=hexahedra, analysis="round_trip", first=first)
        result = hpcinv.run(given, comm)
        largest = comm.allreduce(float(np.linalg.norm(result.solutions[0].u, axis=1).max()), op=MPI.MAX)
        gap = result.errors["round_trip"]["max"] / largest
        cells = "hexahedra" if hexahedra else "tetrahedra"
        what = f"{name}, {cells}, {first} first: largest displacement {largest:.4f} m, closes to {gap:.1e} of it"
        print(what)
        assert largest > 1e-3, what
        assert gap < 2e-11, what


def footprint(weak_form: WeakForm) -> dict[str, Any]:
    """Signatures, integrals, constants and unknowns of a weak form, as plain data."""
    trial = ufl.TrialFunction(weak_form.unknowns.space)
    tangent = ufl.derivative(weak_form.residual, weak_form.unknowns.state, trial)
    ((stress, _),) = weak_form.cauchy_stress
    at_a_point = [(stress, np.array([[0.25, 0.25, 0.25]]))]
    integrals = {(i.integral_type(), str(i.subdomain_id())) for i in weak_form.residual.integrals()}
    return {
        "kernels": [compute_signature(part, "") for part in ([weak_form.residual], [tangent], at_a_point)],
        "integrals": sorted(map(list, integrals)),
        "unknowns": [weak_form.unknowns.size, str(weak_form.unknowns.space.ufl_element())],
        "coefficients": [str(c.ufl_element()) for c in weak_form.residual.coefficients()],
        "constants": [c.value.size for c in weak_form.residual.constants()],
    }


@cache
def footprints(*names: str) -> dict[str, dict[str, Any]]:
    """Of a block under these effects, in both directions."""
    block = model(case(*names), MPI.COMM_SELF)
    return {direction: footprint(block.weak_form(direction)) for direction in DIRECTIONS}


ALONE = """
import json, pkgutil, sys
found = pkgutil.iter_modules
def only_gravity(path=None, prefix=""):
    kept = {"effect", "gravity"} if any(str(p).endswith("effects") for p in path or ()) else None
    return (m for m in found(path, prefix) if kept is None or m.name in kept)
pkgutil.iter_modules = only_gravity
import hpcinv.base.parallel.runtime
sys.path[:0] = sys.argv[1:]
from test_effects import EXAMPLES, footprints
print(json.dumps([list(EXAMPLES), footprints(), footprints("gravity")]))
"""


@pytest.mark.release
def test_effects_that_are_not_listed_do_not_change_the_weak_form() -> None:
    command = [sys.executable, "-c", ALONE, *map(str, Path(__file__).parents[:2])]
    *_, last = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
    known, bare, loaded = json.loads(last)
    # The model knows contact by its name, and cavities their pressure.
    assert known == ["contact", "gravity", "pressure"]
    assert len(EXAMPLES) > 1
    assert bare == footprints()
    assert loaded == footprints("gravity")
    assert bare != loaded


@of_every_effect
def test_an_effect_adds_its_own_numbers_and_integrals_only(name: str) -> None:
    effect, bare, loaded = EXAMPLES[name], footprints(), footprints(name)
    # Each formula of a direction is joined by its unit, and all of them by the metre.
    formulas = 3 * len(effect.families)
    added = sum(map(entries, effect.quantities().values())) + formulas + (formulas > 0)
    for direction in DIRECTIONS:
        before, after = bare[direction], loaded[direction]
        assert after["kernels"][:2] != before["kernels"][:2]
        assert after["unknowns"] == before["unknowns"]
        assert after["coefficients"] == before["coefficients"]
        grows = direction == "forward" and effect.presses_at_any_load  # a number: whether it grows with the load
        assert after["constants"] == [before["constants"][0] + added + grows]
        more = [i for i in after["integrals"] if i not in before["integrals"]]
        assert [i for i in after["integrals"] if i not in more] == before["integrals"]
        assert [kind for kind, _ in more] == ["exterior_facet"] * len(effect.surfaces)


def entries(quantity: tuple[Any, Any]) -> int:
    """How many numbers a quantity is."""
    value, _ = quantity
    return 0 if value is None else np.size(value)
