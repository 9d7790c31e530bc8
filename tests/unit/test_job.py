"""From a job file to a typed job, or to everything that is wrong with it."""

from __future__ import annotations

import copy
import json
import math
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar, Literal

import pytest
import yaml
from helpers.job_cases import BEAM, Edit, Loader
from pydantic import ValidationError

import hpcinv
from hpcinv.base.quantity.schema import problems_in
from hpcinv.job.job import Job, json_schema
from hpcinv.job.yaml_reader import is_study, is_sweep, read_yaml
from hpcinv.physics.effects.effect import Direction, Effect
from hpcinv.studies.study.study_plan import load_study
from hpcinv.studies.sweep.sweep_plan import load_sweep


def test_a_job_is_read_in_si_with_defaults(load: Loader) -> None:
    job = load()
    assert job.job == "arm"
    assert job.analysis == "inverse"
    assert job.directions == ("inverse",)
    assert job.mesh.parameters == {"size": 0.002}
    assert job.mesh.partition == "metis"
    assert job.material.shear_modulus(job.material) == pytest.approx(2 * (101709.668 + 151065.460))
    assert job.material.bulk_modulus(job.material) == pytest.approx(2 * 7.965272689e8)
    assert job.supports[0].held == {"x", "y", "z"}
    assert (job.is_mixed, job.pressure_degree) == (True, 1)
    assert job.solver.strategy == "adaptive"
    assert job.path is not None
    assert job.resolve(job.mesh.file).resolve() == job.path.parent.parent / "meshes" / "beam.py"


def test_a_job_is_immutable_and_travels_between_processes(load: Loader) -> None:
    job = load()
    with pytest.raises(ValidationError):
        job.analysis = "forward"  # type: ignore[misc]
    copy = pickle.loads(pickle.dumps(job))
    assert copy == job
    assert copy.path == job.path


def test_a_round_trip_has_two_directions(load: Loader) -> None:
    assert load(lambda j: j.update(analysis="round_trip")).directions == ("inverse", "forward")
    assert load(lambda j: j.update(analysis="round_trip", first="forward")).directions == ("forward", "inverse")


def test_young_and_poisson_stand_for_the_lame_parameters(load: Loader) -> None:
    def edit(job: dict[str, Any]) -> None:
        job["material"] = {"law": "neo-hookean", "young": "90 kPa", "poisson": 0.25}

    material = load(edit).material
    assert material.model_dump() == pytest.approx({"law": "neo-hookean", "mu": 36e3, "lam": 36e3})
    assert material.bulk_modulus(material) == pytest.approx(60e3)  # E / (3 (1 - 2 nu))


@pytest.mark.parametrize(
    ("material", "mixed"),
    [
        ({"law": "neo-hookean", "mu": 1.0, "lam": 9.0}, False),
        ({"law": "neo-hookean", "mu": 1.0, "lam": 10.0}, True),
        ({"law": "neo-hookean", "young": 1.0, "poisson": 0.5}, True),
        ({"law": "mooney-rivlin", "c1": 1.0, "c2": 0.0, "d1": "incompressible"}, True),
        ({"law": "mooney-rivlin", "c1": 1.0, "c2": 0.0, "d1": 9.0}, False),
    ],
)
def test_the_form_follows_from_the_ratio_of_moduli(load: Loader, material: dict[str, Any], mixed: bool) -> None:
    job = load(lambda j: j.update(material=material))
    assert job.is_mixed is mixed
    assert job.pressure_degree == (1 if mixed else None)


def test_the_form_that_a_job_states_is_taken(load: Loader) -> None:
    assert not load(lambda j: j.update(discretisation={"formulation": "displacement"})).is_mixed
    job = load(lambda j: j.update(discretisation={"displacement": 3, "pressure": 1}))
    assert job.pressure_degree == 1


