"""Kernels of the weak form: the same for other parameters, without terms of effects that are not listed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from ffcx.naming import compute_signature
from helpers.verification import box, job

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.base.quantity.parameter_paths import Number
from hpcinv.base.quantity.schema import dotted_key
from hpcinv.errors import JobError
from hpcinv.job.job import Job
from hpcinv.job.reuse_key import reuse_group_of
from hpcinv.mesh import Body, build_body
from hpcinv.model.weak_form import WeakForm
from hpcinv.physics.effects import effects
from hpcinv.physics.materials import laws
from hpcinv.solver.equations import Equations

GRAVITY = {"effect": "gravity", "acceleration": [0, -9.81, 0], "density": 1000}


def weak_form(comm: MPI.Intracomm, c1: str = "10 kPa", **data: Any) -> WeakForm:
    case = job(
        mesh=box((1, 1, 1)),
        material={"law": "mooney-rivlin", "c1": c1, "c2": "5 kPa", "d1": "1 MPa"},
        supports=[{"region": "x0", "fix": ["x", "y", "z"]}],
        **data,
    )
    body = build_body(case.mesh, case.regions, comm, resolve=case.resolve)
    return Equations(case, body, Timings()).weak_form("inverse")


def signatures(weak_form: WeakForm) -> tuple[str, str]:
    """What DOLFINx's cache knows the residual and the stress by."""
    points = np.array([[0.25, 0.25, 0.25]])
    return weak_form.residual.signature(), compute_signature([(weak_form.cauchy_stress[0][0], points)], "")


def test_other_values_need_no_other_kernels(comm: MPI.Intracomm) -> None:
    first = weak_form(comm, effects=[GRAVITY])
    for _ in range(120):  # UFL's running numbers get another digit
        fem.Constant(first.unknowns.mesh, 1.0)
    later = weak_form(comm, c1="20 kPa", effects=[GRAVITY | {"density": 5}])
    assert signatures(later) == signatures(first)


def test_unlisted_effects_leave_no_term(comm: MPI.Intracomm) -> None:
    bare = weak_form(comm)
    loaded = weak_form(comm, effects=[GRAVITY])
    assert len(bare.residual.constants()[0].value) == 1 + 3  # load factor, c1 c2 d1
    assert len(loaded.residual.constants()[0].value) == 1 + 3 + 4
    assert bare.residual.signature() != loaded.residual.signature()


DIRECTIONS = {"fibre": [1, 0, 0], "sheet": [0, 1, 0], "muscle": [1, 0, 0], "fibre1": [1, 1, 0], "fibre2": [1, -1, 0]}
FORMULA = {
    "law": "formula",
    "energy": "a/2*(I1_bar - 3) + (b - c)*(I1_bar - 3)^2 + d*max(I1_bar - 3 - e, 0)^2",
    "parameters": {"a": "10 kPa", "b": "3 kPa", "c": "2 kPa", "d": "1 kPa", "e": 0.2},
    "kappa": "50 kPa",
}
INGREDIENTS = {
    **{f"law {name}": ("material", law.example) for name, law in laws().items()},
    **{
        f"effect {name}": ("effects[0]", effect.example)
        for name, effect in effects().items()
        if not effect.only_of_kind
    },
    "law formula with differences": ("material", FORMULA),
}


def variants(case: Job, section: str) -> Iterator[Job]:
    """The job with each number of a law or effect replaced by 0, 1, 2, and by others near its own."""
    for place, number in case.owners[section].numbers().items():
        if isinstance(number, Number):
            unit = "" if number.dimension is None else number.dimension.unit
            for value in (0.0, 1.0, 2.0, 1.5 * number.value, -number.value):
                try:
                    yield case.with_({dotted_key((section, *place)): f"{value!r} {unit}" if unit else value})
                except JobError:  # it is not admissible, or contradicts others
                    continue
    if section == "material" and "parameters" in case.data["material"]:
        yield case.with_({"material.parameters.b": "2 kPa"})  # the difference vanishes


@pytest.mark.everyday("law neo-hookean")
@pytest.mark.parametrize("name", INGREDIENTS)
def test_jobs_of_a_reuse_group_have_the_same_forms(name: str, comm: MPI.Intracomm) -> None:
    section, example = INGREDIENTS[name]
    content: Mapping[str, Any] = {
        "analysis": "forward",
        "material": {"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"},
        "effects": [],
        "fibres": {n: {"direction": d, "given_on": "reference"} for n, d in DIRECTIONS.items()},
    }
    first = job(
        mesh=box((1, 1, 1)),
        supports=[{"region": "x0", "fix": ["x", "y", "z"]}],
        **{**content, section.partition("[")[0]: example if section == "material" else [example]},
    )
    body = build_body(first.mesh, first.regions, comm, resolve=first.resolve)
    group, form = reuse_group_of(first), form_of(first, body)
    same = [form_of(case, body) == form for case in variants(first, section) if reuse_group_of(case) == group]
    assert all(same)


def form_of(case: Job, body: Body) -> str:
    model = Equations(case, body, Timings())
    return str(model.weak_form(case.directions[0]).residual.signature())
