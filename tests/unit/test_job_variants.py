"""Jobs that differ in some sections are the jobs that reading all of each one gives, with the same keys and faults."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from hpcinv.base.quantity.keys import assigned
from hpcinv.errors import JobError
from hpcinv.job.fingerprint import content_key
from hpcinv.job.job import parse
from hpcinv.job.job_variants import JobVariants
from hpcinv.job.resolved_job import SectionData
from hpcinv.job.reuse_key import keys_of, reuse_group_of
from hpcinv.job.yaml_reader import read_yaml
from hpcinv.studies.sweep.sweep_plan import load_sweep

JOBS = Path(__file__).parents[2] / "jobs"
BEAM = JOBS / "sagging-block.yaml"
CHANGES: list[Mapping[str, Any]] = [
    {"material.mu": "3 kPa"},
    {"material": {"law": "ogden", "mu": ["1 kPa"], "alpha": [2], "kappa": "1 MPa"}},
    {"material.lam": "1 GPa"},  # the mixed form is chosen
    {"effects[0].density": 900},
    {"mesh.parameters": {"lx": "1 m"}},
    {"mesh.partition": "metis"},
    {"supports[0]": {"region": "z0", "displacement": ["1 mm", 0, 0]}},
    {"solver.tolerance": 1e-9, "certificate": "off"},
    {"first": "inverse"},
    {"let": {"r": "X / (1 m)"}, "material.mu": "1 kPa * (1 + r**2)"},
    {"regions": {"tip": "x > 1 m"}},
    {"quantities": [{"name": "tip", "of": "uz", "on": "z1", "reduce": "min"}]},
    {"accuracy": {"sag": "1 mm"}},
    {"job": "other"},
]
FAULTS: list[Mapping[str, Any]] = [
    {"material.mu": "-3 kPa"},
    {"material.nu": 0.3},
    {"material.mu": "3 m"},
    {"supports[0].fix": ["w"]},
    {"effects[0].density": "1 kg"},
    {"method": "sellier", "analysis": "forward"},
    {"mesh.parameters": {"unknown": 1}},
    {"solver": {"tolerance": 0}},
    {"discretisation": {"displacement": 7}},
]


def contents(changes: list[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    data = read_yaml(BEAM)
    yield dict(data)
    for change in changes:
        yield assigned(data, change)


def test_jobs_and_keys_are_those_of_jobs_that_are_read_whole() -> None:
    variants, known = JobVariants(BEAM, untrusted=False), SectionData()
    for content in contents(CHANGES):
        job, whole = variants.job(content), parse(content, BEAM)
        assert job == whole
        assert (job.path, job.data, job.model_fields_set) == (whole.path, whole.data, whole.model_fields_set)
        assert keys_of(job, known) == (content_key(whole), reuse_group_of(whole))


def test_sections_that_do_not_differ_are_read_once() -> None:
    variants = JobVariants(BEAM, untrusted=False)
    first, second = (variants.job(content) for content in contents([{"material.mu": "3 kPa"}]))
    assert first.material != second.material
    assert first.mesh is second.mesh
    assert first.effects[0] is second.effects[0]


@pytest.mark.parametrize("fault", FAULTS, ids=str)
def test_faults_are_those_of_jobs_that_are_read_whole(fault: Mapping[str, Any]) -> None:
    variants = JobVariants(BEAM, untrusted=False)
    plain, wrong = contents([fault])
    variants.job(plain)
    with pytest.raises(JobError) as whole:
        parse(wrong, BEAM)
    with pytest.raises(JobError) as error:
        variants.job(wrong)
    assert error.value.problems == whole.value.problems


@pytest.mark.release
@pytest.mark.parametrize("name", ["sweep-beam-laws", "sweep-uncertain-block"])
def test_planned_cases_have_the_keys_of_single_jobs(name: str) -> None:
    plan = load_sweep(JOBS / f"{name}.yaml")
    for case in plan.cases[:: max(1, len(plan.cases) // 5)]:
        assert case.key == content_key(plan.job(case))
        assert case.reuse_group == reuse_group_of(plan.job(case))


PLUGIN = '''
from typing import Any, ClassVar, Literal

from hpcinv.base.quantity import StressField
from hpcinv.physics.materials.isochoric import IsochoricLaw


class Brittle(IsochoricLaw):
    """A law whose check fails."""

    formula = "mu/2*(I1_bar - 3)"
    example: ClassVar = {"law": "brittle-variant", "mu": "2 kPa", "kappa": "1 MPa"}
    law: Literal["brittle-variant"] = "brittle-variant"
    mu: StressField

    def shear_modulus(self, par: Any) -> Any:
        return par.mu

    def _contradictions(self, info):
        {2e3: None, 3e3: None}[float(self.mu)]
        yield from super()._contradictions(info)
'''


def test_a_plugin_that_fails_is_named(tmp_path: Path) -> None:
    (tmp_path / "brittle.py").write_text(PLUGIN)
    law = {"law": "brittle-variant", "mu": "2 kPa", "kappa": "1 MPa"}
    mesh = {"file": str(JOBS.parent / "meshes" / "box.py")}
    data = {**read_yaml(BEAM), "mesh": mesh, "plugins": ["brittle.py"], "material": law}
    variants = JobVariants(tmp_path / "job.yaml", untrusted=False)
    variants.job(data)
    variants.job(assigned(data, {"material.mu": "3 kPa"}))
    with pytest.raises(JobError, match=r"plugins: a law or effect failed where it was checked: .*brittle\.py, line"):
        variants.job(assigned(data, {"material.mu": "4 kPa"}))
