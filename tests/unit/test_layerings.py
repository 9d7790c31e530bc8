"""What divides a body into layers: laws, parameters and inelastic stretches of regions, not their names."""

from __future__ import annotations

from typing import Any

import pytest
from helpers.verification import job

from hpcinv.job.fingerprint import fingerprint
from hpcinv.job.job import Job
from hpcinv.job.resolved_job import SectionData
from hpcinv.job.reuse_key import reuse_group_of, structure_of

SOFT, STIFF = ({"law": "isochoric-neo-hookean", "mu": mu, "kappa": "incompressible"} for mu in ("10 kPa", "30 kPa"))
GROWTH = {"effect": "growth", "stretch": {"core": 1.1, "elsewhere": 1}}


def layered(material: Any, **changes: Any) -> Job:
    data: dict[str, Any] = {
        "mesh": {"file": "../meshes/box.py"},
        "regions": {"core": "z < 0.5 m", "rim": "z > 0.9 m"},
        "material": material,
        "supports": [{"region": "z0", "fix": ["x", "y", "z"]}],
    }
    return job(**data | changes)


def classes(layered_job: Job) -> list[Any]:
    return [layering.as_data() for layering in layered_job.layerings]


@pytest.mark.parametrize(
    ("material", "expected"),
    [
        (SOFT, []),
        ({"core": SOFT, "elsewhere": SOFT}, []),
        ({"core": SOFT, "elsewhere": SOFT | {"mu": "10000 Pa"}}, []),
        ({"core": SOFT, "elsewhere": STIFF}, [[None, {"core": 0, "elsewhere": 1}]]),
        ({"core": SOFT, "rim": STIFF, "elsewhere": SOFT}, [[None, {"core": 0, "rim": 1, "elsewhere": 0}]]),
        (SOFT | {"mu": {"core": 1e4, "elsewhere": 2e4}}, [[0, {"core": 0, "elsewhere": 1}]]),
        (SOFT | {"mu": {"core": 1e4, "elsewhere": 1e4}}, []),
        (SOFT | {"mu": "1e4 + 1e4*z"}, []),
    ],
)
def test_regions_of_equal_materials_are_one_layer(material: Any, expected: list[Any]) -> None:
    assert classes(layered(material)) == expected


def test_stretches_and_active_stress_divide_but_loads_do_not() -> None:
    assert classes(layered(SOFT, effects=[GROWTH])) == [[None, {"core": 0, "elsewhere": 1}]]
    gravity = {"effect": "gravity", "acceleration": [0, 0, -9.81], "density": {"core": 1000, "elsewhere": 2000}}
    assert classes(layered(SOFT, effects=[gravity])) == []
    tensor = {"core": [1.1, 1, 1], "elsewhere": [1, 1, 1.1]}
    prestrain = {"effect": "prestrain", "given_on": "reference", "tensor": tensor}
    assert classes(layered(SOFT, effects=[prestrain])) == [[None, {"core": 0, "elsewhere": 1}]]


def test_all_states_have_the_layers_of_each() -> None:
    """They share spaces, and the pressure of one is the start of another."""
    states = [
        {"name": "loaded", "given": True, "effects": [{"effect": "pressure", "region": "z1", "pressure": "1 kPa"}]},
        {"name": "grown", "effects": [GROWTH]},
    ]
    states_job = layered(SOFT, states=states)
    assert classes(states_job) == [[None, {"core": 0, "elsewhere": 1}]]
    assert [solve.job.layerings for solve in states_job.plan] == 2 * [states_job.layerings]
    assert len({structure_of(solve.job, SectionData(str)) for solve in layered(SOFT, states=states[:1]).plan}) == 1


def test_jobs_with_other_layers_share_no_equations_and_no_checkpoints() -> None:
    equal, soft, stiff = (
        layered({"core": SOFT, "elsewhere": SOFT | {"mu": mu}}) for mu in ("10 kPa", "5 kPa", "20 kPa")
    )
    groups = [reuse_group_of(variant, SectionData(str)) for variant in (equal, soft, stiff)]
    assert groups[0] != groups[1] == groups[2]
    assert "layers" not in fingerprint(equal, SectionData(str))["discretisation"]
    assert (
        fingerprint(soft, SectionData(str))["discretisation"] != fingerprint(equal, SectionData(str))["discretisation"]
    )


def test_the_displacement_form_has_no_layers() -> None:
    compressible = {"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"}
    displacement_job = layered({"core": compressible, "elsewhere": compressible | {"mu": "5 kPa"}})
    assert "layers" not in fingerprint(displacement_job, SectionData(str))["discretisation"]


def test_regions_with_numbers_that_vary_are_layers_though_they_are_equal_now() -> None:
    """Their derivative has a jump of the pressure."""
    equal = {"core": SOFT, "elsewhere": SOFT}
    expected = [[None, {"core": 0, "elsewhere": 1}]]
    assert classes(layered(equal, sensitivities=["material.core.mu"])) == expected
    gravity = {"effect": "gravity", "acceleration": [0, 0, -9.81], "density": 1000}
    assert classes(layered(equal, effects=[gravity], sensitivities=["effects[0].density"])) == []
    fields = SOFT | {"mu": {"core": 1e4, "elsewhere": 1e4}}
    assert classes(layered(fields, sensitivities=["material.mu.core"])) == [[0, {"core": 0, "elsewhere": 1}]]
