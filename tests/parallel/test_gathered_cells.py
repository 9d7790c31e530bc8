"""Functions on another mesh of the same body, at points of any rank."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import basix.ufl
import numpy as np
import pytest
from dolfinx import fem
from helpers.mesh_cases import spec

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh import Body, build_body
from hpcinv.mesh.cells import scalar_element
from hpcinv.mesh.gathered_cells import FARTHEST, GatheredCells, Places

BEAM = {"length": "30 mm"}
BOX = {"lx": 3.0, "ly": 1.0, "lz": 1.0}
CASES: dict[str, tuple[str, dict[str, Any], dict[str, Any], int, int]] = {
    # generator, parameters of the coarse mesh and of the fine one, degree of the geometry, and of the function
    "straight tetrahedra": ("box.py", BOX | {"nx": 5, "ny": 2, "nz": 3}, BOX | {"nx": 7, "ny": 5, "nz": 4}, 1, 2),
    "cubic": ("box.py", BOX | {"nx": 4, "ny": 2, "nz": 2}, BOX | {"nx": 5, "ny": 3, "nz": 3}, 1, 3),
    "hexahedra": (
        "box.py",
        BOX | {"nx": 5, "ny": 2, "nz": 2, "hexahedra": True},
        BOX | {"nx": 7, "ny": 3, "nz": 3, "hexahedra": True},
        1,
        2,
    ),
    # The nearest centres belong to other layers of cells: a cell next to the cell of a point may be taken.
    "flat cells": ("box.py", BOX | {"nx": 120, "ny": 2, "nz": 2}, BOX | {"nx": 20, "ny": 5, "nz": 4}, 1, 2),
    # On curved cells linear functions alone are exact, and nodes of the surface lie outside the other mesh.
    "curved tetrahedra": ("pdms_beam.py", BEAM | {"size": "4 mm"}, BEAM | {"size": "2.5 mm"}, 2, 2),
    "curved hexahedra": (
        "thick_cylinder.py",
        {"radial": 1, "around": 2, "along": 2, "hexahedra": True},
        {"radial": 2, "around": 3, "along": 3, "hexahedra": True},
        2,
        2,
    ),
}


def polynomial(degree: int, x: np.ndarray) -> np.ndarray:
    """Three polynomials of a degree at points (3, n), (3, n)."""
    a, b, c = x
    return np.stack([1 + (a - 2 * b) ** degree, (c + 0.3 * a) ** degree - b, (a + b + c) ** degree])


def transferred(coarse: Body, fine: Body, degree: int, exact_degree: int) -> tuple[Places, float]:
    """Places of the fine mesh's nodes, and the largest error of a polynomial there, relative to its largest value."""
    function = fem.Function(fem.functionspace(coarse.mesh, ("Lagrange", degree, (3,))))
    function.interpolate(lambda x: polynomial(exact_degree, x * coarse.length_scale))
    points = fem.functionspace(fine.mesh, ("Lagrange", degree)).tabulate_dof_coordinates() * fine.length_scale
    cells = GatheredCells(coarse.mesh, coarse.length_scale)
    places = cells.find(points)
    element = basix.ufl.element("Lagrange", coarse.mesh.basix_cell(), degree)
    interpolated, exact = cells.evaluate(places, element, cells.values(function)), polynomial(exact_degree, points.T).T
    return places, float((np.abs(interpolated - exact).max() if len(points) else 0.0) / np.abs(exact).max(initial=1.0))


@pytest.mark.everyday("cubic")
@pytest.mark.parallel([1, 2, 3])
@pytest.mark.parametrize("case", CASES)
def test_polynomials_of_the_space_are_transferred_to_rounding_errors(
    case: str, comm: MPI.Intracomm, meshes: Path
) -> None:
    file, few, many, geometry, degree = CASES[case]
    coarse, fine = (
        build_body(spec(meshes / file, parameters=parameters, geometry_degree=geometry), {}, comm)
        for parameters in (few, many)
    )
    places, error = transferred(coarse, fine, degree, degree if geometry == 1 else 1)
    assert error < 1e-12
    assert places.distance.max(initial=0.0) < (0.1 if case == "flat cells" else 1e-9 if geometry == 1 else 0.2)


def test_points_far_outside_are_reported(comm: MPI.Intracomm, meshes: Path) -> None:
    body = build_body(spec(meshes / "pdms_beam.py", parameters=BEAM | {"size": "4 mm"}, geometry_degree=2), {}, comm)
    cells = GatheredCells(body.mesh, body.length_scale)
    assert (cells.find(np.array([[0.1, 0.0, 0.0], [0.0, 1.0, 0.0]])).distance > FARTHEST).all()
    nowhere = cells.find(np.empty((0, 3)))
    assert len(nowhere.cells) == 0
    function = fem.Function(fem.functionspace(body.mesh, ("Lagrange", 1, (3,))))
    assert cells.evaluate(nowhere, scalar_element(body.source.kind, 1), cells.values(function)).shape == (0, 3)
