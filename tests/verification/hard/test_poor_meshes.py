"""Flat cells, slivers, cells of very different sizes and stiffnesses: answers known in closed form."""

from __future__ import annotations

from math import log
from typing import Any

import numpy as np
import pytest
from helpers.closed_forms import root
from helpers.hard_case import effort, solve

from hpcinv.base.parallel.runtime import MPI
from hpcinv.output.result import Result

REST = 1.0802799  # length of the column, as in tests/verification/test_column.py
RADII = {"inner": 0.8286610, "outer": 1.3916461}  # of the tube, as in tests/verification/test_thick_cylinder.py


def aspect_ratio(result: Result) -> float:
    """Largest over all cells: longest edge over shortest height of a tetrahedron, or edge of a brick."""
    source = result.body.source
    corners = source.points[source.cells[:, : 4 if source.kind == "tetrahedron" else 8]]
    edges = np.linalg.norm(corners[:, :, None] - corners[:, None], axis=3)
    if source.kind == "hexahedron":
        edges[:, range(8), range(8)] = np.inf
        shortest = edges.min(axis=(1, 2))
        edges[np.isinf(edges)] = 0.0
        return float((edges.max(axis=(1, 2)) / shortest).max())
    sides = corners[:, 1:] - corners[:, :1]
    faces = [np.cross(corners[:, j] - corners[:, i], corners[:, k] - corners[:, i]) for i, j, k in FACES]
    largest = np.max([np.linalg.norm(f, axis=1) for f in faces], axis=0)
    return float((edges.max(axis=(1, 2)) * largest / np.abs(np.linalg.det(sides))).max())


FACES = (0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)


@pytest.mark.release
def test_a_slice_of_a_tube_with_cells_ten_thousand_times_wider_than_high(comm: MPI.Intracomm) -> None:
    result = solve("flat-cells", comm)
    errors = [result.quantities[f"{name}-radius"] / radius - 1 for name, radius in RADII.items()]
    print(f"aspect ratio {aspect_ratio(result):.0f}: errors of the radii {errors}; {effort(result)}")
    assert aspect_ratio(result) > 1e4
    assert np.abs(errors).max() < 1e-6


@pytest.mark.parametrize("aspect", [1e2, 1e4, 1e5])
def test_slivers_do_not_change_the_column(aspect: float, comm: MPI.Intracomm) -> None:
    mesh = {"file": "../../meshes/sliver_layers.py", "parameters": {"layers": 8, "aspect": aspect}}
    result = solve("slivers", comm, mesh=mesh)
    error = result.quantities["length-at-rest"] - REST
    print(f"aspect ratio {aspect_ratio(result):.0f}: {error:.1e} m off; {effort(result)}")
    assert aspect_ratio(result) > aspect
    assert abs(error) < 3e-7
    assert effort(result) == [(3, 3)]  # as on a regular mesh


@pytest.mark.release
def test_a_mesh_refined_a_thousandfold_in_a_corner(comm: MPI.Intracomm) -> None:
    result = solve("refined-corner", comm)
    sizes = np.linalg.norm(np.diff(result.body.source.points[result.body.source.cells[:, :2]], axis=1)[:, 0], axis=1)
    error = result.quantities["length-at-rest"] - REST
    print(f"edges from {sizes.min():.1e} to {sizes.max():.1e} m: {error:.1e} m off; {effort(result)}")
    assert sizes.max() / sizes.min() > 1e3
    assert abs(error) < 5e-6
    assert effort(result) == [(3, 3)]


def layers(contrast: float, analysis: str) -> dict[str, Any]:
    soft = {"law": "neo-hookean", "mu": 1e4, "lam": 4e4}
    return {
        "analysis": analysis,
        "material": {"lower": {"law": "neo-hookean", "mu": 1e4 * contrast, "lam": 4e4 * contrast}, "elsewhere": soft},
    }


@pytest.mark.everyday("1e-06-inverse")
@pytest.mark.parametrize("analysis", ["inverse", "forward"])
@pytest.mark.parametrize("contrast", [1e6, 1e-6])
def test_layers_a_million_times_stiffer_or_softer(contrast: float, analysis: str, comm: MPI.Intracomm) -> None:
    """Each layer's stretch carries the same traction, and each one's displacement is right, not their sum alone."""

    def traction(stretch: float, scale: float = 1.0) -> float:
        return scale * (1e4 * (stretch - 1 / stretch) + 4e4 * log(stretch) / stretch)

    softer = min(contrast, 1.0)
    pull = traction(2.0, softer)
    stretches = [root(lambda s, f=f: traction(s, f) - pull, 1 - 1e-9, 3.0) for f in (contrast, 1.0)]
    load = {"effect": "traction", "region": "z1", "traction": [0, 0, pull], "area_in": "current"}
    quantities = [
        {"name": "interface", "of": "uz", "at": [0.5, 0.5, 0.25]},
        {"name": "top", "of": "uz", "on": "z1", "reduce": "mean"},
    ]
    result = solve("hard-and-soft-layers", comm, **layers(contrast, analysis), effects=[load], quantities=quantities)
    slopes = [s - 1 if analysis == "forward" else 1 - 1 / s for s in stretches]
    exact = np.array([0.25 * slopes[0], 0.75 * slopes[1]])
    elongations = np.array([result.quantities["interface"], result.quantities["top"] - result.quantities["interface"]])
    errors = np.abs(elongations / exact - 1)
    print(f"contrast {contrast:g}, {analysis}: relative errors of the layers {errors}; {effort(result)}")
    assert errors.max() < 1e-8
