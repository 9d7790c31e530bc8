"""Jobs that differ in some sections are the jobs that reading all of each one gives, with the same keys and faults."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from itertools import chain, pairwise, zip_longest
from pathlib import Path
from typing import Any

import pytest

from hpcinv.base.quantity.keys import assigned
from hpcinv.errors import JobError
from hpcinv.job.fingerprint import NOT_CONTENT, content_key, hash_of
from hpcinv.job.job import load, parse
from hpcinv.job.job_variants import JobVariants
from hpcinv.job.resolved_job import resolved
from hpcinv.job.reuse_key import numbers_of, reuse_group_of
from hpcinv.job.section_memo import SectionMemo
from hpcinv.job.yaml_reader import read_yaml
from hpcinv.output.run_directory import as_yaml
from hpcinv.physics.effects import effects
from hpcinv.physics.materials import laws
from hpcinv.studies.sweep.sweep_plan import CaseReader, read_sweep

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
    variants = JobVariants(BEAM, untrusted=False)
    for content in contents(CHANGES):
        job, whole = variants.job(content), parse(content, BEAM)
        assert job == whole
        assert (job.path, job.data, job.model_fields_set) == (whole.path, whole.data, whole.model_fields_set)
        key, group, numbers, home = variants.identity(job)
        assert (key, group, numbers) == (content_key(whole), reuse_group_of(whole), numbers_of(whole))
        assert home == (BEAM.parent / whole.mesh.file).absolute().parent


def test_keys_are_hashes_of_the_data_of_a_job() -> None:
    """Keys are made of texts of sections. Earlier versions hashed the whole data."""
    for job in (parse(content, BEAM) for content in contents(CHANGES)):
        assert content_key(job) == hash_of([resolved(job, NOT_CONTENT), {}])
        assert content_key(job, ranks=2) == hash_of([resolved(job, NOT_CONTENT), {"ranks": 2}])


def test_faults_between_sections_depend_on_all_that_they_read() -> None:
    """A fault is found also after cases without it."""
    data = assigned(read_yaml(BEAM), {"discretisation": {"formulation": "auto", "displacement": 1}})
    variants = JobVariants(BEAM, untrusted=False)
    soft, stiff = ({"material.lam": lam} for lam in ("50 kPa", "1 GPa"))
    for change in (soft, {"material.mu": "30 kPa", **soft}, stiff, soft, stiff):
        content = assigned(data, change)
        if change is not stiff:
            assert variants.job(content) == parse(content, BEAM)
            continue
        with pytest.raises(JobError, match="the material is nearly incompressible"):
            variants.job(content)


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


SWEEPS = [path for path in sorted(JOBS.glob("*.yaml")) if "axes" in read_yaml(path)]


@pytest.mark.everyday("sweep-beam-laws", "paper-monte-carlo")
@pytest.mark.parametrize("path", SWEEPS, ids=lambda path: path.stem)
def test_planned_cases_have_the_keys_of_single_jobs(path: Path) -> None:
    plan = read_sweep(path).plan(40)
    reader = CaseReader(plan)
    for case in plan.cases[:: max(1, len(plan.cases) // 5)]:
        job, read = load(plan.content(case), directory=JOBS), reader.job(plan.cases.points[case.number])
        assert dict(read) == dict(job)
        assert as_yaml(read.data) == as_yaml(plan.content(case))
        assert case.key == content_key(job)
        assert case.reuse_group == reuse_group_of(job)
        assert case.numbers == numbers_of(job)


def number_leaves(data: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    """Keys of a job, and other values: of its numbers and quantities a little more, of its flags the other one."""
    if isinstance(data, Mapping):
        for name, entry in data.items():
            if re.fullmatch(r"[\w-]+", name):  # names that are keys themselves cannot be part of one
                yield from number_leaves(entry, f"{place}.{name}" if place else name)
    elif isinstance(data, list):
        for i, entry in enumerate(data):
            yield from number_leaves(entry, f"{place}[{i}]")
    elif isinstance(data, bool):
        yield place, not data
    elif isinstance(data, int | float):
        yield place, data + 1 if isinstance(data, int) else 1.0625 * data
    elif isinstance(data, str) and (match := re.match(r"-?\d+(\.\d+)?(e[-+]?\d+)?(?= |$)", data)):
        yield place, f"{1.0625 * float(match[0])!r}{data[match.end() :]}"


def check_leaves(data: Mapping[str, Any], path: Path, *below: str, in_pairs: bool = False) -> int:
    """Compare jobs that differ from one in the value of a key, and of the next one, with jobs that are read whole.

    Return the number of jobs without a fault.
    """
    variants, valid = JobVariants(path, untrusted=False), 0
    leaves = [(key, value) for key, value in number_leaves(data) if not below or key.startswith(below)]
    single: list[dict[str, Any]] = [{key: value} for key, value in leaves]
    pairs = [dict(pair) for pair in pairwise(leaves) if in_pairs]
    for settings in ({}, *chain(*zip_longest(single, pairs, fillvalue={}))):
        content = assigned(data, settings)
        try:
            whole = parse(content, path)
        except JobError as error:
            with pytest.raises(JobError, match=re.escape(str(error))):
                variants.job(content)
            continue
        job = variants.job(content)
        assert job == whole
        assert [job.model_dump_json(), job.model_fields_set] == [whole.model_dump_json(), whole.model_fields_set]
        key, group, numbers, _ = variants.identity(job)
        assert (key, group, numbers) == (content_key(whole), reuse_group_of(whole), numbers_of(whole)), settings
        valid += 1
    return valid


def test_what_does_not_read_a_number_is_not_evaluated_again() -> None:
    """Whether it reads a number is found out, also where functions of C read it, and by way of a property."""
    variants, memo, calls = JobVariants(BEAM, untrusted=False), SectionMemo(), Counter[str]()
    functions: dict[str, Callable[[Any], Any]] = {
        "type": lambda job: isinstance(job.material.mu, float),
        "law": lambda job: (job.material.law, [*job.material.families]),
        "sign": lambda job: job.material.mu > 2500,
        "root": lambda job: math.sqrt(job.material.mu) > 50,
        "logarithm": lambda job: math.log10(job.material.mu) < 10,
        "text": lambda job: f"{job.material.mu:.1e}",
        "form": lambda job: job.is_mixed,
        "of a result": lambda job: "high" if memo.of("sign", functions["sign"], job) else "low",
        "of data": lambda job: [*memo.of("data", lambda job: {"mu": job.material.mu}, job)],
    }

    def counted(name: str, job: Any) -> Any:
        calls[name] += 1
        return functions[name](job)

    data = assigned(read_yaml(BEAM), {"discretisation": {"formulation": "auto"}})
    for number in range(40):
        job = variants.job(assigned(data, {"material.mu": 2e3 + 25 * number}))
        for name, function in functions.items():
            assert memo.of(name, partial(counted, name), job) == function(job), name
    assert {name for name in functions if calls[name] < 10} == {"type", "law", "form", "of a result", "of data"}


FIBRES = {
    name: {"direction": ["q*X", 1, k], "given_on": "reference", "constants": {"q": 2}}
    for k, name in enumerate(("fibre", "fibre1", "fibre2", "sheet", "muscle"), 1)
}
PLAIN: Mapping[str, Any] = {
    "mesh": {"file": str(JOBS.parent / "meshes" / "box.py"), "parameters": {"lx": "1 m"}},
    "fibres": FIBRES,
    "supports": [{"region": "z0", "displacement": ["q*x", 0, "2 mm"], "constants": {"q": 0.5}}],
    "quantities": [{"name": "tip", "of": "uz", "on": "z1", "reduce": "mean"}],
}


MATERIALS: Mapping[str, Any] = {
    **{name: law.example for name, law in laws().items()},
    "moduli": {"law": "neo-hookean", "young": "3 kPa", "poisson": 0.25},
    "layers": {"inner": {"law": "neo-hookean", "mu": "1 kPa", "lam": "4 kPa"}, "elsewhere": laws()["yeoh"].example},
}


@pytest.mark.everyday("neo-hookean", "ogden", "holzapfel-gasser-ogden", "moduli", "layers")
@pytest.mark.parametrize("material", MATERIALS)
def test_every_number_of_a_law_is_read_as_in_a_whole_job(material: str) -> None:
    """Numbers of fibres, supports and mesh with one of the laws."""
    below = ("material",) if material != "neo-hookean" else ()
    data = {**PLAIN, "material": MATERIALS[material], "discretisation": {"formulation": "auto"}}
    assert check_leaves(data, JOBS / "none.yaml", *below) > 1


@pytest.mark.everyday("gravity", "thermal-expansion", "contact")
@pytest.mark.parametrize("name", effects())
def test_every_number_of_an_effect_is_read_as_in_a_whole_job(name: str) -> None:
    effect = effects()[name]
    analysis = "inverse" if "inverse" in effect.directions else "forward"
    data = {**PLAIN, "analysis": analysis, "material": MATERIALS["neo-hookean"], "effects": [effect.example]}
    assert check_leaves(data, JOBS / "none.yaml", "effects") > 1 or effect.only_of_kind


@pytest.mark.release
@pytest.mark.parametrize("path", sorted(JOBS.glob("*.yaml")), ids=lambda path: path.stem)
def test_every_number_of_a_job_is_read_as_in_a_whole_job(path: Path) -> None:
    data = read_yaml(path)
    if not {"axes", "study"} & data.keys():
        assert check_leaves(data, path, in_pairs=True) > 0


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
