"""Land's problems 2 and 3 as axisymmetric problems with twist: an independent solution, to check our error bars.

Unknown are r/R - 1, the angle of twist and the axial displacement over the half section of the wall, and the pressure.
The ellipsoids are exact, fibres have no direction to be sampled around the axis, and cells are graded towards the
axis, the base and both faces, since stresses are singular where the faces meet the base. Columns: cells, degree, then
mm: inner, outer and middle apex, and the point ``twisted``.

Command: python -m benchmarks.published.land.axisymmetric
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hpcinv.base.parallel.ranks import MPI

ANGLE = 8.5, 18.5, -13.220964067100537
"""mm: half-axes of the middle of the wall, and Z of the point ``twisted`` on it."""
GRADES = 2.0, 3.0
"""Exponents of the cells' ends through and along the wall. Larger: smaller cells at faces, axis and base."""
MESHES = ((6, 24, 4), (8, 32, 4))
"""Cells through and along the wall, and degree of the displacement."""


def solved(problem: int, across: int, along: int, degree: int) -> dict[str, Any]:
    """Return the places (mm) of a problem, 2 or 3."""
    import basix.ufl
    import ufl
    from dolfinx import default_scalar_type, fem, mesh
    from dolfinx.fem.petsc import NonlinearProblem

    square = mesh.create_rectangle(MPI.COMM_SELF, [[0, 0], [1, 1]], [across, along], mesh.CellType.quadrilateral)
    nodes = square.geometry.x
    for axis, grade in enumerate(GRADES):
        near = (2 * np.minimum(nodes[:, axis], 1 - nodes[:, axis])) ** grade
        nodes[:, axis] = np.where(nodes[:, axis] < 0.5, near, 2 - near) / 2
    t, s = ufl.SpatialCoordinate(square)
    short, long = 7 + 3 * t, 17 + 3 * t
    angle = s * (ufl.pi - ufl.acos(5 / long))
    R, Z = short * ufl.sin(angle), -long * ufl.cos(angle)
    jacobian = ufl.as_matrix([[R.dx(0), R.dx(1)], [Z.dx(0), Z.dx(1)]])

    fields = [basix.ufl.element("Q", square.basix_cell(), degree - (i == 3)) for i in range(4)]
    space = fem.functionspace(square, basix.ufl.mixed_element(fields))
    w = fem.Function(space)
    swelling, twist, rise, p = ufl.split(w)
    hoop, z = 1 + swelling, Z + rise
    r = R * hoop
    of_r, of_z, of_twist = (ufl.dot(ufl.grad(f), ufl.inv(jacobian)) for f in (r, z, twist))
    F = ufl.as_matrix(
        [[of_r[0], 0, of_r[1]], [r * of_twist[0], hoop, r * of_twist[1]], [of_z[0], 0, of_z[1]]]
    )  # in the base vectors of cylinders
    load = fem.Constant(square, default_scalar_type(0))
    if problem == 2:
        (c, b_f, b_t, b_fs), pressure, active, fibre = (10, 1, 1, 1), 10, 0, ufl.as_vector([1, 0, 0])
    else:
        (c, b_f, b_t, b_fs), pressure, active = (2, 8, 2, 4), 15, 60
        slope = ufl.sqrt((short * Z / long) ** 2 + (long * R / short) ** 2)
        axial = ufl.cos(ufl.pi * t)
        fibre = ufl.as_vector(
            [-axial * short * Z / long / slope, ufl.sin(ufl.pi * t), axial * long * R / short / slope]
        )
    E = (ufl.det(F) ** (-2 / 3) * F.T * F - ufl.Identity(3)) / 2
    ff, f2 = ufl.dot(fibre, E * fibre), ufl.dot(E * fibre, E * fibre)
    exponent = b_f * ff**2 + b_t * (ufl.inner(E, E) - 2 * f2 + ff**2) + 2 * b_fs * (f2 - ff**2)
    energy = c / 2 * (ufl.exp(exponent) - 1) + load * active / 2 * (ufl.dot(F * fibre, F * fibre) - 1)

    inner = mesh.locate_entities_boundary(square, 1, lambda x: np.isclose(x[0], 0))
    tags = mesh.meshtags(square, 1, np.sort(inner), np.ones(len(inner), dtype=np.int32))
    dx = ufl.dx(metadata={"quadrature_degree": 2 * degree + 4})
    ds = ufl.ds(1, subdomain_data=tags, metadata={"quadrature_degree": 2 * degree + 6})
    total = 2 * ufl.pi * R * abs(ufl.det(jacobian)) * (energy + p * (ufl.det(F) - 1)) * dx
    total -= load * pressure * ufl.pi * r**2 * z.dx(1) * ds  # work on the volume of the cavity

    base = mesh.locate_entities_boundary(square, 1, lambda x: np.isclose(x[1], 1))
    held = [fem.locate_dofs_topological(space.sub(i), 1, base) for i in range(3)]
    if problem == 2:
        twists = space.sub(1), space.sub(1).collapse()[0]
        held[1] = fem.locate_dofs_geometrical(twists, lambda x: x[0] >= 0)[0]
    supports = [fem.dirichletbc(default_scalar_type(0), d, space.sub(i)) for i, d in enumerate(held)]
    options = {"snes_rtol": 1e-11, "snes_atol": 1e-9, "snes_max_it": 12, "snes_linesearch_type": "none"}
    options |= {"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}
    equations = NonlinearProblem(
        ufl.derivative(total, w), w, bcs=supports, petsc_options=options, petsc_options_prefix="land"
    )
    step, last, before = 0.02, (0.0, w.x.array.copy()), None
    while last[0] < 1:
        load.value = new = min(1.0, last[0] + step)
        if before:
            w.x.array[:] = last[1] + (last[1] - before[1]) * (new - last[0]) / (last[0] - before[0])
        equations.solve()
        if equations.solver.getConvergedReason() > 0:
            before, last, step = last, (new, w.x.array.copy()), min(1.4 * step, 0.2)
        else:
            w.x.array[:], step = last[1], step / 2

    def at(through: float, along_wall: float) -> Any:
        place = np.array([[through, along_wall, 0.0]])
        ends = nodes[square.geometry.dofmaps[0]][:, :, :2]
        cell = int(np.argmax(((ends.min(1) <= place[0, :2]) & (ends.max(1) >= place[0, :2])).all(1)))
        return [w.sub(i).collapse().eval(place, [cell]).item() for i in range(3)]

    apex = {name: -(17 + 3 * t) + at(t, 0.0)[2] for name, t in (("inner", 0.0), ("outer", 1.0), ("middle", 0.5))}
    a, b, height = ANGLE
    seen = np.arccos(-height / b)
    grown, turn, lift = at(0.5, float(seen / (np.pi - np.arccos(5 / b))))
    radius = a * np.sin(seen) * (1 + grown)
    return apex | {"twisted": (-radius * np.cos(turn), -radius * np.sin(turn), height + lift)}


def main() -> None:
    for problem in (2, 3):
        for cells in MESHES:
            places = solved(problem, *cells)
            numbers = [places["inner"], places["outer"], places["middle"], *places["twisted"]]
            print(problem, cells, *(f"{number:.5f}" for number in numbers), flush=True)


if __name__ == "__main__":
    main()
