"""Kinematics of shells against the cantilever with end shear of Sze, Liu and Lo 2004, and back again."""

import numpy as np
import pytest
import ufl
from basix.ufl import element, mixed_element
from dolfinx import fem, mesh
from dolfinx.fem import petsc
from mpi4py import MPI
from petsc4py import PETSc

from hpcinv.kinematics.kinematics import Deformation
from hpcinv.kinematics.shells import ShellKinematics

LENGTH, THICKNESS, SHEAR_MODULUS, FORCE = 10.0, 0.1, 0.6e6, 4.0
CELLS = (16, 1)


def strip() -> mesh.Mesh:
    """Return a flat strip of quadratic quadrilaterals in space."""
    nx, ny = (2 * n + 1 for n in CELLS)
    x, y = np.meshgrid(np.linspace(0, LENGTH, nx), np.linspace(0, 1, ny))
    points = np.column_stack((x.ravel(), y.ravel(), np.zeros(nx * ny)))
    corners = [2 * j * nx + 2 * i for j in range(CELLS[1]) for i in range(CELLS[0])]
    # vertices, edges, interior
    pattern = np.array([0, 2, 2 * nx, 2 * nx + 2, 1, nx, nx + 2, 2 * nx + 1, nx + 1])
    cells = np.array(corners)[:, None] + pattern
    return mesh.create_mesh(MPI.COMM_SELF, cells, element("Lagrange", "quadrilateral", 2, shape=(3,)), points)


def solve(
    sign: int, director: fem.Function, w: fem.Function, clamped: np.ndarray, end: ufl.Measure, steps: int
) -> None:
    """Solve by load steps and Newton's method."""
    space = w.function_space
    load = fem.Constant(space.mesh, 0.0)
    motion, v = ufl.split(w), ufl.TestFunctions(space)
    dS = ufl.dx(metadata={"quadrature_degree": 2})  # reduced: it does not lock
    F = -load * FORCE * v[0][2] * end
    for point, weight in zip(*np.polynomial.legendre.leggauss(3), strict=True):
        shell = ShellKinematics(sign, director, motion, float(point) * THICKNESS / 2)
        H = ufl.variable(shell.H)
        k = Deformation(H)
        stress = ufl.diff(SHEAR_MODULUS / 2 * (k.I1_minus_3 - 2 * k.ln_J), H)
        F += weight * THICKNESS / 2 * ufl.inner(stress, shell.Grad(v)) * shell.reference_volume * dS
    support = fem.dirichletbc(fem.Function(space), clamped)
    residual, tangent = fem.form(F), fem.form(ufl.derivative(F, w))
    lu = PETSc.KSP().create(PETSc.COMM_SELF)
    lu.setType("preonly")
    lu.getPC().setType("lu")
    lu.getPC().setFactorSolverType("mumps")
    correction = w.x.petsc_vec.duplicate()
    for step in range(steps):
        load.value = (step + 1) / steps
        for _ in range(30):
            b = petsc.assemble_vector(residual)
            for dof in clamped:
                b.setValue(dof, 0.0)
            b.assemble()
            A = petsc.assemble_matrix(tangent, bcs=[support])
            A.assemble()
            lu.setOperators(A)
            lu.solve(b, correction)
            w.x.array[:] -= correction.array
            if correction.norm(PETSc.NormType.INFINITY) < 1e-9:
                break
        else:
            pytest.fail(f"Newton's method did not converge at load {load.value}")


@pytest.mark.release  # its forms take half a minute to compile
def test_cantilever_both_ways() -> None:
    sheet = strip()
    vector = element("Lagrange", "quadrilateral", 2, shape=(3,))
    space = fem.functionspace(sheet, mixed_element([vector, vector]))
    middle, to_middle = space.sub(0).collapse()
    to_middle = np.ravel(to_middle)
    to_director = np.ravel(space.sub(1).collapse()[1])
    director = fem.Function(middle)
    director.x.array.reshape(-1, 3)[:, 2] = 1
    edges = [mesh.locate_entities_boundary(sheet, 1, lambda x, s=s: np.isclose(x[0], s)) for s in (0, LENGTH)]
    clamped = fem.locate_dofs_topological(space, 1, edges[0])
    end = ufl.Measure("ds", sheet, subdomain_data=mesh.meshtags(sheet, 1, np.sort(edges[1]), 1))(1)
    tip = fem.locate_dofs_topological(middle, 1, edges[1])

    w = fem.Function(space)
    solve(1, director, w, clamped, end, 10)
    u = w.x.array[to_middle].reshape(-1, 3).copy()
    assert u[tip, 2] == pytest.approx(6.698, rel=0.01)
    assert -u[tip, 0] == pytest.approx(3.286, rel=0.01)

    flat = sheet.geometry.x.copy()
    for cell in range(CELLS[0] * CELLS[1]):
        nodes = sheet.geometry.dofmaps[0][cell]
        sheet.geometry.x[nodes] = flat[nodes] + u[middle.dofmap.cell_dofs(cell)]
    director.x.array[:] += w.x.array[to_director]
    w.x.array[:] = 0
    solve(-1, director, w, clamped, end, 5)
    unloaded = sheet.geometry.x.copy()
    for cell in range(CELLS[0] * CELLS[1]):
        nodes = sheet.geometry.dofmaps[0][cell]
        unloaded[nodes] = sheet.geometry.x[nodes] - w.x.array[to_middle].reshape(-1, 3)[middle.dofmap.cell_dofs(cell)]
    error = np.abs(unloaded - flat).max()
    print(f"tip {u[tip].mean(axis=0)}, unloaded shape off by {error:.1e}")
    assert error < 1e-6 * LENGTH