FAULTS_BETWEEN_SECTIONS: dict[str, dict[str, Any]] = {
    "none": {},
    "a name without definition": {"let": {}},
    "a law that locks": {"discretisation": {"formulation": "displacement"}},
    "an unknown load case": {"supports": [{"region": "a", "displacement": ["1 mm", 0, 0], "case": "b"}]},
    "an unknown key": {"sensitivities": ["material.mu"]},
    "an unknown quantity": {"accuracy": {"top": "1 mm"}},
    "an unsuitable method": {"accuracy": {"tip": "1 mm"}, "method": "sellier"},
    "effects and states": {"states": [{"name": "flat", "given": True, "supports": [{"region": "a", "fix": ["x"]}]}]},
}  # fmt: skip


@pytest.mark.parametrize("changes", FAULTS_BETWEEN_SECTIONS.values(), ids=FAULTS_BETWEEN_SECTIONS)
def test_the_order_of_fields_changes_nothing(load: Loader, tmp_path: Path, changes: dict[str, Any]) -> None:
    class Reversed(Job):
        """A job whose fields are validated from the last to the first."""

    Reversed.__pydantic_fields__ = dict(reversed(Job.model_fields.items()))
    Reversed.model_rebuild(force=True)
    beam = yaml.safe_load(BEAM) | {
        "let": {"depth": "max(0, -y)"},
        "material": {"law": "mooney-rivlin", "c1": "(1 + depth/(1 m))*1 kPa", "c2": 1, "d1": "incompressible"},
        "quantities": [{"name": "tip", "of": "displacement", "at": [0, 0, 0]}],
        "sensitivities": {"effects[0].density": "10 kg/m^3"},
    }  # fmt: skip

    def outcome(kind: type[Job]) -> Any:
        try:
            context = {"directory": tmp_path / "jobs", "untrusted": False}
            return kind.model_validate(beam | changes, context=context).model_dump(mode="json")
        except ValidationError as error:
            return sorted(str(place) + text for place, text in problems_in(error))

    assert next(iter(Reversed.model_fields)) == list(Job.model_fields)[-1]
    assert outcome(Reversed) == outcome(Job)
    assert isinstance(outcome(Job), dict) == (not changes), outcome(Job)


def test_no_validator_reads_the_fields_before_its_own() -> None:
    sources = Path(hpcinv.__file__).parent.rglob("*.py")
    assert not [str(path) for path in sources if "info.data" in path.read_text(encoding="utf-8")]


def test_an_effect_is_refused_in_a_direction_that_it_cannot_serve(
    load: Loader, problems: Callable[[Edit], list[str]]
) -> None:
    class OnlyForward(Effect):
        """Complete, since other tests of this process find it in the registry."""

        example: ClassVar[dict[str, Any]] = {"effect": "only-forward"}
        directions: ClassVar[frozenset[Direction]] = frozenset({"forward"})
        effect: Literal["only-forward"] = "only-forward"

        def virtual_work(self, k: Any, v: Any, load: Any, par: Any) -> Any: ...

    def edit(analysis: str) -> Edit:
        return lambda job: job.update(analysis=analysis, effects=[{"effect": "only-forward"}])

    assert isinstance(load(edit("forward")).effects[0], OnlyForward)
    for analysis in ("inverse", "round_trip"):
        assert problems(edit(analysis)) == [
            f"effects[0]: is not possible with 'analysis: {analysis}', only with forward"
        ]


def test_a_unit_of_a_ready_made_mesh_is_a_length(load: Loader) -> None:
    for unit, metres in {"mm": 1e-3, "25.4 mm": 0.0254, "in": 0.0254, "µm": 1e-6}.items():
        job = load(lambda j, unit=unit: j.update(mesh={"file": "../meshes/beam.msh", "unit": unit}))
        assert job.mesh.unit == metres


def test_a_checkpoint_can_be_turned_off(load: Loader) -> None:
    assert load(lambda j: j.update(checkpoint={"every": False})).checkpoint.every == 0


JOBS = sorted((Path(__file__).parents[2] / "jobs").rglob("*.yaml"))


@pytest.mark.parametrize("path", JOBS, ids=lambda p: p.name)
def test_the_jobs_studies_and_sweeps_that_come_with_the_project_are_valid_and_say_what_they_show(
    path: Path, tmp_path: Path
) -> None:
    if is_study(path):
        assert load_study(path).runs
    elif is_sweep(path):
        assert load_sweep(with_few_draws(path, tmp_path)).cases
    else:
        assert hpcinv.load(path).path == path
    assert path.read_text().startswith("# ")


