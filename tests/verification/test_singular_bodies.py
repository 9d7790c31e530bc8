"""Errors of bodies with singular edges: the estimate, and promises of accuracy, against values on graded meshes; and
the estimate of a body whose error in one Newton step is as large as the error of the mesh.

The values are of `benchmarks/slabs/plane_strain.py`, a program of its own: cubic triangles that shrink towards each
singular point, down to 2 mm; quartic ones down to 1 mm differ by at most 2e-6 m.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

import pytest
from helpers.command_line import ROOT
from helpers.verification import box, job

import hpcinv as package
from hpcinv.base.parallel.runtime import MPI
from hpcinv.trust.certificate import Verdict
from hpcinv.trust.discretisation import two_level

sys.path.append(str(ROOT / "benchmarks"))

from promises import SLABS, inner_radius_under_pressure, slab, sphere

# Displacement (m) of compressible and of incompressible slabs.
EXACT = {
    ("corner", False): -0.190641,
    ("corner", True): -0.142311,
    ("cantilever", False): -0.243935,
    ("cantilever", True): -0.174153,
    ("slot", True): 0.060333,
}


def data_of(name: str, *, incompressible: bool, **options: Any) -> dict[str, Any]:
    problem = SLABS[name]
    return slab(replace(problem, lam=None) if incompressible else problem, **options)


@pytest.mark.everyday("cantilever-False-False-2", "slot-True-False-2")
@pytest.mark.parametrize(
    ("name", "incompressible", "hexahedra", "displacement"),
    [
        ("corner", False, True, 2),
        pytest.param("corner", False, False, 3, marks=pytest.mark.release),
        pytest.param("corner", True, False, 2, marks=pytest.mark.release),
        ("corner", True, False, 3),
        ("corner", True, True, 2),
        ("cantilever", False, False, 2),
        ("cantilever", True, True, 2),
        ("slot", True, False, 2),
    ],
)
def test_estimates_are_right_by_a_factor_of_2_or_say_that_they_are_not_reliable(
    name: str, incompressible: bool, hexahedra: bool, displacement: int, comm: MPI.Intracomm
) -> None:
    data = data_of(name, incompressible=incompressible, hexahedra=hexahedra, displacement=displacement)
    result = package.run(job(**data), comm)
    assert result.estimate is not None
    assert result.estimate.limit is not None
    true = EXACT[name, incompressible] - result.quantities["q"]
    effectivity = result.estimate.quantities["q"] / true
    print(f"{name}: true error {true:.1e} m, effectivity {effectivity:.2f}, {result.estimate.limit.text}")
    (line,) = (line for line in result.certificate.lines if line.name.startswith("discretisation"))
    if result.estimate.limit.is_reliable:
        assert 0.5 <= effectivity <= 2
        assert "not reliable" not in line.note
    else:
        assert incompressible  # of a displacement alone, errors cannot cancel
        assert hexahedra or name == "slot"  # and tetrahedra are mostly good
        assert "not reliable here" in line.note
        assert line.verdict is not Verdict.PASS or 10 * (line.value or 0) <= 0.05


@pytest.mark.everyday("0.0")
@pytest.mark.parametrize("operations", [0.0, float("inf")])
def test_second_order_errors_of_the_correction_are_corrected(
    operations: float, comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Near the largest pressure of a sphere one correction has an effectivity of 1.3, by iterations and by factors."""
    monkeypatch.setattr(two_level, "MANY", operations)
    data = sphere(0.5, hexahedra=True, radial=1) | {"certificate": {"level": "off", "estimate": True}}
    result = package.run(job(**data), comm)
    assert result.estimate is not None
    true = inner_radius_under_pressure(0.5) - result.quantities["q"]
    print(f"true error {true:.2e} m, effectivity {result.estimate.quantities['q'] / true:.3f}")
    assert result.estimate.quantities["q"] == pytest.approx(true, rel=0.1)


def test_a_promise_at_a_reentrant_corner_is_kept(comm: MPI.Intracomm) -> None:
    """Hexahedra, incompressible: estimates fall from 4.3e-3 to 2.2e-4 m where errors fall from 4.0e-3 to 8.0e-4 m."""
    demand = 6e-4  # m
    data = data_of("corner", incompressible=True, hexahedra=True)
    result = package.run(job(**data, accuracy={"q": demand}, solver={"maximum_unknowns": 2500}), comm)
    record = result.accuracy
    assert record is not None
    print("\n".join(row.described({}, {}) for row in record.rows))
    true = abs(result.quantities["q"] - EXACT["corner", True])
    (line,) = (line for line in result.certificate.lines if line.name == "error of q")
    assert true <= record.bounds["q"]
    assert true > demand  # within this limit, so that no promise may be made
    assert line.verdict is Verdict.FAIL
    assert "re-entrant edge of 270° at (1, 1, " in line.note
    assert "tetrahedra can be refined towards it, hexahedra cannot" in line.note


def test_no_mesh_of_a_search_has_more_unknowns_than_allowed(comm: MPI.Intracomm) -> None:
    """Cells that keep the mesh conforming count, too."""
    most = 3000
    data = data_of("block", incompressible=True, hexahedra=False)
    record = package.run(job(**data, accuracy={"q": 6e-4}, solver={"maximum_unknowns": most}), comm).accuracy
    assert record is not None
    print("\n".join(row.described({}, {}) for row in record.rows))
    assert max(row.unknowns for row in record.rows) <= most
    assert record.ending.name == "LIMIT"


def test_tetrahedra_are_refined_towards_a_corner(comm: MPI.Intracomm) -> None:
    demand = 1e-2  # m
    result = package.run(job(**data_of("corner", incompressible=False, hexahedra=False), accuracy={"q": demand}), comm)
    record = result.accuracy
    assert record is not None
    print("\n".join(row.described({}, {}) for row in record.rows))
    assert record.ending.name == "MET"
    assert abs(result.quantities["q"] - EXACT["corner", False]) <= record.bounds["q"] <= demand


def test_a_region_by_a_condition_says_that_its_border_moves(comm: MPI.Intracomm) -> None:
    soft, stiff = ({"law": "neo-hookean", "mu": mu, "lam": "40 kPa"} for mu in ("10 kPa", "40 kPa"))
    stack = job(
        analysis="forward",
        mesh=box((1, 1, 4), lx="0.2 m", ly="0.2 m", hexahedra=True),
        regions={"low": "z < 0.3 m"},  # a quarter of the body with 4 and 8 cells, and a third with 3
        material={"low": stiff, "elsewhere": soft},
        effects=[{"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 1000}],
        supports=[{"region": "boundary", "fix": ["x", "y"]}, {"region": "z0", "fix": ["z"]}],
        quantities=[{"name": "q", "of": "uz", "at": [0.1, 0.1, 1.0]}],
        accuracy={"q": "1 mm"},
        solver={"maximum_unknowns": 2000},
    )
    result = package.run(stack, comm)
    assert result.accuracy is not None
    print("\n".join(row.described({}, {}) for row in result.accuracy.rows))
    (line,) = result.accuracy.lines({}, {})
    assert "the border of 'low' is not on the mesh, and moves with its cells" in line.note
