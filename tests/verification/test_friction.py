"""Coulomb friction between two bodies of one mesh: blocks on ramps, dragged blocks, and the limits of friction."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.verification import job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.errors import JobError, MeshError
from hpcinv.mesh import build_body
from hpcinv.model.interfaces.surface_rotations import surface_rotations
from hpcinv.output.result import Result
from hpcinv.solver.equations import Equations
from hpcinv.solver.equilibrium_path import EquilibriumPath
from hpcinv.trust.certificate.check import Line, Verdict

CLAMP = {"region": "z0", "fix": ["x", "y", "z"]}
GIVEN: dict[str, Any] = {
    "analysis": "forward",
    "material": {"law": "neo-hookean", "mu": 1.0, "lam": 2.0},
    "solver": {"tolerance": 1e-12},
    "discretisation": {"displacement": 1},
    "supports": [CLAMP],
}
FRICTION = 0.3


def blocks(**parameters: Any) -> dict[str, Any]:
    return {"file": "../meshes/two_blocks.py", "parameters": {"upper_height": 0.2, **parameters}}


def interface(**data: Any) -> dict[str, Any]:
    return {"between": ["bottom", "top"], "kind": "contact", **data}


def solved(comm: MPI.Intracomm, contact: dict[str, Any], **data: Any) -> Result:
    return hpcinv.run(job(**GIVEN | {"interfaces": [interface(**contact)]} | data), comm)


def traction(*components: float) -> dict[str, Any]:
    return {"effect": "traction", "region": "z1", "traction": list(components), "area_in": "reference"}


@pytest.mark.parallel([2, 1])
def test_a_free_block_sticks_to_a_ramp_and_friction_carries_its_weight(comm: MPI.Intracomm) -> None:
    """The axes are the ramp's. Nothing but friction holds the upper block along it."""
    tilt = np.deg2rad(15)
    weight = 0.2 * np.array([np.sin(tilt), 0, -np.cos(tilt)])
    gravity = {"effect": "gravity", "acceleration": weight.tolist(), "density": 1.0}
    solution = solved(comm, {"friction": 0.6}, mesh=blocks(lower=1, upper=2), effects=[gravity]).solutions[0]
    (contact,) = solution.contacts
    assert contact.force == pytest.approx(tuple(-0.2 * weight), abs=1e-9)
    assert contact.friction is not None
    assert contact.friction.sliding_area < contact.area
    assert contact.friction.largest <= contact.friction.allowed * (1 + 1e-9)
    fields = [part.x.array for part in contact.friction.tractions]
    sizes, pressures = np.sqrt(sum(part**2 for part in fields)), contact.fields[1].x.array
    assert (sizes <= 0.6 * pressures + 1e-9).all()


RAMP: dict[str, Any] = {
    "mesh": {"file": "../meshes/two_blocks.py", "parameters": {"upper_height": 0.2, "lower": 1, "upper": 2}},
    "effects": [{"effect": "gravity", "acceleration": [0.05, 0, -0.19], "density": 1.0}],
}


@pytest.mark.release
def test_a_free_block_on_a_ramp_comes_back(comm: MPI.Intracomm) -> None:
    solver = GIVEN["solver"] | {"strategy": "fixed", "steps": 1}
    contact = {"friction": 0.6, "closure": "coulomb"}
    result = solved(comm, contact, analysis="round_trip", first="inverse", solver=solver, **RAMP)
    assert result.errors["round_trip"]["max"] < 1e-10
    assert result.solutions[0].contacts[0].force == pytest.approx((-0.01, 0, 0.038), rel=2e-3, abs=1e-9)


def test_friction_that_is_given_does_not_hold_a_free_block(comm: MPI.Intracomm) -> None:
    with pytest.raises(MeshError, match=r"'touching' .*: nothing but contact holds the part"):
        solved(comm, {"friction": 0.6, "closure": "touching"}, analysis="inverse", **RAMP)


