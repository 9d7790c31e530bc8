"""Coulomb friction on rigid obstacles, and what a given shape on one needs to be assumed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.errors import JobError, MeshError, SolveError
from hpcinv.mesh import build_body
from hpcinv.output.result import Result
from hpcinv.solver.equations import Equations
from hpcinv.trust.certificate.check import Verdict

GIVEN: dict[str, Any] = {
    "analysis": "forward",
    "mesh": box((2, 2, 2), hexahedra=True),
    "material": {"law": "neo-hookean", "mu": 1.0, "lam": 2.0},
    "solver": {"tolerance": 1e-12},
    "discretisation": {"displacement": 1},
}
FLOOR = {"shape": "plane", "point": [0, 0, 0], "normal": [0, 0, 1]}
WEIGHT = {"effect": "gravity", "acceleration": [0, 0, -0.2], "density": 1.0}
FRICTION = 0.3


def floor(**data: Any) -> dict[str, Any]:
    return {"effect": "contact", "region": "z0", "obstacle": FLOOR, **data}


def top(*displacement: float) -> list[dict[str, Any]]:
    return [{"region": "z1", "displacement": list(displacement)}]


def solved(comm: MPI.Intracomm, effects: list[dict[str, Any]], supports: list[dict[str, Any]], **data: Any) -> Result:
    return hpcinv.run(job(**GIVEN | {"effects": effects, "supports": supports} | data), comm)


@pytest.mark.parallel([2, 1])
def test_a_free_block_sticks_to_a_ramp_and_friction_carries_its_weight(comm: MPI.Intracomm) -> None:
    """The axes are the ramp's. Nothing but friction holds the block along it."""
    tilt = np.deg2rad(15)
    weight = 0.2 * np.array([np.sin(tilt), 0, -np.cos(tilt)])
    gravity = WEIGHT | {"acceleration": weight.tolist()}
    (contact,) = solved(comm, [gravity, floor(friction=0.6)], []).solutions[0].contacts
    assert contact.force == pytest.approx(tuple(-weight), abs=1e-9)
    assert contact.friction is not None
    assert contact.friction.sliding_area < contact.area
    sizes = np.sqrt(sum(part.x.array**2 for part in contact.friction.tractions))
    assert (sizes <= 0.6 * contact.fields[1].x.array + 1e-9).all()


def test_a_block_on_a_ramp_above_the_angle_of_friction_finds_no_rest(comm: MPI.Intracomm) -> None:
    tilt = np.deg2rad(25)
    gravity = WEIGHT | {"acceleration": [0.2 * np.sin(tilt), 0, -0.2 * np.cos(tilt)]}
    solver = GIVEN["solver"] | {"strategy": "fixed", "steps": 1}
    with pytest.raises(SolveError, match="load factor 0") as error:
        solved(comm, [gravity, floor(friction=FRICTION)], [], solver=solver)
    along, pressing = 0.2 * np.sin(tilt), 0.2 * np.cos(tilt)
    text = f"load along the plane, {1e3 * along:.3g} mN, exceeds 0.3 × {1e3 * pressing:.3g} mN"
    assert f"Friction cannot hold the body: its {text}" in error.value.advice
    assert f"raise the friction above {np.tan(tilt):.3g}" in error.value.advice
    push = {"effect": "pressure", "region": "x0", "pressure": 0.1}  # it turns with the face
    with pytest.raises(SolveError) as other:
        solved(comm, [WEIGHT, push, floor(friction=FRICTION)], [], solver=solver)
    assert "Whether friction can hold the body is not decided" in other.value.advice


@pytest.mark.release
@pytest.mark.parametrize("mover", ["block", "floor"])
def test_dragging_loses_friction_times_the_way(mover: str, comm: MPI.Intracomm) -> None:
    """The block is pressed on at first, then block or floor is dragged by 10 cm."""
    way = np.array([0.08, 0.06, 0.0])
    push = {"effect": "traction", "region": "z1", "traction": [0, 0, -1e-3], "area_in": "reference", "case": "press"}
    travel = {"travel": way.tolist(), "case": "drag"} if mover == "floor" else {}
    moved = {"displacement": [0.08, 0.06, None], "case": "drag"} if mover == "block" else {"fix": ["x", "y"]}
    effects, supports = [push, floor(friction=FRICTION, **travel)], [{"region": "z1", **moved}]
    (contact,) = solved(comm, effects, supports, load_cases=["press", "drag"]).solutions[0].contacts
    against = way if mover == "floor" else -way
    assert contact.force[2] == pytest.approx(1e-3, rel=1e-9)
    assert contact.force[:2] == pytest.approx(FRICTION * 1e-3 * against[:2] / 0.1, rel=1e-2)
    assert np.linalg.norm(contact.force[:2]) == pytest.approx(FRICTION * 1e-3, rel=2e-3)
    assert contact.friction is not None
    assert contact.friction.sliding_area == pytest.approx(contact.area, rel=1e-9)
    assert contact.friction.energy_lost == pytest.approx(FRICTION * 1e-3 * 0.1, rel=1e-2)
    states = contact.friction.state.x.array
    assert set(states[contact.fields[1].x.array > 0]) == {2.0}


