"""Stability without factors: the lowest eigenvalue by iteration, against the inertia, on bodies that buckle."""

from __future__ import annotations

from math import pi
from typing import Any

import pytest
from helpers.command_line import NO_CERTIFICATE
from helpers.verification import box, job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.job.job import Job
from hpcinv.trust.certificate import Line, Verdict
from hpcinv.trust.stability.forward_factors import ForwardFactors

LENGTH, SIDE, YOUNG = 1.0, 0.1, 1e6
EULER = pi**2 * YOUNG * SIDE**4 / 12 / (4 * LENGTH**2)
LAWS: dict[str, dict[str, Any]] = {
    "displacement": {"law": "neo-hookean", "young": YOUNG, "poisson": 0.3},
    "nearly incompressible": {"law": "neo-hookean", "young": YOUNG, "poisson": 0.4999},
    "incompressible": {"law": "isochoric-neo-hookean", "mu": YOUNG / 3, "kappa": "incompressible"},
}


def column(share: float, law: str, **changes: Any) -> Job:
    """Clamped below, free above, under a share of Euler's load."""
    load = [0, 0, -share * EULER / SIDE**2]
    data = {
        "analysis": "forward",
        "mesh": box((1, 1, 8), lx=SIDE, ly=SIDE, lz=LENGTH),
        "material": LAWS[law],
        "effects": [{"effect": "traction", "region": "z1", "area_in": "reference", "traction": load}],
        "supports": [{"region": "z0", "fix": ["x", "y", "z"]}],
        "certificate": NO_CERTIFICATE | {"stability": True},
        "discretisation": {"formulation": "displacement" if law == "displacement" else "mixed"},
    }
    return job(**data | changes)


def line_of(column_job: Job, comm: MPI.Intracomm) -> Line:
    (line,) = (line for line in hpcinv.run(column_job, comm).certificate.lines if line.name.startswith("stability"))
    print(f"{line.verdict.value}: {line.value} ({line.note}), {line.seconds:.2f} s")
    return line


@pytest.fixture
def without_factors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ForwardFactors, "affordable", False)


@pytest.mark.everyday("displacement")
@pytest.mark.parallel([1, 3, 2])
@pytest.mark.parametrize("law", LAWS)
def test_a_column_on_both_sides_of_its_critical_load(law: str, comm: MPI.Intracomm, without_factors: None) -> None:
    stable, unstable = line_of(column(0.8, law), comm), line_of(column(1.2, law), comm)
    assert (stable.value, stable.verdict) == (0.0, Verdict.PASS)
    assert "estimated" in stable.note
    assert (unstable.value, unstable.verdict) == (1.0, Verdict.FAIL)
    assert "there may be more" in unstable.note


@pytest.mark.everyday("0.97-nearly incompressible", "0.97-incompressible", "1.06-displacement")
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("share", [0.1, 0.97, 1.06, 9.2])
def test_lowest_eigenvalue_agrees_with_the_inertia(
    law: str, share: float, comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Next to the second critical load an eigenvalue next to zero hides the lowest one from the first steps."""
    by_inertia = line_of(column(share, law), comm)
    monkeypatch.setattr(ForwardFactors, "affordable", False)
    assert line_of(column(share, law), comm).verdict is by_inertia.verdict
    assert (by_inertia.verdict is Verdict.PASS) is (share < 1)


def test_spurious_modes_are_not_taken_for_instabilities(comm: MPI.Intracomm, without_factors: None) -> None:
    """The half-block that is stable, and whose hexahedra have negative eigenvalues."""
    block = job(
        analysis="forward",
        mesh=box((4, 4, 1), lz=0.2, hexahedra=True),
        material={"law": "isochoric-neo-hookean", "mu": 1.0, "kappa": "incompressible"},
        supports=[
            *({"region": region, "fix": [region[0]]} for region in ("x0", "y0", "z0", "z1")),
            {"region": "x1", "displacement": [-0.25, None, None]},
        ],
        certificate=NO_CERTIFICATE | {"stability": True},
    )
    assert line_of(block, comm).verdict is Verdict.UNDECIDED


def test_a_load_without_potential_does_not_fail(comm: MPI.Intracomm, without_factors: None) -> None:
    """Pressure on the column's end, which follows it."""
    load = {"effect": "pressure", "region": "z1", "pressure": 1.5 * EULER / SIDE**2}
    assert line_of(column(1.0, "displacement", effects=[load]), comm).verdict in (Verdict.PASS, Verdict.WARN)


def test_a_body_that_cannot_move_is_stable(comm: MPI.Intracomm, without_factors: None) -> None:
    held = column(0.1, "displacement", supports=[{"region": "boundary", "fix": ["x", "y", "z"]}], mesh=box((1, 1, 1)))
    assert line_of(held, comm).verdict is Verdict.PASS
