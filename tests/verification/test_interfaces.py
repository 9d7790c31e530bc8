"""Interfaces between two bodies of one mesh: patch tests, conforming meshes, and back to the given body."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.mesh import build_body
from hpcinv.output.result import Result
from hpcinv.solver.equations import Equations

SOFT = {"law": "neo-hookean", "mu": 1.0, "lam": 2.0}
BOTH = ["bottom", "top"]
ROLLERS = [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"]
CLAMP = [{"region": "z0", "fix": ["x", "y", "z"]}]
PUSH = {"effect": "traction", "region": "z1", "traction": [0, 0, -0.3], "area_in": "reference"}
SHEAR = {"effect": "traction", "region": "z1", "traction": [0.1, 0.05, 0.2], "area_in": "reference"}
REFERENCE = {"area_in": "reference"}
GIVEN: dict[str, Any] = {
    "analysis": "forward",
    "material": SOFT,
    "solver": {"tolerance": 1e-12},
    "discretisation": {"displacement": 1},
}


def blocks(**parameters: Any) -> dict[str, Any]:
    return {"file": "../meshes/two_blocks.py", "parameters": parameters}


def solved(comm: MPI.Intracomm, kind: str, **data: Any) -> Result:
    """Solve a job with an interface of a kind, without one if it is empty."""
    interfaces = [{"between": BOTH, "kind": kind}] if kind else []
    return hpcinv.run(job(**GIVEN | {"interfaces": interfaces} | data), comm)


FORMS: dict[str, dict[str, Any]] = {
    "tetrahedra": {"discretisation": {"displacement": 1}},
    "quadratic": {"discretisation": {"displacement": 2}},
    "hexahedra": {"discretisation": {"displacement": 1}, "mesh": {"hexahedra": True}},
    "mixed": {"discretisation": {"displacement": 2, "formulation": "mixed"}},
    "quadratic-hexahedra": {"discretisation": {"displacement": 2}, "mesh": {"hexahedra": True}},
}


CASES = [(kind, form) for kind in ("tied", "sliding", "contact") for form in FORMS]
DAILY = [
    ("tied", "tetrahedra"),
    ("tied", "quadratic-hexahedra"),
    ("sliding", "quadratic"),
    ("contact", "tetrahedra"),
    ("contact", "mixed"),
]


@pytest.mark.everyday("tied-tetrahedra", "tied-quadratic-hexahedra", "contact-tetrahedra")
@pytest.mark.parametrize(
    ("kind", "form"), [pytest.param(*case, marks=() if case in DAILY else pytest.mark.release) for case in CASES]
)
def test_blocks_of_unequal_meshes_have_uniform_stress(comm: MPI.Intracomm, kind: str, form: str) -> None:
    mesh = blocks(**FORMS[form].get("mesh", {}))
    data = {"mesh": mesh, "discretisation": FORMS[form]["discretisation"], "effects": [PUSH], "supports": ROLLERS}
    solution = solved(comm, kind, **data).solutions[0]
    x, u = solution.mesh_nodes, solution.u
    strain = np.diag((u * x).sum(axis=0) / (x**2).sum(axis=0))
    assert np.abs(u - x @ strain).max() < 1e-10
    area = (1 + strain[0, 0]) * (1 + strain[1, 1])
    stress = solution.cauchy_stress.x.array.reshape(-1, 3, 3)
    assert np.abs(stress - np.diag([0, 0, -0.3 / area])).max() < 1e-10
    contact = solution.contacts[0]
    assert contact.force == pytest.approx((0, 0, 0.3), abs=1e-10)
    assert contact.area == pytest.approx(1.0 if kind == "tied" else area, abs=1e-10)
    pressures = contact.fields[0].x.array[contact.fields[0].x.array != 0]
    assert pressures == pytest.approx(0.3 if kind == "tied" else 0.3 / area, abs=1e-8)


@pytest.mark.everyday("2-inverse")
@pytest.mark.parametrize("analysis", ["forward", "inverse"])
@pytest.mark.parametrize("degree", [1, 2])
def test_tied_blocks_of_equal_meshes_are_one_block(comm: MPI.Intracomm, analysis: str, degree: int) -> None:
    data = {"analysis": analysis, "effects": [SHEAR], "supports": CLAMP, "discretisation": {"displacement": degree}}
    tied = solved(comm, "tied", mesh=blocks(lower=2, upper=2, hexahedra=True), **data).solutions[0]
    whole = solved(comm, "", mesh=box((2, 2, 2), hexahedra=True), **data).solutions[0]
    places = np.round(whole.mesh_nodes, 9)
    for x, u in zip(np.round(tied.mesh_nodes, 9), tied.u, strict=True):
        (same,) = np.flatnonzero((places == x).all(axis=1))
        assert np.abs(whole.u[same] - u).max() < 1e-10


@pytest.mark.release
@pytest.mark.parallel([3, 2, 1])
@pytest.mark.parametrize("first", ["inverse", "forward"])
def test_tied_blocks_come_back(comm: MPI.Intracomm, first: str) -> None:
    mesh = blocks(lower=2, upper=3)
    data = {"analysis": "round_trip", "first": first, "effects": [SHEAR], "supports": CLAMP}
    result = solved(comm, "tied", mesh=mesh, discretisation={"displacement": 2}, **data)
    assert result.errors["round_trip"]["max"] < 1e-12
    there, back = (solution.contacts[0] for solution in result.solutions)
    assert back.force == pytest.approx(there.force, abs=1e-10)


@pytest.mark.release
@pytest.mark.parallel([3, 1])
def test_bodies_that_are_pressed_together_carry_what_one_body_does(comm: MPI.Intracomm) -> None:
    """Two blocks are 5 cm apart, and the upper one is moved down by 10 cm."""

    def pressed(by: float) -> list[dict[str, Any]]:
        return [*ROLLERS, {"region": "z1", "displacement": [None, None, -by]}]

    contact = solved(comm, "contact", mesh=blocks(gap=0.05), supports=pressed(0.1)).solutions[0].contacts[0]
    whole = solved(comm, "", mesh=box((1, 1, 1), hexahedra=True), supports=pressed(0.05)).solutions[0]
    parts = [whole.cauchy_stress.x.array.reshape(-1, 3, 3)[:, 2, 2], whole.u[:, 0]]
    stress, wider = (comm.allreduce(float(np.abs(part).max(initial=0.0)), op=MPI.MAX) for part in parts)
    assert contact.area == pytest.approx((1 + wider) ** 2, rel=1e-9)
    assert contact.force == pytest.approx((0, 0, stress * (1 + wider) ** 2), rel=1e-8, abs=1e-9)


def test_contact_opens_where_bodies_are_pulled_apart(comm: MPI.Intracomm) -> None:
    lifted = {"effect": "traction", "region": "z1", "traction": [0, 0, "-0.2 Pa + 0.25*X*(1 Pa/m)"]}
    solution = solved(comm, "contact", mesh=blocks(), effects=[lifted | REFERENCE], supports=ROLLERS).solutions[0]
    contact = solution.contacts[0]
    assert contact.force[2] == pytest.approx(0.2 - 0.25 / 2, rel=1e-9)
    assert 0.3 < contact.area < 0.95
    assert contact.penetration < 1e-11
    pressure = contact.fields[0].x.array
    assert pressure.min() == 0.0
    places = contact.fields[0].function_space.tabulate_dof_coordinates()[:, 0]
    assert places[pressure.argmax()] < 0.4 * places.max()
    assert places[(pressure == 0) & (places > 0.9 * places.max())].size


@pytest.mark.release
@pytest.mark.parallel([2, 1])
@pytest.mark.parametrize("first", ["inverse", "forward"])
def test_blocks_that_slide_come_back(comm: MPI.Intracomm, first: str) -> None:
    x = "X" if first == "forward" else "x"
    pressed = {"effect": "traction", "region": "z1", "traction": [0, 0, f"-0.1 Pa - 0.2*{x}*(1 Pa/m)"]}
    data = {"analysis": "round_trip", "first": first, "effects": [pressed | REFERENCE], "supports": ROLLERS}
    result = solved(comm, "sliding", mesh=blocks(), **data)
    assert result.errors["round_trip"]["max"] < 1e-12
    there, back = (solution.contacts[0] for solution in result.solutions)
    assert back.force == pytest.approx(there.force, abs=1e-9)


@pytest.mark.parametrize("kind", ["tied", "sliding", "contact"])
def test_tangent_is_the_derivative_of_the_forces(comm: MPI.Intracomm, kind: str) -> None:
    posed = job(**GIVEN | {"mesh": blocks(), "supports": ROLLERS, "interfaces": [{"between": BOTH, "kind": kind}]})
    body = build_body(posed.mesh, posed.regions, comm, resolve=posed.resolve, degree=1)
    equations = Equations(posed, body, Timings())
    system = equations.equilibrium(equations.weak_form("forward")).system
    random = np.random.default_rng(0)
    state = system.state.x.array
    state[:] = 1e-2 * random.standard_normal(len(state))
    equations.supports.impose(state)
    system.locate_contacts()
    system.linearise(1.0)
    here, step = state.copy(), system.rhs.duplicate()
    step.array[:] = random.standard_normal(len(state))
    equations.supports.free(step.array)
    changes = []
    for share in (1e-6, -1e-6):
        state[:] = here + share * step.array
        system.residual(system.rhs)
        changes.append(np.array(system.rhs.array))
    expected = (changes[0] - changes[1]) / 2e-6
    system.matrix.mult(step, system.rhs)
    assert np.abs(system.rhs.array - expected).max() < 1e-6 * np.abs(expected).max()