@pytest.mark.release
def test_without_friction_a_closure_presses_as_contact_does(comm: MPI.Intracomm) -> None:
    """A block between smooth walls has a uniform pressure."""
    effects, supports = [floor()], [{"region": "z1", "displacement": [None, None, -0.05]}]
    sides: list[dict[str, Any]] = [{"region": "x0", "fix": ["x"]}, {"region": "y0", "fix": ["y"]}, *supports]
    plain = solved(comm, effects, sides).solutions[0]
    paired = solved(comm, [floor(closure="given")], sides, analysis="round_trip", first="forward").solutions[0]
    assert "friction" not in plain.contacts[0].as_data()
    assert paired.contacts[0].assumption == "on 'obstacle', without friction"
    assert paired.contacts[0].force == pytest.approx(plain.contacts[0].force, abs=1e-4)
    assert np.abs(paired.u - plain.u).max() < 1e-4  # of which plain contact penetrates 1/65536


@pytest.mark.release
def test_a_very_rough_floor_clamps(comm: MPI.Intracomm) -> None:
    push = {"effect": "traction", "region": "z1", "traction": [0.01, 0.005, -0.1], "area_in": "reference"}
    sticks = solved(comm, [push, floor(friction=2.0)], []).solutions[0]
    clamped = solved(comm, [push], [{"region": "z0", "fix": ["x", "y", "z"]}]).solutions[0]
    assert np.abs(sticks.u - clamped.u).max() < 1e-9
    assert sticks.contacts[0].friction is not None
    assert sticks.contacts[0].friction.energy_lost == 0.0


SPHERE = {"shape": "sphere", "centre": [0.5, 0.4, -0.9], "radius": 1.0}


@pytest.mark.parametrize("obstacle", [FLOOR, SPHERE], ids=["plane", "sphere"])
def test_tangent_is_the_derivative(obstacle: dict[str, Any], comm: MPI.Intracomm) -> None:
    effects = [floor(friction=FRICTION, obstacle=obstacle)]
    posed = job(**GIVEN | {"effects": effects, "supports": top(0, 0, 0)})
    body = build_body(posed.mesh, posed.regions, comm, resolve=posed.resolve, degree=1)
    equations = Equations(posed, body, Timings())
    system = equations.equilibrium(equations.weak_form("forward")).system
    random, state = np.random.default_rng(1), system.state.x.array
    state[:] = 1e-3 * random.standard_normal(len(state))
    equations.supports.impose(state)
    system.weak_form.contacts.locate()
    (pair,) = system.weak_form.contacts.pairs
    system.linearise(1.0)
    assert (pair.pressures > 0).any()
    here, step = state.copy(), system.rhs.duplicate()
    step.array[:] = random.standard_normal(len(state))
    equations.supports.free(step.array)
    changes = []
    for share in (1e-8, -1e-8):
        state[:] = here + share * step.array
        system.residual(system.rhs)
        changes.append(np.array(system.rhs.array))
    expected = (changes[0] - changes[1]) / 2e-8
    system.matrix.mult(step, system.rhs)
    assert np.abs(system.rhs.array - expected).max() < 1e-8 * np.abs(expected).max()


@pytest.mark.release
@pytest.mark.parallel([3, 1])
@pytest.mark.parametrize("closure", ["coulomb", pytest.param("given", marks=pytest.mark.release)])
def test_friction_on_an_obstacle_closes(closure: str, comm: MPI.Intracomm) -> None:
    solver = GIVEN["solver"] | ({"strategy": "fixed", "steps": 1} if closure == "coulomb" else {})
    first = "forward" if closure == "given" else "inverse"
    effects = [WEIGHT, floor(friction=FRICTION, closure=closure)]
    result = solved(comm, effects, top(0.05, 0, -0.05), analysis="round_trip", first=first, solver=solver)
    assert result.errors["round_trip"]["max"] < 1e-10
    there, back = (solution.contacts[0] for solution in result.solutions)
    assert back.force == pytest.approx(there.force, abs=1e-9)
    forward = there if first == "forward" else back
    assert forward.friction is not None
    assert forward.friction.sliding_area > 0.5 * forward.area