@pytest.mark.release
@pytest.mark.parametrize(
    ("first", "hexahedra"),
    [("bottom", False), *(pytest.param("top", hexahedra, marks=pytest.mark.release) for hexahedra in (True, False))],
)
def test_a_dragged_block_loses_friction_times_its_way(comm: MPI.Intracomm, first: str, hexahedra: bool) -> None:
    """The block is pressed on at first, then dragged by 10 cm. The surfaces tilt by less than 0.001."""
    drag = [CLAMP, {"region": "z1", "displacement": [0.08, 0.06, None], "case": "drag"}]
    push = traction(0, 0, -1e-3) | {"case": "press"}
    contact = {"friction": FRICTION, "between": [first, "top" if first == "bottom" else "bottom"]}
    mesh = blocks(lower=3, upper=2, hexahedra=hexahedra)
    data = {"mesh": mesh, "effects": [push], "supports": drag, "load_cases": ["press", "drag"]}
    (report,) = solved(comm, contact, **data).solutions[0].contacts
    force = np.array(report.force) * (1 if first == "bottom" else -1)
    assert force[2] == pytest.approx(1e-3, rel=1e-9)
    assert force[:2] == pytest.approx(-FRICTION * 1e-3 * np.array([0.8, 0.6]), rel=1e-2)
    assert np.linalg.norm(force[:2]) == pytest.approx(FRICTION * 1e-3, rel=2e-3)
    assert report.friction is not None
    assert report.friction.sliding_area == pytest.approx(report.area, rel=1e-9)
    assert report.friction.energy_lost == pytest.approx(FRICTION * 1e-3 * 0.1, rel=1e-2)
    assert report.friction.largest == pytest.approx(report.friction.allowed, rel=1e-9)


@pytest.mark.release
@pytest.mark.parallel([3, 1])
@pytest.mark.parametrize(
    ("discretisation", "hexahedra"),
    [({"displacement": 2}, False), ({"displacement": 2, "formulation": "mixed"}, True)],
    ids=["quadratic", "mixed"],
)
def test_quadratic_and_mixed_blocks_lose_friction_times_their_way(
    discretisation: dict[str, Any], hexahedra: bool, comm: MPI.Intracomm
) -> None:
    drag = [CLAMP, {"region": "z1", "displacement": [0.08, 0.06, None], "case": "drag"}]
    push = traction(0, 0, -1e-3) | {"case": "press"}
    data: dict[str, Any] = {"mesh": blocks(lower=2, upper=1, hexahedra=hexahedra), "discretisation": discretisation}
    data |= {"effects": [push], "supports": drag, "load_cases": ["press", "drag"]}
    if "formulation" in discretisation:
        data["material"] = {"law": "neo-hookean", "mu": 1.0, "lam": 100.0}
    (report,) = solved(comm, {"friction": FRICTION}, **data).solutions[0].contacts
    force = np.array(report.force)
    assert force[2] == pytest.approx(1e-3, rel=1e-9)
    assert force[:2] == pytest.approx(-FRICTION * 1e-3 * np.array([0.8, 0.6]), rel=3e-2)
    assert np.linalg.norm(force[:2]) == pytest.approx(FRICTION * 1e-3, rel=5e-3)
    assert report.friction is not None
    assert report.friction.energy_lost == pytest.approx(FRICTION * 1e-3 * 0.1, rel=1e-2)


@pytest.mark.release
def test_blocks_that_stick_are_tied(comm: MPI.Intracomm) -> None:
    data = {"mesh": blocks(lower=2, upper=2), "effects": [traction(0.01, 0.005, -0.1)]}
    sticks = solved(comm, {"friction": 2.0}, **data).solutions[0]
    tied = solved(comm, {"kind": "tied"}, **data).solutions[0]
    assert np.abs(sticks.u - tied.u).max() < 1e-9
    assert sticks.contacts[0].force == pytest.approx(tied.contacts[0].force, abs=1e-9)
    assert sticks.contacts[0].friction is not None
    assert sticks.contacts[0].friction.sliding_area == 0.0
    assert sticks.contacts[0].friction.energy_lost == 0.0


def test_no_friction_changes_no_digit(comm: MPI.Intracomm) -> None:
    data = {"mesh": blocks(), "effects": [traction(0, 0, -0.1)]}
    data["supports"] = [CLAMP, {"region": "z1", "fix": ["x", "y"]}]
    without, zero = (solved(comm, contact, **data).solutions[0] for contact in ({}, {"friction": 0.0}))
    assert np.array_equal(without.u, zero.u)
    assert "friction" not in zero.contacts[0].as_data()


def equations_of(comm: MPI.Intracomm, **data: Any) -> Equations:
    posed = job(**GIVEN | {"mesh": blocks(), "interfaces": [interface(friction=FRICTION)]} | data)
    body = build_body(posed.mesh, posed.regions, comm, resolve=posed.resolve, degree=1)
    return Equations(posed, body, Timings())


