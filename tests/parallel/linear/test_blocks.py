"""What the preconditioner rests on: motions that tangents map to nothing, and a mass like the Schur complement."""

from __future__ import annotations

from typing import Any

import dolfinx.fem.petsc as fem_petsc
import numpy as np
import pytest
import scipy.linalg
from dolfinx import fem
from helpers.verification import box, job

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.mesh import build_body
from hpcinv.model.assembly.system import System
from hpcinv.model.rigid_motions import Frame
from hpcinv.physics.kinematics.kinematics import ForwardKinematics, InverseKinematics
from hpcinv.solver.equations import Equations

type Floats = np.ndarray[Any, np.dtype[np.float64]]


def free(material: dict[str, Any], analysis: str, comm: MPI.Intracomm) -> tuple[Equations, System]:
    """The equations of an unloaded block without its supports, far from equilibrium."""
    supports = [{"region": "x0", "fix": ["x", "y", "z"]}]
    given = job(mesh=box((2, 2, 2)), material=material, supports=supports, analysis=analysis)
    model = Equations(given, build_body(given.mesh, {}, comm, resolve=given.resolve), Timings())
    model.supports.conditions, model.supports.prescribed = [], []
    assembly = System(model.weak_form(given.directions[0]), model.supports, Timings())
    x = model.unknowns.state.x.array
    x[:] = 0.01 * np.random.default_rng(0).standard_normal(len(x))
    assembly.residual(assembly.rhs)
    assembly.tangent()
    return model, assembly


MIXED = {"law": "mooney-rivlin", "c1": 1000, "c2": 500, "d1": 5e6}


@pytest.mark.parametrize("kinematics", [ForwardKinematics, InverseKinematics])
def test_rotations_of_the_other_body_and_of_the_mesh_are_what_tangents_map_to_nothing(
    kinematics: type, comm: MPI.Intracomm
) -> None:
    # Internal forces turn with the current body, and do not change when the reference body turns.
    model, assembly = free(MIXED, kinematics.direction, comm)
    unknowns, K = model.unknowns, assembly.matrix
    dofs, mesh = unknowns.owned_displacement_dofs, unknowns.owned_displacement_points()
    other = mesh + kinematics.sign * unknowns.state.x.array[dofs].reshape(-1, 3)
    forces = assembly.rhs.array[dofs].reshape(-1, 3)
    x, y = K.createVecs()
    x.set(0.0)
    scale = K.norm()
    for axis in range(3):
        x.array[dofs] = Frame(np.zeros(3), 1.0).motions(other)[:, :, 3 + axis].ravel()
        K.mult(x, y)
        expected = np.zeros(len(y.array))
        if kinematics is ForwardKinematics:
            expected[dofs] = np.cross(np.eye(3)[axis], forces).ravel()
        assert np.abs(y.array - expected).max() < 1e-14 * scale
        if kinematics is InverseKinematics:
            x.array[dofs] = Frame(np.zeros(3), 1.0).motions(mesh)[:, :, 3 + axis].ravel()
            K.multTranspose(x, y)
            assert np.abs(y.array).max() < 1e-14 * scale
    assert np.abs(forces).max() > 1e-3  # or nothing has been shown


@pytest.mark.parametrize("lam", [2e4, 5e6, 5e9])
@pytest.mark.parametrize("divisions", [2, 3])
def test_scaled_pressure_mass_is_equivalent_to_the_schur_complement(
    lam: float, divisions: int, comm: MPI.Intracomm
) -> None:
    given = job(
        mesh=box((divisions,) * 3),
        material={"law": "neo-hookean", "mu": 3000, "lam": lam},
        supports=[{"region": "x0", "fix": ["x", "y", "z"]}],
        discretisation={"formulation": "mixed"},
        analysis="forward",
    )
    model = Equations(given, build_body(given.mesh, {}, comm, resolve=given.resolve), Timings())
    weak_form, unknowns = model.weak_form("forward"), model.unknowns
    assembly = System(weak_form, model.supports, Timings())
    assembly.tangent()
    K = assembly.matrix.convert("dense").getDenseArray()
    u, p = unknowns.owned_displacement_dofs, unknowns.owned_pressure_dofs
    S = K[np.ix_(p, p)] - K[np.ix_(p, u)] @ np.linalg.solve(K[np.ix_(u, u)], K[np.ix_(u, p)])
    mass = fem_petsc.assemble_matrix(fem.form(weak_form.pressure_mass(unknowns.pressure_space)))
    mass.assemble()
    eigenvalues = scipy.linalg.eigh(-S, mass.convert("dense").getDenseArray(), eigvals_only=True)
    assert eigenvalues.min() > 0.2  # of the pair of elements on this body
    assert eigenvalues.max() < 1.5  # since |tr ε|² ≤ 3 |ε|²
