"""Why the full load was not reached: every reason distinguished from the others."""

from __future__ import annotations

from typing import Any

import pytest
from helpers.closed_forms import NEO_HOOKEAN
from helpers.paths import OCTANT, SPHERE, cube, tried
from helpers.verification import box, job

from hpcinv.base.parallel.runtime import MPI
from hpcinv.job.job import Job
from hpcinv.model.outcome import Outcome
from hpcinv.solver.diagnosis import Diagnosis, diagnose
from hpcinv.solver.methods.fallbacks import attempts
from hpcinv.solver.newton import Solve

pytestmark = pytest.mark.slow


def sphere_beyond_its_limit() -> Job:
    """See `test_thick_sphere`: no cavity, however small, carries more than 2.0919 Pa."""
    return job(
        mesh=SPHERE,
        material={"law": "mooney-rivlin", "c1": 0.5, "c2": 0.0, "d1": "incompressible"},
        effects=[{"effect": "pressure", "region": "inner", "pressure": 2.5}],
        supports=OCTANT,
    )


def bar(material: dict[str, Any], stretch: float, **solver: Any) -> Job:
    """Drawn to a stretch, free to contract."""
    return job(
        analysis="forward",
        mesh=box((1, 1, 1), hexahedra=True),
        material=material,
        supports=[
            {"region": "x0", "fix": ["x"]},
            {"region": "x1", "displacement": [stretch - 1, None, None]},
            {"region": "y0", "fix": ["y"]},
            {"region": "z0", "fix": ["z"]},
        ],
        solver=solver,
    )


def flattened() -> Job:
    """Squeezed to less than nothing, without a way to the side."""
    return job(
        analysis="forward",
        mesh=box((2, 1, 1), hexahedra=True),
        material=NEO_HOOKEAN,
        supports=[
            {"region": "x0", "fix": ["x"]},
            {"region": "x1", "displacement": ["-1.5 m", None, None]},
            *({"region": f"{side}", "fix": [side[0]]} for side in ("y0", "y1", "z0", "z1")),
        ],
        discretisation={"formulation": "displacement"},
        solver={"continuation": "steps"},
    )


def column() -> Job:
    """Squeezed straight to nothing, far beyond the load at which it would buckle over its thin side."""
    return job(
        analysis="forward",
        mesh=box((6, 1, 1), lx=6.0, ly=1.0, lz=0.7, hexahedra=True),
        material=NEO_HOOKEAN,
        supports=[
            {"region": "x0", "fix": ["x", "y", "z"]},
            {"region": "x1", "displacement": ["-6 m", None, None]},
        ],
        discretisation={"formulation": "displacement"},
        solver={"initial_step": 0.02, "rescue": [], "continuation": "steps"},
    )


HOPELESS = {
    "limit point": (lambda: cube(1.25), Diagnosis.LIMIT_POINT),
    "limit point that load steps meet": (lambda: cube(1.25, strategy="adaptive"), Diagnosis.LIMIT_POINT),
    "sphere beyond its limit": (sphere_beyond_its_limit, Diagnosis.NO_UNDEFORMED_SHAPE),
    "law's limit": (
        lambda: bar({"law": "gent", "mu": 1e4, "jm": 0.5, "kappa": "incompressible"}, 1.5),
        Diagnosis.OUTSIDE_LAW,
    ),
    "flattened": (flattened, Diagnosis.INVERTED),
    "column": (column, Diagnosis.LOSS_OF_STABILITY),
    "few iterations": (
        lambda: bar(NEO_HOOKEAN, 3.0, maximum_iterations=2, minimum_step=0.5, rescue=[], continuation="steps"),
        Diagnosis.ITERATION_LIMIT,
    ),
}


@pytest.mark.everyday(
    "limit point",
    "limit point that load steps meet",
    "sphere beyond its limit",
    "flattened",
    "column",
    "few iterations",
)
@pytest.mark.parametrize("case", HOPELESS)
def test_reasons_are_distinguished(case: str, comm: MPI.Intracomm) -> None:
    make, reason = HOPELESS[case]
    hopeless = make()
    solves = tried(hopeless, comm)
    diagnosis = diagnose(hopeless.directions[0], solves)
    load = max((s.load for s in solves if s.outcome.accepted), default=0.0)
    print(f"{case}: {diagnosis.name} at load factor {load:.4f}; {attempts(solves)}")
    assert diagnosis is reason


def path(*loads: float, turning: tuple[float, ...] = (), end: Outcome) -> list[Solve]:
    """An arc-length path through these loads, and how it ended."""
    points = [Solve(x, Outcome.CONVERGED, (), 1, (1,), None, 0, "arc-length", x in turning) for x in loads]
    return [*points, Solve(loads[-1], end, (), 1, (), None, 0, "arc-length")]


@pytest.mark.parametrize(
    ("solves", "expected"),
    [
        (path(0.5, 0.8, turning=(0.8,), end=Outcome.LIMIT_POINT), Diagnosis.LIMIT_POINT),
        (path(0.9, 3.5, 3.1, turning=(3.5,), end=Outcome.VOLUME_CHANGED), Diagnosis.BEYOND_FULL_LOAD),
        (path(0.9, 3.5, 3.1, turning=(3.5,), end=Outcome.DIVERGED), Diagnosis.BEYOND_FULL_LOAD),
        (path(0.9, 3.4, end=Outcome.INVERTED), Diagnosis.BEYOND_FULL_LOAD),
        (path(0.9, 1.5, 1.2, turning=(1.5, 1.2), end=Outcome.LIMIT_POINT), Diagnosis.LEAST_LOAD),
        (path(0.9, 3.4, end=Outcome.STEP_LIMIT), Diagnosis.STEP_LIMIT),
    ],
)
def test_a_path_beyond_full_load_differs_from_one_below_it(solves: list[Solve], expected: Diagnosis) -> None:
    assert diagnose("inverse", solves) is expected


def test_a_singular_tangent_of_the_unloaded_body_differs_from_a_later_one() -> None:
    singular = Solve(0.5, Outcome.LINEAR_SOLVER, (), 1)
    assert diagnose("forward", [singular]) is Diagnosis.ILL_POSED
    assert diagnose("forward", [Solve(0.2, Outcome.CONVERGED, (), 1, (1,)), singular]) is Diagnosis.LINEAR_SOLVER


def test_arc_length_that_ran_out_of_factorizations_is_advised_without_that_limit() -> None:
    """As on a coarse sphere of tetrahedra that softens, beyond its limit, where it finds the limit if it may."""
    steps = [Solve(0.5, Outcome.CONVERGED, (), 1, (1,)), Solve(1.0, Outcome.DIVERGED, (), 1)]
    arcs = path(0.8, 0.87, end=Outcome.STEP_LIMIT)
    last = Solve(0.88, Outcome.DIVERGED, (), 1, (), None, 0, "line-search")
    assert diagnose("inverse", [*steps, *arcs, last]) is Diagnosis.ARC_LENGTH_CUT_SHORT
    assert diagnose("inverse", [*steps, last]) is Diagnosis.NOT_CONVERGED
