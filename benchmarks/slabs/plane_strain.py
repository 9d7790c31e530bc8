"""Plane strain of slabs by a program of its own, on meshes graded to each singular point: values to compare with.

Cubic triangles, with quadratic pressures where the material is incompressible; their size is ``GRADING`` times the
distance to the nearest singular point, down to ``SMALLEST``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import basix.ufl
import dolfinx.fem.petsc
import numpy as np
import ufl
from dolfinx import fem
from dolfinx.io import gmsh as gmsh_io
from mpi4py import MPI
from petsc4py import PETSc
from slabs.slab import OUTLINES

GRADING, SMALLEST = 0.5, 2e-3  # of the size of a triangle to the distance; m
CLOSED = 1e-9

type Region = Callable[[Any], Any]  # condition of points (3, n)


@dataclass(frozen=True)
class SlabProblem:
    """A slab under loads.

    Attributes:
        lam: Lamé's first parameter (Pa) of a neo-Hookean material ``μ/2 (I₁ - 3 - 2 ln J) + λ/2 (ln J)²``, ``None`` of
            an incompressible one, ``μ/2 (J^(-2/3) I₁ - 3)``.
        fixed: components that are fixed on each line.
        tractions: Pa per reference area on each line.
        weight: force per reference volume (N/m³).
        points: at which the displacement is asked for, by name.
        ends: of supports, where the stress has no bound.
    """

    shape: str
    mu: float
    lam: float | None
    fixed: Mapping[str, tuple[int, ...]]
    points: Mapping[str, tuple[float, float]]
    ends: tuple[tuple[float, float], ...] = ()
    tractions: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    weight: tuple[float, float] = (0.0, 0.0)


def solve(problem: SlabProblem, largest: float = 0.25, steps: int = 2) -> dict[str, Any]:
    """Return the displacement (m) at each point, and the number of unknowns as ``unknowns``."""
    mesh = _mesh(problem, largest)
    cell, degree = mesh.basix_cell(), 3
    vector = basix.ufl.element("Lagrange", cell, degree, shape=(2,))
    is_mixed = problem.lam is None
    element = basix.ufl.mixed_element([vector, basix.ufl.element("Lagrange", cell, degree - 1)]) if is_mixed else vector
    space = fem.functionspace(mesh, element)
    state, test, load = fem.Function(space), ufl.TestFunction(space), fem.Constant(mesh, 0.0)
    u, p = ufl.split(state) if is_mixed else (state, None)
    v = ufl.split(test)[0] if is_mixed else test
    F = ufl.Identity(2) + ufl.grad(u)
    J, trace = ufl.det(F), ufl.inner(F, F) + 1
    if problem.lam is None:
        energy = 0.5 * (J ** (-2 / 3) * trace - 3) + p * (J - 1)
    else:
        energy = 0.5 * (trace - 3 - 2 * ufl.ln(J)) + problem.lam / problem.mu / 2 * ufl.ln(J) ** 2
    tags = _tags(mesh, problem)
    ds = ufl.Measure("ds", mesh, subdomain_data=tags[0])
    dx = ufl.dx(mesh, metadata={"quadrature_degree": 8})
    residual = ufl.derivative(energy * dx, state, test)
    residual -= load / problem.mu * ufl.dot(ufl.as_vector(problem.weight), v) * dx
    for line, traction in problem.tractions.items():
        residual -= load / problem.mu * ufl.dot(ufl.as_vector(traction), v) * ds(tags[1][line])
    conditions = []
    for line, components in problem.fixed.items():
        for component in components:
            part = space.sub(0).sub(component) if is_mixed else space.sub(component)
            collapsed, _ = part.collapse()
            dofs = fem.locate_dofs_topological((part, collapsed), 1, tags[0].find(tags[1][line]))
            conditions.append(fem.dirichletbc(fem.Function(collapsed), dofs, part))
    forms = fem.form(residual), fem.form(ufl.derivative(residual, state))
    for step in range(1, steps + 1):
        load.value = step / steps
        for _ in range(15):
            if _newton(*forms, conditions, state) < CLOSED:
                break
        else:
            raise RuntimeError(f"{problem.shape}: no convergence")
    displacement = state.sub(0).collapse() if is_mixed else state
    values: dict[str, Any] = {"unknowns": space.dofmap.index_map.size_global * space.dofmap.index_map_bs}
    tree = dolfinx.geometry.bb_tree(mesh, 2)
    for name, (x, y) in problem.points.items():
        point = np.array([[x, y, 0.0]])
        colliding = dolfinx.geometry.compute_colliding_cells(
            mesh, dolfinx.geometry.compute_collisions_points(tree, point), point
        )
        values[name] = displacement.eval(point[0], colliding.links(0)[:1]).tolist()
    return values


def _newton(residual: Any, tangent: Any, conditions: list[Any], state: fem.Function) -> float:
    """Make one step; return its length relative to the state."""
    A = dolfinx.fem.petsc.assemble_matrix(tangent, bcs=conditions)
    A.assemble()
    b = dolfinx.fem.petsc.assemble_vector(residual)
    dolfinx.fem.petsc.set_bc(b, conditions, alpha=0.0)
    solver = PETSc.KSP().create(A.comm)
    solver.setOperators(A)
    solver.setType("preonly")
    solver.getPC().setType("lu")
    solver.getPC().setFactorSolverType("mumps")
    solver.getPC().setFactorSetUpSolverType()
    solver.getPC().getFactorMatrix().setMumpsIcntl(14, 300)  # % of workspace for delayed pivots
    x = b.duplicate()
    solver.solve(b, x)
    state.x.array[:] -= x.array
    length = x.norm() / max(np.linalg.norm(state.x.array), 1e-300)
    for made in (A, b, x, solver):
        made.destroy()
    return float(length)


def _mesh(problem: SlabProblem, largest: float) -> Any:
    import gmsh

    outline = OUTLINES[problem.shape]
    singular = np.array(outline.singular_points(problem.ends))
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    made = [
        gmsh.model.occ.addRectangle(x, y, 0, outline.xs[i + 1] - x, outline.ys[j + 1] - y)
        for i, j in outline.rectangles
        for x, y in [(outline.xs[i], outline.ys[j])]
    ]
    gmsh.model.occ.fragment([(2, tag) for tag in made], [])
    gmsh.model.occ.synchronize()
    gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 0)

    def size(_dim: int, _tag: int, x: float, y: float, _z: float, _lc: float) -> float:
        return float(max(SMALLEST, min(largest, GRADING * np.hypot(*(singular - (x, y)).T).min(initial=np.inf))))

    gmsh.model.mesh.setSizeCallback(size)
    gmsh.model.addPhysicalGroup(2, [tag for _, tag in gmsh.model.getEntities(2)], 1)
    gmsh.model.mesh.generate(2)
    gmsh.model.mesh.removeSizeCallback()
    mesh = gmsh_io.model_to_mesh(gmsh.model, MPI.COMM_SELF, 0, gdim=2).mesh
    gmsh.finalize()
    return mesh


def _tags(mesh: Any, problem: SlabProblem) -> tuple[Any, dict[str, int]]:
    """Return tags of boundary facets, and the tag of each line."""
    mesh.topology.create_connectivity(1, 2)
    facets = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    middles = dolfinx.mesh.compute_midpoints(mesh, 1, facets)
    tags, numbers = np.zeros(len(facets), dtype=np.int32), {}
    for number, (name, is_on) in enumerate(OUTLINES[problem.shape].lines.items(), start=1):
        is_on_line = [bool(is_on(*(0 if abs(c) < 1e-13 else float(c) for c in middle[:2]))) for middle in middles]
        tags[np.array(is_on_line)] = number
        numbers[name] = number
    return dolfinx.mesh.meshtags(mesh, 1, facets, tags), numbers
