"""What a step does to the body, the stress that it promises, and the path that it follows: against closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.verification import box, job
from petsc4py import PETSc

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.mesh import build_body
from hpcinv.model.assembly.csr_tangent import FilledTangent
from hpcinv.model.assembly.tangent import tangents_for
from hpcinv.solver.equations import Equations
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.solver.predictor import Increment

FORMS = {
    "displacement": {"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
    "mixed": {"law": "neo-hookean", "mu": "10 kPa", "lam": "1 MPa"},
}
SPIN = np.array([0.03, -0.04, 0.12])  # of length 0.13


def equations(
    comm: MPI.Intracomm, direction: str = "forward", form: str = "displacement"
) -> tuple[Equations, Equilibrium]:
    """A block that hangs from its bottom."""
    given = job(
        analysis=direction,
        mesh=box((2, 2, 2)),
        material=FORMS[form],
        effects=[{"effect": "gravity", "acceleration": [9.81, 0, -9.81], "density": 200}],
        supports=[{"region": "z0", "fix": ["x", "y", "z"]}],
    )
    model = Equations(given, build_body(given.mesh, given.regions, comm, resolve=given.resolve), Timings())
    return model, model.equilibrium(model.weak_form(direction))


def field(model: Equations, formula: Any) -> PETSc.Vec:
    """A displacement by its values at positions (3, n), and no pressure, as a vector of unknowns."""
    u = model.unknowns.displacement()
    u.interpolate(formula)
    kept = model.unknowns.state.x.array.copy()
    model.unload()
    model.unknowns.set_displacement(u.x.array)
    vector = model.unknowns.state.x.petsc_vec.copy()
    model.unknowns.state.x.array[:] = kept
    return vector


@pytest.mark.parallel([2, 1])
@pytest.mark.parametrize("direction", ["forward", "inverse"])
def test_a_spin_turns_by_its_angle_and_a_strain_stretches_wherever_the_body_lies(
    direction: str, comm: MPI.Intracomm
) -> None:
    model, equilibrium = equations(comm, direction)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # by a right angle
    deform = turn @ np.array([[1.2, 0.1, 0.0], [0.0, 0.9, 0.2], [0.0, 0.0, 1.1]])
    strain = np.diag([0.1, -0.05, 0.02])
    sign = 1 if direction == "forward" else -1  # of the displacement in the map to the other body
    equilibrium.system.set_state(field(model, lambda X: sign * (deform - np.eye(3)) @ X))
    spun = equilibrium.predictor.increments(field(model, lambda X: sign * np.cross(SPIN, (deform @ X).T).T))
    assert spun.rotation == pytest.approx(np.linalg.norm(SPIN), rel=1e-12)
    assert spun.strain < 1e-12
    strained = equilibrium.predictor.increments(field(model, lambda X: strain @ deform @ X))
    assert strained.strain == pytest.approx(np.linalg.norm(strain), rel=1e-12)
    assert strained.rotation < 1e-12
    equilibrium.destroy()


@pytest.mark.everyday("mixed")
@pytest.mark.parametrize("form", FORMS)
def test_mixed_integration_point_term_is_symmetric_and_of_second_order(form: str, comm: MPI.Intracomm) -> None:
    model, equilibrium = equations(comm, form=form)
    before = field(model, lambda X: 0.1 * np.array([X[2] ** 2, 0 * X[0], X[0] * X[2]]))
    step = field(model, lambda X: np.array([X[2] * X[1], -(X[2] ** 2), X[0] * X[2]]))
    sizes = []
    for length in (0.0, 0.02, 0.01):
        x = before.copy()
        x.axpy(length, step)
        equilibrium.system.set_state(x)
        added = added_to_tangent(equilibrium, before)
        sizes.append(added.norm())
        asymmetry = added - added.copy().transpose()
        assert asymmetry.norm() <= 1e-12 * max(added.norm(), 1.0)
    assert sizes[0] < 1e-12
    assert np.log2(sizes[1] / sizes[2]) == pytest.approx(2, abs=0.1)
    equilibrium.destroy()


@pytest.mark.everyday("displacement")
@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("form", FORMS)
def test_mixed_integration_point_term_is_equal_by_compiled_forms_and_in_place(form: str, comm: MPI.Intracomm) -> None:
    products = []
    for cells in (1, 1_000_000):
        with tangents_for(cells):
            model, equilibrium = equations(comm, form=form)
            before = field(model, lambda X: 0.1 * np.array([X[2] ** 2, 0 * X[0], X[0] * X[2]]))
            equilibrium.system.set_state(field(model, lambda X: 0.2 * np.array([X[2] * X[1], -X[2], X[0] * X[2]])))
            added = added_to_tangent(equilibrium, before)
        assert isinstance(equilibrium.system._tangent, FilledTangent) == (cells > 1)
        v = field(model, lambda X: X[2] * np.array([X[0], 1 + X[1] * X[2], X[2]]))
        products.append([float(v.dot(added * w)) for w in (v, before)])
        equilibrium.destroy()
    assert products[1] == pytest.approx(products[0], rel=1e-11)
    assert abs(products[0][0]) > 1e-6


def added_to_tangent(equilibrium: Equilibrium, before: PETSc.Vec) -> PETSc.Mat:
    equilibrium.system.tangent()
    without = equilibrium.system.matrix.copy()
    equilibrium.system.tangent(equilibrium.mip.extrapolation(before, Increment(rotation=1.0, strain=0.1)))
    return equilibrium.system.matrix - without


def test_pure_spin_adds_minus_the_whole_stress(comm: MPI.Intracomm) -> None:
    """A linear step that only turns promises Ŝ = 0 and p̂ = 0, whatever it stretches: ψ(E) in closed form."""
    model, equilibrium = equations(comm)
    W = np.cross(3 * SPIN, np.eye(3)).T  # u = W X
    equilibrium.system.set_state(field(model, lambda X: W @ X))
    F = np.eye(3) + W
    inverse, C_inverse, ln_J = np.linalg.inv(F), np.linalg.inv(F.T @ F), np.log(np.linalg.det(F))
    mu, lam = 10e3, 40e3
    S_without_pressure = mu * (np.eye(3) - C_inverse)
    added = added_to_tangent(equilibrium, field(model, lambda X: 0 * X))
    # A field that vanishes on the support, whose rows have no part in it.
    A = np.array([[0.0, 0.2, 0.5], [0.3, 0.0, -0.4], [0.1, 0.6, 0.2]])
    v = field(model, lambda X: (A @ X) * X[2])
    points, weights = np.polynomial.legendre.leggauss(4)
    size = 1 / model.body.length_scale
    points, weights = (points + 1) / 2 * size, weights / 2 * size
    expected = 0.0
    for i, j, k in np.ndindex(4, 4, 4):
        X = np.array([points[i], points[j], points[k]])
        G = A * X[2] + np.outer(A @ X, [0, 0, 1])
        second = -np.trace(inverse @ G @ inverse @ G)  # of ln J
        taken = np.sum(S_without_pressure * (G.T @ G)) + lam * ln_J * second
        expected -= weights[i] * weights[j] * weights[k] * taken
    assert v.dot(added * v) * model.scales.stress == pytest.approx(expected, rel=1e-10)
    equilibrium.destroy()


def test_predicted_states_miss_the_path_by_the_square_of_the_step(comm: MPI.Intracomm) -> None:
    _, equilibrium = equations(comm)
    assert equilibrium.solve(0.5, 1e-13).outcome.accepted
    start, misses = equilibrium.system.position(), []
    for step in (0.1, 0.05):
        equilibrium.system.set_state(start)
        predicted = equilibrium.predict(0.5 + step, new_tangent=True)
        length = predicted.length
        foretold = equilibrium.system.position()
        solve = equilibrium.solve(0.5 + step, 1e-13, predicted=predicted)
        assert solve.outcome.accepted
        foretold.axpy(-1.0, equilibrium.system.position())
        misses.append(foretold.norm() / length)
    assert np.log2(misses[0] / misses[1]) == pytest.approx(1, abs=0.15)  # relative to the step
    equilibrium.destroy()
