"""The tangent put together from moduli is the matrix that DOLFINx assembles from UFL's derivative of the residual."""

from __future__ import annotations

from typing import Any

import dolfinx.fem.petsc as fem_petsc
import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import create_unit_cube
from helpers.verification import box, deform, job
from petsc4py import PETSc
from ufl.algorithms import expand_derivatives

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.mesh import build_body
from hpcinv.model.assembly.csr_tangent import FilledTangent
from hpcinv.model.assembly.system import System
from hpcinv.model.assembly.tangent import FormTangent, tangent_of, tangents_for
from hpcinv.physics.kinematics.staged_derivatives import gradient, remove_stages
from hpcinv.solver.equations import Equations

MIXED: dict[str, Any] = {
    "analysis": "inverse",
    "mesh": box((2, 2, 2)),
    "material": {"law": "mooney-rivlin", "c1": "10 kPa", "c2": "5 kPa", "d1": "1 MPa"},
    "effects": [
        {"effect": "gravity", "acceleration": [0, -9.81, 0], "density": 1000, "density_in": "reference"},
        {"effect": "pressure", "region": "x1", "pressure": "2 kPa"},
    ],
    "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
}
DISPLACEMENT: dict[str, Any] = {
    "analysis": "forward",
    "mesh": box((3, 2, 2), hexahedra=True),
    "material": {"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
    "effects": [{"effect": "pressure", "region": "x1", "pressure": "2 kPa"}],
    "supports": [{"region": "x0", "displacement": ["0.1*y", "-0.05*z", 0]}],
}
CUBIC: dict[str, Any] = MIXED | {
    "mesh": box((2, 1, 2)),
    "discretisation": {"displacement": 3, "pressure": 2},
    "supports": [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"],
}


@pytest.mark.everyday("displacement")
@pytest.mark.parallel([1, 2, 3])
@pytest.mark.parametrize("case", [MIXED, DISPLACEMENT, CUBIC], ids=["mixed", "displacement", "cubic"])
def test_matrix_agrees_with_the_derivative(case: dict[str, Any], comm: MPI.Intracomm) -> None:
    given = job(**case)
    body = build_body(given.mesh, given.regions, comm, resolve=given.resolve)
    model = Equations(given, body, Timings())
    weak_form, supports = model.weak_form(given.directions[0]), model.supports
    state = model.unknowns.state
    deform(model.unknowns)
    form = fem.form(ufl.derivative(remove_stages(weak_form.residual), state))
    model.put_load(0.7)
    theirs = fem_petsc.assemble_matrix(form, bcs=supports.conditions)
    theirs.assemble()
    expected = fem_petsc.create_vector(model.unknowns.space)
    fem_petsc.apply_lifting(expected, [form], bcs=[supports.conditions])
    expected.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    fem_petsc.set_bc(expected, supports.conditions)
    size = expected.norm()
    assert (size > 0) == supports.prescribe_motion

    for kind, cells in ((FilledTangent, 1_000_000), (FormTangent, 1)):
        first = System(weak_form, supports, Timings())
        with tangents_for(cells):
            first.linearise(0.3)
        again = System(weak_form, supports, Timings(), like=first)
        for ours in (first, again):  # of which the second has the pattern of the first
            for _ in range(2):  # what was there before counts for nothing
                ours.linearise(0.7)
            assert isinstance(ours._tangent, kind)
        for ours in (first, again):
            assert ours.min_mesh_J() > 0
            gap = theirs.copy()
            gap.axpy(-1.0, ours.matrix, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
            error = gap.norm(PETSc.NormType.INFINITY) / theirs.norm(PETSc.NormType.INFINITY)
            lifted = fem_petsc.create_vector(model.unknowns.space)
            ours.lift(lifted)
            lifted.axpy(-1.0, expected)
            print(f"{kind.__name__}: {error:.1e}, lifting {lifted.norm() / max(size, 1e-300):.1e}")
            assert error < 1e-14
            assert lifted.norm() <= 1e-14 * size
            assert ours.matrix.getBlockSizes() == theirs.getBlockSizes()


@pytest.mark.parallel([2])
def test_scattered_unknowns_of_a_node_are_not_filled_directly(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = job(**MIXED)
    body = build_body(given.mesh, given.regions, comm, resolve=given.resolve)

    def chosen() -> type:
        with tangents_for(cells=1_000_000):
            return type(tangent_of(Equations(given, body, Timings()).weak_form("inverse")))

    assert chosen() is FilledTangent
    dofs: Any = fem.DofMap.list

    def apart(dofmap: fem.DofMap) -> Any:
        swapped = dofs.fget(dofmap).copy()
        if comm.rank == 1:
            swapped[:, [1, 3]] = swapped[:, [3, 1]]
        return swapped

    monkeypatch.setattr(fem.DofMap, "list", property(apart))
    assert chosen() is FormTangent


def test_stages_leave_derivatives_as_they_are(comm: MPI.Intracomm) -> None:
    """The gradient through stages, against UFL's own of the same expression without them."""
    mesh = create_unit_cube(comm, 1, 1, 1)
    constant = fem.Constant(mesh, np.random.default_rng(3).normal(scale=0.3, size=(3, 3)))
    H = ufl.variable(constant)
    E = ufl.variable(ufl.sym(H) + H.T * H / 2)
    a, b = ufl.variable(ufl.tr(E)), ufl.variable(ufl.inner(E, E))
    psi = ufl.exp(ufl.variable(a * b)) * (1 + a) + ufl.det(H) * b
    symbol = ufl.variable(constant)
    first = expand_derivatives(ufl.diff(ufl.replace(remove_stages(psi), {constant: symbol}), symbol))
    by_stages = gradient(psi, H)
    entries = [e[at] for e in (by_stages, first) for at in np.ndindex(e.ufl_shape)]
    point = np.full((1, 3), 0.25)
    compiled = fem.Expression(remove_stages(ufl.as_vector(entries)), point)
    values = compiled.eval(mesh, np.zeros(1, dtype=np.int32)).ravel()
    ours, theirs = values.reshape(2, 9)
    assert np.abs(ours - theirs).max() < 1e-14 * np.abs(theirs).max()
    assert np.abs(theirs).max() > 1