def test_failed_solves_leave_no_pressure_of_their_prediction(comm: MPI.Intracomm) -> None:
    """The first solve and its repetition with softer friction fail: both begin where the bodies overlap."""
    supports = [CLAMP, {"region": "z1", "displacement": [0, 0, -0.02]}]
    equations = equations_of(comm, supports=supports)
    equilibrium = equations.equilibrium(equations.weak_form("forward"))
    (pair,) = equilibrium.system.weak_form.contacts.pairs
    path = EquilibriumPath(equilibrium, 1e-12)
    path.begin()
    unloaded = path.place()
    predicted = equilibrium.predict(1.0, new_tangent=True)
    assert predicted.is_taken
    pair.locate()
    assert pair.pressures.max() > 0
    equilibrium.limit = 1
    assert not equilibrium.solve(1.0, 1e-12, predicted=predicted).outcome.accepted
    path.return_to(unloaded)
    equilibrium.system.begin_contact_step(0.5)
    assert pair.pressures.max() < 1e-5  # rounded where bodies only touch; the prediction has 0.02


def test_tangent_is_the_derivative_where_surfaces_stick_slide_and_are_apart(comm: MPI.Intracomm) -> None:
    equations = equations_of(comm)
    system = equations.equilibrium(equations.weak_form("forward")).system
    random, state = np.random.default_rng(0), system.state.x.array
    state[:] = 1e-3 * random.standard_normal(len(state))
    equations.supports.impose(state)
    system.weak_form.contacts.locate()
    (pair,) = system.weak_form.contacts.pairs
    (friction,) = pair._frictions
    system.linearise(1.0)
    found, pressing = friction.tractions(state, pair.pressures), pair.pressures > 0
    assert (pressing & found.sliding).any()
    assert (pressing & ~found.sliding).any()
    assert not pressing.all()
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
    system.matrix.multTranspose(step, system.rhs)
    assert np.abs(system.rhs.array - expected).max() > 1e-2 * np.abs(expected).max()


def test_rigid_motions_of_a_surface_have_their_rotation(comm: MPI.Intracomm) -> None:
    flat = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], dtype=np.float64)
    nodes, names = np.array([[0, 1, 2], [1, 3, 2]]), np.arange(4)
    turned, _ = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))
    turned *= np.sign(np.linalg.det(turned))
    before = flat[nodes]
    assert surface_rotations(names, nodes, before, before @ turned.T + 3.0, MPI.COMM_SELF) == pytest.approx(
        np.broadcast_to(turned, (4, 3, 3)), abs=1e-12
    )


DRAGGED: dict[str, Any] = {
    "mesh": {"file": "../meshes/two_blocks.py", "parameters": {"lower": 1, "upper": 2}},
    "analysis": "round_trip",
    "effects": [{"effect": "gravity", "acceleration": [0, 0, -0.2], "density": 1.0}],
    "supports": [CLAMP, {"region": "z1", "displacement": [0.05, 0, -0.05]}],
}


@pytest.mark.release
@pytest.mark.parallel([2, 1])
def test_coulomb_friction_of_one_load_step_closes(comm: MPI.Intracomm) -> None:
    solver = GIVEN["solver"] | {"strategy": "fixed", "steps": 1}
    contact = {"friction": FRICTION, "closure": "coulomb"}
    result = solved(comm, contact, first="inverse", solver=solver, **DRAGGED)
    assert result.errors["round_trip"]["max"] < 1e-10
    there, back = (solution.contacts[0] for solution in result.solutions)
    assert back.force == pytest.approx(there.force, abs=1e-9)
    assert there.friction is not None
    assert back.friction is not None
    assert 0.5 < there.friction.sliding_area / there.area < 1
    assert back.friction.energy_lost == pytest.approx(there.friction.energy_lost, rel=1e-6)


@pytest.mark.release
def test_friction_of_a_forward_solve_closes(comm: MPI.Intracomm) -> None:
    contact = {"friction": FRICTION, "closure": "given"}
    result = solved(comm, contact, first="forward", **DRAGGED)
    assert result.errors["round_trip"]["max"] < 1e-11
    there, back = (solution.contacts[0] for solution in result.solutions)
    assert there.friction is not None
    assert there.friction.sliding_area > 0
    assert back.force == pytest.approx(there.force, abs=1e-12)


