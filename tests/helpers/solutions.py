"""Solutions given by formulas for displacement and pressure, for tests of what is computed from a solution."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
from dolfinx import fem

from hpcinv.mesh import Body
from hpcinv.model.outcome import Outcome
from hpcinv.results.solution import Solution
from hpcinv.solver.newton import NewtonIteration, Solve

type Field = Callable[[np.ndarray], np.ndarray]  # of points (n, 3) in m

SOLVES = (
    Solve(1.0, Outcome.INVERTED, (NewtonIteration(2.0, 2.0, float("nan"), True),), 1),
    Solve(0.5, Outcome.CONVERGED, (NewtonIteration(1.0, 1.0, 1e-3, True), NewtonIteration(1e-9, 1.0, 1e-12, False)), 1),
    Solve(1.0, Outcome.ROUND_OFF, (NewtonIteration(0.5, 2.0, 1e-3, True), NewtonIteration(1e-9, 2.0, 1e-12, True)), 2),
)


def made_up(
    body: Body, direction: Any, u: Field, *, degree: int = 2, pressure: Field | None = None, **other: Any
) -> Solution:
    """A solution on the body's mesh with these fields; `cell_values` are its values in cells."""
    nodes = body.given_nodes
    cells = {name: fem.Function(fem.functionspace(body.mesh, ("DG", 0, shape))) for name, shape in CELLS.items()}
    for name, function in cells.items():
        values = cell_values(name, corners(body).mean(axis=1))
        function.x.array.reshape(values.shape)[function.function_space.dofmap.list[:, 0]] = values
    made: dict[str, Any] = {
        "job": SimpleNamespace(state=other.pop("state", "")),
        "direction": direction,
        "mesh_nodes": nodes,
        "u": u(nodes),
        "displacement": _interpolated(body, u, degree, (3,)),
        "pressure": pressure and _interpolated(body, pressure, 1, ()),
        "J": cells["J"],
        "cauchy_stress": cells["cauchy_stress"],
        "J_range": (0.9, 1.1),
        "strain_energy": 1.5,
        "solves": SOLVES,
    }
    return Solution(**(made | other))


CELLS: dict[str, tuple[int, ...]] = {"J": (), "cauchy_stress": (3, 3)}


def cell_values(name: str, centres: np.ndarray) -> np.ndarray:
    """Values for cells with their corners' mean at ``centres`` (n, 3), of n cells as rows."""
    sums = centres @ np.array([1.0, 2.0, 3.0])
    return sums[:, None] if name == "J" else sums[:, None] * 1e5 + np.arange(9.0)


def corners(body: Body) -> np.ndarray:
    """Vertices of the local cells, (n, 4 or 8, 3) m."""
    count = {"tetrahedron": 4, "hexahedron": 8}[body.source.kind]
    return body.mesh.geometry.x[body.mesh.geometry.dofmaps[0][:, :count]] * body.length_scale


def _interpolated(body: Body, field: Field, degree: int, shape: tuple[int, ...]) -> fem.Function:
    function = fem.Function(fem.functionspace(body.mesh, ("Lagrange", degree, shape)))
    function.interpolate(lambda x: field(x.T * body.length_scale).T)
    return function