@pytest.mark.release
def test_an_obstacle_that_travels_drags_as_a_support_that_moves_back(comm: MPI.Intracomm) -> None:
    inverse = {"analysis": "inverse"}
    moved = solved(comm, [WEIGHT, floor(friction=FRICTION, closure="coulomb")], top(0.05, 0, -0.05), **inverse)
    travels = floor(friction=FRICTION, closure="coulomb", travel=[-0.05, 0, 0])
    still = solved(comm, [WEIGHT, travels], top(0, 0, -0.05), **inverse)
    (one,), (other,) = (result.solutions[0].contacts for result in (moved, still))
    assert other.force == pytest.approx(one.force, abs=1e-9)
    shift = moved.solutions[0].u - still.solutions[0].u
    assert np.abs(shift - [0.05, 0, 0]).max() < 1e-8


@pytest.mark.everyday("conforming")
@pytest.mark.parametrize("closure", ["conforming", "gap"])
def test_unloaded_bodies_have_the_assumed_gap(closure: str, comm: MPI.Intracomm) -> None:
    data = {"closure": closure} | ({"rest_gap": 0.01} if closure == "gap" else {})
    quantities = [{"name": "gap", "of": "Z", "on": "z0", "reduce": "mean"}]
    checked = {"quantities": quantities, "certificate": {"level": "quick"}}
    result = solved(comm, [WEIGHT, floor(**data)], top(0.05, 0, -0.05), analysis="inverse", **checked)
    assert result.solutions[0].contacts[0].distance < 1e-9
    assert result.quantities["gap"] == pytest.approx(0.01 if closure == "gap" else 0.0, abs=1e-3)
    lines = {line.name: line for line in result.certificate.lines}
    assert lines["overlap of the loaded bodies at 'z0'"].verdict is Verdict.PASS
    assert lines["least contact pressure at 'z0'"].verdict is Verdict.PASS


def test_certificate_says_where_sticking_needs_more_than_friction(comm: MPI.Intracomm) -> None:
    effects = [WEIGHT, floor(friction=FRICTION, closure="stick")]
    certificate = {"certificate": {"level": "quick"}}
    result = solved(comm, effects, top(0.05, 0, -0.05), analysis="inverse", **certificate)
    (line,) = (line for line in result.certificate.lines if line.name == "friction on 'z0'")
    assert line.verdict is Verdict.WARN
    assert "surfaces that stick need" in line.note


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"friction": 2.5}, r"effects\[0\]\.friction: must be from 0 to 2"),
        ({"friction": 0.3, "stiffness": 10.0}, r"effects\[0\]\.stiffness: is not valid with 'friction' or a 'closure'"),
        ({"closure": "coulomb"}, r"effects\[0\]\.closure: 'coulomb' needs 'friction'"),
        ({"closure": "gap"}, r"effects\[0\]\.rest_gap: must be given with 'closure: gap'"),
        ({"friction": 0.3}, r"effects\[0\]\.closure: is missing"),
    ],
)
def test_bad_input_is_refused(data: dict[str, Any], message: str) -> None:
    with pytest.raises(JobError, match=message):
        job(**GIVEN | {"analysis": "inverse", "effects": [floor(**data)], "supports": top(0, 0, 0)})


def test_an_obstacle_in_the_unloaded_body_is_refused(comm: MPI.Intracomm) -> None:
    high = FLOOR | {"point": [0, 0, 0.1]}
    with pytest.raises(MeshError, match=r"the obstacle overlaps 'z0' of the unloaded body by 0\.1 m"):
        solved(comm, [floor(friction=FRICTION, obstacle=high)], top(0, 0, 0))


@pytest.mark.release
def test_the_truth_is_in_the_interval_over_pressures_of_an_obstacle(comm: MPI.Intracomm) -> None:
    """The rest body of the truth touches the floor, so `conforming` finds it, and an end of each interval is near."""
    quantities = [{"name": "gap", "of": "Z", "on": "z0", "reduce": "mean"}]
    data = {"analysis": "inverse", "quantities": quantities, "certificate": {"level": "quick"}}
    contact = floor(closure="conforming", known={"greatest_rest_gap": 0.02})
    result = solved(comm, [WEIGHT, contact], top(0, 0, -0.05), uncertainty="contact", **data)
    (line,) = (line for line in result.certificate.lines if "'gap'" in line.name)
    assert line.interval is not None
    assert line.interval["low"] == pytest.approx(0.0, abs=1e-4)
    assert line.interval["low"] - 1e-9 <= result.quantities["gap"] <= line.interval["high"]
    assert line.interval["high"] == pytest.approx(0.02, rel=0.2)