def line_on_friction(comm: MPI.Intracomm, closure: str) -> Line:
    data = DRAGGED | {"analysis": "inverse", "certificate": {"level": "quick"}}
    certificate = solved(comm, {"friction": FRICTION, "closure": closure}, **data).certificate
    assert certificate is not None
    assert next(line for line in certificate.lines if "equilibrium" in line.name).verdict is Verdict.PASS
    (line,) = (line for line in certificate.lines if line.name == "friction on 'bottom'")
    return line


@pytest.mark.release
def test_certificate_warns_of_sticking_that_needs_more_than_friction(comm: MPI.Intracomm) -> None:
    sticks, slides = (line_on_friction(comm, closure) for closure in ("stick", "coulomb"))
    assert sticks.verdict is Verdict.WARN
    assert sticks.value is not None
    assert sticks.value > 1.5
    assert "surfaces that stick need" in sticks.note
    assert slides.verdict is Verdict.PASS
    assert slides.value == pytest.approx(1.0, rel=1e-6)


@pytest.mark.release
def test_a_path_of_several_steps_is_known_to_the_certificate(comm: MPI.Intracomm) -> None:
    """Its lines put the solution, whose slip began with the step before."""
    solver = GIVEN["solver"] | {"strategy": "fixed", "steps": 2}
    checked = {"level": "quick", "round_trip": "near"}
    data = DRAGGED | {"analysis": "forward", "certificate": checked, "solver": solver}
    certificate = solved(comm, {"friction": FRICTION}, **data).certificate
    assert certificate is not None
    assert next(line for line in certificate.lines if "equilibrium" in line.name).verdict is Verdict.PASS
    assert next(line for line in certificate.lines if "round trip" in line.name).verdict is Verdict.PASS


@pytest.mark.parametrize(
    ("contact", "data", "match"),
    [
        ({"friction": -0.1}, {}, "friction: must be from 0 to 2"),
        ({"friction": 2.1}, {}, "friction: must be from 0 to 2"),
        ({"friction": 0.1, "kind": "sliding"}, {}, "friction: is not valid with 'kind: sliding'"),
        ({"friction": 0.1, "closure": "conforming"}, {"analysis": "inverse"}, "assumes nothing about friction"),
        ({"closure": "stick"}, {"analysis": "inverse"}, "closure: 'stick' needs 'friction'"),
        ({"friction": 0.1, "closure": "stick"}, {}, "closure: is not valid in a forward analysis"),
        ({"friction": 0.1}, {"solver": {"strategy": "arc-length"}}, "friction: is not possible with 'strategy: arc"),
    ],
)
def test_friction_that_is_not_possible_is_refused(contact: dict[str, Any], data: dict[str, Any], match: str) -> None:
    with pytest.raises(JobError, match=match):
        job(**GIVEN | {"mesh": blocks(), "interfaces": [interface(**contact)]} | data)


@pytest.mark.parametrize("coefficient", [2.0, 0.02])
def test_tractions_turn_with_bodies_that_move_rigidly(comm: MPI.Intracomm, coefficient: float) -> None:
    """Bodies that stick or slide are turned by 60 degrees in one load step, pressed into each other as they are."""
    posed = job(**GIVEN | {"mesh": blocks(gap=0.02), "interfaces": [interface(friction=coefficient)]})
    body = build_body(posed.mesh, posed.regions, comm, resolve=posed.resolve, degree=1)
    equations = Equations(posed, body, Timings())
    system = equations.equilibrium(equations.weak_form("forward")).system
    (pair,) = system.weak_form.contacts.pairs
    (friction,) = pair._frictions
    nodes, unit = equations.unknowns.displacement_space.tabulate_dof_coordinates(), body.length_scale
    is_upper = nodes[:, 2] * unit > 0.51
    moved = nodes + is_upper[:, None] * np.array([1e-3, 5e-4, -0.022]) / unit
    turned, _ = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))
    turned *= np.sign(np.linalg.det(turned))

    def tractions(places: np.ndarray, load: float) -> np.ndarray:
        equations.put_displacement((places - nodes).ravel())
        system.begin_contact_step(load)
        vectors: np.ndarray = friction.tractions(pair._u, pair.pressures).vectors
        system.end_contact_step(load)
        return vectors

    before = tractions(moved, 0.25)
    after = tractions(moved @ turned.T + 0.1, 0.75)
    assert np.abs(before).max() > 1e-3
    assert after == pytest.approx(before @ turned.T, abs=1e-11)
