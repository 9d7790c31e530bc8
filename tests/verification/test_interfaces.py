"""Interfaces between two bodies of one mesh: patch tests, conforming meshes, and back to the given body."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.output.result import Result
from hpcinv.results.solution import Solution

SOFT = {"law": "neo-hookean", "mu": 1.0, "lam": 2.0}
TIED = [{"between": ["bottom", "top"], "kind": "tied"}]
ROLLERS = [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"]
CLAMP = [{"region": "z0", "fix": ["x", "y", "z"]}]
PUSH = {"effect": "traction", "region": "z1", "traction": [0, 0, -0.3], "area_in": "reference"}
SHEAR = {"effect": "traction", "region": "z1", "traction": [0.1, 0.05, 0.2], "area_in": "reference"}
EXACT = {"tolerance": 1e-12}


def blocks(**parameters: Any) -> dict[str, Any]:
    return {"file": "../meshes/two_blocks.py", "parameters": parameters}


def solved(comm: MPI.Intracomm, **data: Any) -> Result:
    given: dict[str, Any] = {"analysis": "forward", "material": SOFT, "interfaces": TIED, "solver": EXACT}
    return hpcinv.run(job(**given | data), comm)


def stress_errors(solution: Solution, expected: np.ndarray) -> np.ndarray:
    """Largest deviation of each cell's Cauchy stress."""
    stress = solution.cauchy_stress.x.array.reshape(-1, 3, 3)
    return np.asarray(np.abs(stress - expected).max(initial=0.0))


FORMS: dict[str, dict[str, Any]] = {
    "tetrahedra": {"discretisation": {"displacement": 1}},
    "quadratic": {"discretisation": {"displacement": 2}},
    "hexahedra": {"discretisation": {"displacement": 1}, "mesh": {"hexahedra": True}},
    "mixed": {"discretisation": {"displacement": 2, "formulation": "mixed"}},
    "quadratic-hexahedra": {"discretisation": {"displacement": 2}, "mesh": {"hexahedra": True}},
}


@pytest.mark.parametrize("form", FORMS)
def test_tied_blocks_of_unequal_meshes_have_uniform_stress(comm: MPI.Intracomm, form: str) -> None:
    mesh = blocks(**FORMS[form].get("mesh", {}))
    data = {"mesh": mesh, "discretisation": FORMS[form]["discretisation"], "effects": [PUSH], "supports": ROLLERS}
    solution = solved(comm, **data).solutions[0]
    x, u = solution.mesh_nodes, solution.u
    products, squares = comm.allreduce((u * x).sum(axis=0)), comm.allreduce((x**2).sum(axis=0))
    strain = np.diag(products / squares)
    assert comm.allreduce(float(np.abs(u - x @ strain).max(initial=0.0)), op=MPI.MAX) < 1e-10
    area = (1 + strain[0, 0]) * (1 + strain[1, 1])
    expected = np.diag([0, 0, -0.3 / area])
    assert comm.allreduce(float(stress_errors(solution, expected)), op=MPI.MAX) < 1e-10
    contact = solution.contacts[0]
    assert contact.force == pytest.approx((0, 0, 0.3), abs=1e-10)
    assert contact.largest_pressure == pytest.approx(0.3, abs=1e-10)


@pytest.mark.parametrize("analysis", ["forward", "inverse"])
@pytest.mark.parametrize("degree", [1, 2])
def test_tied_blocks_of_equal_meshes_are_one_block(comm: MPI.Intracomm, analysis: str, degree: int) -> None:
    data = {"analysis": analysis, "effects": [SHEAR], "supports": CLAMP, "discretisation": {"displacement": degree}}
    tied = solved(comm, mesh=blocks(lower=2, upper=2, hexahedra=True), **data).solutions[0]
    whole = solved(comm, mesh=box((2, 2, 2), hexahedra=True), interfaces=[], **data).solutions[0]
    places = np.round(whole.mesh_nodes, 9)
    for x, u in zip(np.round(tied.mesh_nodes, 9), tied.u, strict=True):
        (same,) = np.flatnonzero((places == x).all(axis=1))
        assert np.abs(whole.u[same] - u).max() < 1e-10


@pytest.mark.parallel([3, 2, 1])
@pytest.mark.parametrize("first", ["inverse", "forward"])
def test_tied_blocks_come_back(comm: MPI.Intracomm, first: str) -> None:
    mesh = blocks(lower=2, upper=3)
    data = {"analysis": "round_trip", "first": first, "effects": [SHEAR], "supports": CLAMP}
    result = solved(comm, mesh=mesh, discretisation={"displacement": 2}, **data)
    assert result.errors["round_trip"]["max"] < 1e-12
    there, back = (solution.contacts[0] for solution in result.solutions)
    assert back.force == pytest.approx(there.force, abs=1e-10)
