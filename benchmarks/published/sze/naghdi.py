"""Sze's tests 3.6 and 3.7 by Naghdi's shell with five fields: an independent solution, to find why theirs differ.

Bilinear cells with one point for the strains of membrane and shear, of which a share of 0.005 is integrated in full
against zero-energy modes, stand for their S4R on their meshes; biquadratic ones show the limit. The displacement at the
force is prescribed in steps. Columns: test, force on the modelled part (N), shear factor, cells of an edge, degree,
first cell over the thickness (graded towards the force; 0: equal cells), and the displacement at the force (mm).

Command: python -m benchmarks.published.sze.naghdi
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hpcinv.base.parallel.ranks import MPI

SHARE = 0.005
"""Share of membrane and shear that is integrated in full. Larger: stiffer cells, since they lock."""
POISSON = 0.3
STEP = 0.01
"""Step of the prescribed displacement at the force, relative to the radius."""


@dataclass(frozen=True)
class NaghdiShell:
    """Radius, length, thickness (mm), Young's modulus (MPa) and supports.

    Supports: side, then the fixed components of displacement and of the director's angles.
    """

    radius: float
    length: float
    thickness: float
    young: float
    ends: tuple[tuple[str, tuple[int, ...], tuple[int, ...]], ...]


TESTS = {
    "3.6": NaghdiShell(100, 100, 1, 30e3, (("y0", (1,), (0,)), ("y1", (0, 2), ()))),
    "3.7": NaghdiShell(1016, 3048, 30, 20.685, (("y1", (0, 1, 2), (0, 1)),)),
}
MESHES = {
    ("3.6", 150): ((5 / 6, 40, 1, 0), (5 / 6, 48, 1, 0), (5 / 6, 80, 1, 0), (5 / 6, 40, 2, 0), (1, 40, 2, 0)),
    ("3.6", 3000): ((5 / 6, 48, 1, 0), (5 / 6, 40, 2, 0)),
    ("3.7", 100): ((5 / 6, 40, 1, 0), (5 / 6, 80, 1, 0), (5 / 6, 40, 2, 0), (5 / 6, 24, 2, 0.25), (1, 40, 2, 0)),
}
"""By test and force on the modelled part (N): shear factor, cells of an edge, degree, first cell over the thickness."""


def graded(first: float, cells: int, places: Any) -> Any:
    """Move places on a line of length 1 such that cells grow by a factor from the first one on."""
    low, high = 1.0, 10.0
    for _ in range(100):
        factor = (low + high) / 2
        low, high = (low, factor) if first * (factor**cells - 1) / (factor - 1) > 1 else (factor, high)
    return (high ** (places * cells) - 1) / (high**cells - 1)


def solved(test: NaghdiShell, force: float, shear_factor: float, cells: int, degree: int, first: float) -> float:
    """Return the displacement (mm) at a force (N)."""
    import basix.ufl
    import ufl
    from dolfinx import default_scalar_type, fem, mesh
    from dolfinx.fem import petsc
    from petsc4py import PETSc

    lengths = np.array([np.pi / 2, test.length])
    sheet = mesh.create_rectangle(MPI.COMM_SELF, [np.zeros(2), lengths], [cells, cells], mesh.CellType.quadrilateral)
    if first:
        for axis, unit in enumerate((test.radius, 1.0)):
            line = sheet.geometry.x[:, axis] / lengths[axis]
            begin = first * test.thickness / unit / lengths[axis]
            sheet.geometry.x[:, axis] = lengths[axis] * graded(begin, cells, line)
    fields = [basix.ufl.element("Q", sheet.basix_cell(), degree, shape=(count,)) for count in (3, 2)]
    space = fem.functionspace(sheet, basix.ufl.mixed_element(fields))
    w = fem.Function(space)
    u, turn = ufl.split(w)
    around, _ = x = ufl.SpatialCoordinate(sheet)
    if degree == 1:
        place = fem.Function(fem.functionspace(sheet, fields[0]))
        place.interpolate(lambda x: np.stack([test.radius * np.sin(x[0]), x[1], test.radius * np.cos(x[0])]))
    else:
        place = ufl.as_vector([test.radius * ufl.sin(around), x[1], test.radius * ufl.cos(around)])

    def director(a: Any, b: Any) -> Any:
        return ufl.as_vector([ufl.sin(b) * ufl.cos(a), -ufl.sin(a), ufl.cos(b) * ufl.cos(a)])

    before, after = director(0 * around, around), director(turn[0], turn[1] + around)
    tangents = ufl.grad(place)
    F = tangents + ufl.grad(u)
    metric = tangents.T * tangents
    raised, area = ufl.inv(metric), ufl.sqrt(ufl.det(metric))

    def bent(base: Any, normal: Any) -> Any:
        return ufl.sym(base.T * ufl.grad(normal))

    def energy(strain: Any) -> Any:
        mixed = raised * strain
        plane = POISSON / (1 - POISSON) * ufl.tr(mixed) ** 2 + ufl.tr(mixed * mixed)
        return test.young / 2 / (1 + POISSON) * plane

    slip = F.T * after - tangents.T * before
    bending = test.thickness**3 / 12 * energy(bent(F, after) - bent(tangents, before)) * area
    stretching = test.thickness * energy((F.T * F - metric) / 2)
    shearing = shear_factor * test.thickness * test.young / 4 / (1 + POISSON) * ufl.dot(slip, raised * slip)
    full, reduced = (ufl.dx(metadata={"quadrature_degree": d}) for d in (2 * degree + 1, 2 * degree - 1))
    locking = (stretching + shearing) * area
    residual = ufl.derivative((bending + SHARE * locking) * full + (1 - SHARE) * locking * reduced, w)
    tangent, residual = fem.form(ufl.derivative(residual, w)), fem.form(residual)

    sides = {"x0": (0, 0.0), "x1": (0, lengths[0]), "y0": (1, 0.0), "y1": (1, lengths[1])}
    supports = []
    for side, moves, turns in (("x0", (0,), (1,)), ("x1", (2,), (1,)), *test.ends):
        axis, end = sides[side]
        edge = mesh.locate_entities_boundary(sheet, 1, lambda x, axis=axis, end=end: np.isclose(x[axis], end))
        for field, components in enumerate((moves, turns)):
            for component in components:
                part = space.sub(field).sub(component)
                dofs = fem.locate_dofs_topological(part, 1, edge)
                supports.append(fem.dirichletbc(default_scalar_type(0), dofs, part))
    sheet.topology.create_connectivity(0, 2)
    corner = mesh.locate_entities(sheet, 0, lambda x: np.isclose(x[0], 0) & np.isclose(x[1], 0))
    loaded = fem.locate_dofs_topological(space.sub(0).sub(2), 0, corner)[0]
    solver = PETSc.KSP().create(PETSc.COMM_SELF)
    solver.setType("preonly")
    solver.getPC().setType("lu")
    solver.getPC().setFactorSolverType("mumps")

    def solve(force: float | None) -> float:
        """Find equilibrium under a force, or for the present displacement if it is None; return the force."""
        for iteration in range(30):
            forces = petsc.assemble_vector(residual)
            reaction = -forces.array[loaded]
            forces.array[loaded] = 0 if force is None else force - reaction
            for support in supports:
                forces.array[support.dof_indices()[0]] = 0
            if iteration and forces.norm() < 1e-8 * reaction:
                return float(reaction)
            matrix = petsc.assemble_matrix(tangent, bcs=supports)
            matrix.assemble()
            if force is None:
                matrix.zeroRowsColumns([int(loaded)], 1.0)
            solver.setOperators(matrix)
            correction = forces.duplicate()
            solver.solve(forces, correction)
            w.x.array[:] -= correction.array
        raise RuntimeError(f"no equilibrium at {-w.x.array[loaded]} mm")

    states, reactions = [w.x.array.copy()], [0.0]
    while reactions[-1] < force:
        if len(states) > 2:
            w.x.array[:] = 2 * states[-1] - states[-2]
        w.x.array[loaded] = -STEP * test.radius * len(states)
        reactions.append(solve(None))
        states.append(w.x.array.copy())
    share = (force - reactions[-2]) / (reactions[-1] - reactions[-2])
    w.x.array[:] = (1 - share) * states[-2] + share * states[-1]
    solve(force)
    return float(-w.x.array[loaded])


def main() -> None:
    for (name, force), meshes in MESHES.items():
        for factor, cells, degree, first in meshes:
            value = solved(TESTS[name], force, factor, cells, degree, first)
            print(name, force, f"{factor:.3f}", cells, degree, first, f"{value:.4f}", flush=True)


if __name__ == "__main__":
    main()
