"""The least quadrature: below it cells have motions without energy that are not rigid, and the job is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.command_line import BLOCK

from hpcinv import load, run
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import JobError
from hpcinv.mesh.cells import quadrature as rule
from hpcinv.mesh.cells import scalar_element
from hpcinv.model.discrete_model import default_quadrature

CELLS = ("tetrahedron", "hexahedron")


def motions_without_energy(kind: str, displacement: int, quadrature: int) -> int:
    """Dimension of the displacements of the reference cell whose small strain vanishes at all quadrature points."""
    points, _ = rule(kind, quadrature)
    gradients = scalar_element(kind, displacement).tabulate(1, points)[1:, :, :, 0]  # (axis, point, node)
    _, count, nodes = gradients.shape
    strains = np.zeros((count, 3, 3, nodes, 3))
    for i in range(3):
        for j in range(3):
            strains[:, i, j, :, i] += gradients[j] / 2
            strains[:, i, j, :, j] += gradients[i] / 2
    return 3 * nodes - int(np.linalg.matrix_rank(strains.reshape(-1, 3 * nodes), tol=1e-8))


@pytest.mark.parametrize("displacement", [1, 2, 3, 4])
@pytest.mark.parametrize("kind", CELLS)
def test_with_the_least_degree_cells_have_no_motions_without_energy_but_rigid_ones(
    kind: str, displacement: int
) -> None:
    least = default_quadrature(kind, displacement)
    assert motions_without_energy(kind, displacement, least) == 6
    if least > 1:
        assert motions_without_energy(kind, displacement, least - 1) > 6


def block(kind: str, **discretisation: Any) -> dict[str, Any]:
    mesh = {**BLOCK["mesh"], "parameters": {"nx": 1, "ny": 1, "nz": 1, "hexahedra": kind == "hexahedron"}}
    return {**BLOCK, "mesh": mesh, "discretisation": discretisation}


@pytest.mark.parametrize(
    ("kind", "displacement", "least"),
    [("tetrahedron", 2, 2), ("tetrahedron", 3, 4), ("hexahedron", 1, 2), ("hexahedron", 2, 4)],
)
def test_less_is_refused_with_the_least_degree(kind: str, displacement: int, least: int) -> None:
    cells = {"tetrahedron": "tetrahedra", "hexahedron": "hexahedra"}[kind]
    with pytest.raises(JobError) as caught:
        run(load(block(kind, displacement=displacement, quadrature=least - 1)), MPI.COMM_SELF)
    (problem,) = caught.value.problems
    assert problem.startswith(
        f"(mapping): discretisation.quadrature: must be at least {least} on {cells} of degree"
        f" {displacement}, not {least - 1}, or the tangent is nearly singular"
    )


@pytest.mark.release
@pytest.mark.parametrize(("kind", "least"), [("tetrahedron", 1), ("hexahedron", 2)])
def test_the_least_degree_suffices(kind: str, least: int) -> None:
    result = run(load(block(kind, displacement=1, quadrature=least)), MPI.COMM_SELF)
    assert result.statistics["status"] == "converged"
