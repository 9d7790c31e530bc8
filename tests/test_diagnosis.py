"""Why the full load was not reached: every reason told apart from the others."""

from __future__ import annotations

from typing import Any

import pytest
from closed_forms import NEO_HOOKEAN
from paths import OCTANT, SPHERE, cube, tried
from verification import box, job

from hpcinv.diagnosis import Diagnosis, diagnose
from hpcinv.job import Job
from hpcinv.methods.cascade import attempts
from hpcinv.runtime import MPI


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
        solver={"initial_step": 0.02, "rescue": []},
    )


def nowhere_to_go() -> Job:
    """Held all around, an incompressible body has any pressure."""
    return job(
        analysis="forward",
        mesh=box((2, 1, 1), hexahedra=True),
        material={"law": "neo-hookean", "mu": 1e3, "lam": "incompressible"},
        supports=[{"region": "boundary", "displacement": ["0.1*y", 0, 0]}],
    )


HOPELESS = {
    "fold": (lambda: cube(1.25), Diagnosis.FOLD),
    "fold that load steps meet": (lambda: cube(1.25, strategy="adaptive"), Diagnosis.FOLD),
    "sphere beyond its limit": (sphere_beyond_its_limit, Diagnosis.NO_UNDEFORMED_SHAPE),
    "law's limit": (
        lambda: bar({"law": "gent", "mu": 1e4, "jm": 0.5, "kappa": "incompressible"}, 1.5),
        Diagnosis.LAW_DOMAIN,
    ),
    "flattened": (flattened, Diagnosis.INVERSION),
    "column": (column, Diagnosis.LOSS_OF_STABILITY),
    "nowhere to go": (nowhere_to_go, Diagnosis.ILL_POSED),
    "few iterations": (
        lambda: bar(NEO_HOOKEAN, 3.0, maximum_iterations=2, minimum_step=0.5, rescue=[]),
        Diagnosis.ITERATION_LIMIT,
    ),
}


@pytest.mark.parametrize("case", HOPELESS)
def test_reasons_are_told_apart(case: str, comm: MPI.Intracomm) -> None:
    make, reason = HOPELESS[case]
    hopeless = make()
    solves = tried(hopeless, comm)
    found = diagnose(hopeless.legs[0], solves)
    load = max((s.load for s in solves if s.outcome.accepted), default=0.0)
    print(f"{case}: {found.name} at load factor {load:.4f}; {attempts(solves)}")
    assert found is reason