ROOMS: dict[str, Callable[[Job], object]] = {
    "shell": lambda job: job.mesh.shell,
    "CAD file": lambda job: "cad" in job.data["mesh"],
    "image": lambda job: "image" in job.data["mesh"],
    "vessel": lambda job: "lumen" in job.data["mesh"],
    "cavity": lambda job: job.cavities,
    "states": lambda job: job.states,
    "remote load": lambda job: any(support.remote for support in job.supports),
    "sliding": lambda job: any(support.surface for support in job.supports),
    "hidden forces": lambda job: job.identify is not None and "strength: evidence" in str(yaml.safe_dump(job.data)),
}


@pytest.mark.release
def test_each_room_has_a_job_that_comes_with_the_project() -> None:
    jobs = [hpcinv.load(path) for path in JOBS if not is_study(path) and not is_sweep(path)]
    assert not [room for room, has_it in ROOMS.items() if not any(map(has_it, jobs))]


def with_few_draws(path: Path, directory: Path) -> Path:
    """A sweep with at most 50 draws of each axis: ten thousand are as valid, and take ten seconds."""
    content = copy.deepcopy(read_yaml(path))
    content["job"] = str(path.parent / content["job"])
    for axis in content["axes"]:
        if "count" in axis:
            axis["count"] = min(axis["count"], 50)
    few = directory / path.name
    few.write_text(yaml.safe_dump(content, sort_keys=False))
    return few


# Levels of the certificate


@pytest.mark.parametrize(
    ("given", "switches"),
    [
        ("quick", ("off", False, False, True)),
        ({"level": "quick", "stability": True}, ("off", True, False, True)),
        ("standard", ("near", True, True, True)),
        ({"estimate": False}, ("near", True, False, True)),
        ("full", ("path", True, True, True)),
        ("off", ("off", False, False, False)),
    ],
)
def test_levels_of_the_certificate(load: Loader, given: Any, switches: tuple[Any, ...]) -> None:
    settings_read = load(lambda j: j.update(certificate=given)).certificate
    assert (
        settings_read.round_trip,
        settings_read.stability,
        settings_read.estimate,
        settings_read.overlap,
    ) == switches


def test_a_misspelt_level_of_the_certificate(problems: Callable[[Edit], list[str]]) -> None:
    [text] = problems(lambda j: j.update(certificate="quik"))
    assert text.startswith("certificate.level: must be 'off', 'quick', 'standard' or 'full', not 'quik'")


# JSON Schema


def test_the_json_schema_describes_every_key_of_a_job() -> None:
    schema = json_schema()
    assert json.loads(json.dumps(schema)) == schema
    assert set(schema["properties"]) == set(Job.model_fields)
    assert "image" in schema["$defs"]["MeshSpec"]["properties"]
    assert schema["required"] == ["mesh", "material"]
    assert all("description" in p for p in schema["properties"].values())
    assert {"enum": ["off", "quick", "standard", "full"]} in schema["$defs"]["CertificateSettings"]["anyOf"]
    known = {choice["properties"]["law"]["const"]: choice for choice in schema["properties"]["material"]["oneOf"][:-1]}
    assert schema["properties"]["material"]["oneOf"][-1]["additionalProperties"]["oneOf"] == [*known.values()]
    assert known["guccione"]["required"] == ["law", "kappa", "c", "b_f", "b_t", "b_fs"]
    assert known["mooney-rivlin"]["required"] == ["law", "c2"]  # two moduli may stand for the others
    assert {"young", "poisson", "mu", "lam"} <= set(known["neo-hookean"]["properties"])


def test_infinite_moduli_do_not_leak_into_json(load: Loader) -> None:
    job = load(lambda j: j["material"].update(d1="incompressible"))
    assert math.isinf(job.material.bulk_modulus(job.material))
    assert json.loads(job.model_dump_json())["material"]["d1"] == "incompressible"
