"""From a job file to a typed job, or to everything that is wrong with it."""

from __future__ import annotations

import copy
import functools
import json
import math
import pickle
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar, Literal

import pytest
import yaml
from pydantic import ValidationError

import hpcinv
from hpcinv.effects.effect import Direction, Effect
from hpcinv.errors import JobError
from hpcinv.job.fingerprint import difference, fingerprint
from hpcinv.job.job import Job, json_schema, parse
from hpcinv.job.kind_of_file import is_study, is_sweep
from hpcinv.job.resolved_job import file_digest
from hpcinv.job.yaml_reader import read_yaml
from hpcinv.materials import laws
from hpcinv.quantity.schema import problems_in
from hpcinv.study.study_plan import load_study
from hpcinv.sweep.sweep_plan import load_sweep

GENERATOR = """
from hpcinv.quantity import Length
def build(gmsh, *, length: Length = 0.182, size: Length = 2e-3) -> None: ...
"""
BEAM = """
mesh: {file: ../meshes/beam.py, parameters: {size: 2 mm}, geometry_degree: 2}
material: {law: mooney-rivlin, c1: 101709.668 Pa, c2: 151065.460 Pa, d1: 7.965272689e8 Pa}
effects:
  - {effect: gravity, acceleration: [0, -9.81, 0], density: 963 kg/m^3, density_in: current}
supports:
  - {region: clamp, fix: [x, y, z]}
"""

JARGON = re.compile(r"pydantic|Input should|validat|function-|tagged|\[key\]|NoneType|dict|tuple")

type Edit = Callable[[dict[str, Any]], object]
type Loader = Callable[..., Job]


@pytest.fixture
def load(tmp_path: Path) -> Loader:
    """Loads the beam's job after an edit of its contents."""
    (tmp_path / "meshes").mkdir()
    (tmp_path / "jobs").mkdir()
    (tmp_path / "meshes" / "beam.py").write_text(GENERATOR)
    (tmp_path / "meshes" / "beam.geo").write_text("DefineConstant [ size = {0.002} ];")
    (tmp_path / "meshes" / "beam.msh").write_text("$MeshFormat\n")

    def load(edit: Edit = lambda job: None, name: str = "arm.yaml") -> Job:
        contents = yaml.safe_load(BEAM)
        edit(contents)
        path = tmp_path / "jobs" / name
        path.write_text(json.dumps(contents))  # JSON is YAML 1.2
        return hpcinv.load(path)

    return load


@pytest.fixture
def problems(load: Loader) -> Callable[[Edit], list[str]]:
    """The errors of the beam's job after an edit, without the name of the file that each must begin with."""

    def problems(edit: Edit) -> list[str]:
        with pytest.raises(JobError) as caught:
            load(edit)
        prefix = re.compile(r".*/jobs/arm\.yaml: ")
        assert all(prefix.match(p) for p in caught.value.problems)
        return [prefix.sub("", p, count=1) for p in caught.value.problems]

    return problems


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


CASES: list[tuple[dict[str, Any], str]] = [
    ({"analysis": "invers"}, "analysis: must be 'inverse', 'forward' or 'round_trip', not 'invers'. Did you mean"),
    ({"first": "forward"}, "first: is valid only with 'analysis: round_trip'"),
    ({"job": "my arm"}, "job: 'my arm' is not allowed: up to 100 letters, digits, dots"),
    ({"otput": {}}, "otput: unknown key. Did you mean 'output'?"),
    ({"mesh": None}, "mesh: must be a mapping of keys to values, not nothing"),
    ({"mesh": {}}, "mesh.file: is needed: path from the job file"),
    ({"mesh": {"file": "../meshes/baem.py"}}, "mesh.file: there is no file"),
    ({"mesh": {"file": "../meshes/baem.py"}}, "Did you mean 'beam.py'?"),
    ({"mesh": {"file": "../meshes/beam.sldprt"}}, "mesh.file: '../meshes/beam.sldprt' is not a readable mesh"),
    ({"mesh": {"file": "../meshes/beam.py", "parameters": {"sise": 1}}}, "mesh.parameters.sise: beam.py has no such"),
    ({"mesh": {"file": "../meshes/beam.py", "parameters": {"size": "1 kg"}}}, "mesh.parameters.size: must be a length"),
    (
        {"mesh": {"file": "../meshes/beam.geo", "unit": "mm", "parameters": {"size": 1}}},
        "mesh.unit: is not valid with parameters of a .geo script",
    ),
    ({"mesh": {"file": "../meshes/beam.msh", "unit": "kg"}}, "mesh.unit: must be a length"),
    ({"mesh": {"file": "../meshes/beam.msh", "parameters": {"a": 1}}}, "mesh.parameters: only generators have"),
    ({"mesh": {"file": "../meshes/beam.msh", "geometry_degree": 3}}, "mesh.geometry_degree: must be 1 or 2, not 3"),
    ({"regions": {"a b": "x < 1"}}, "regions.a b: 'a b' is not a name: use letters"),
    ({"regions": {"boundary": "x < 1"}}, "regions.boundary: is already the name"),
    ({"regions": {"a": "x"}}, "regions.a: must be a condition, such as x < 1 mm, but 'x' is a length"),
    ({"regions": {"a": "x < 1 kg"}}, "regions.a: 'x < 1 kg' adds or compares a length and a mass"),
    ({"regions": {"a": "r < 1"}}, "regions.a: unknown name 'r'"),
    ({"regions": {"a": True}}, "regions.a: must be a formula or a number"),
    ({"material": {"law": "neohookean"}}, "material.law: unknown law 'neohookean'. Did you mean 'neo-hookean'?"),
    ({"material": {}}, f"material.law: is needed. Known: {', '.join(laws())}."),
    ({"material": {"law": ["neo-hookean"]}}, "material.law: unknown law ['neo-hookean']"),
    ({"material": "steel"}, "material: must be a mapping with the key 'law', not 'steel'"),
    ({"material": {"law": "neo-hookean", "mu": 1}}, "material.lam: is needed: Lamé's first parameter"),
    (
        {"material": {"law": "neo-hookean", "mu": 1, "young": 1, "poisson": 0.3}},
        "material.young: give any two moduli, not 3: young, poisson, mu",
    ),
    (
        {"material": {"law": "neo-hookean", "young": 1}},
        "material.young: needs a second modulus: one of poisson",
    ),
    (
        {"material": {"law": "neo-hookean", "young": 1, "poisson": 0.6}},
        "material.poisson: must be above -1 and at most",
    ),
    ({"material": {"law": "neo-hookean", "mu": -1, "lam": 9}}, "material: the shear modulus that follows from these"),
    ({"material": {"law": "neo-hookean", "mu": 3, "lam": -2}}, "material: the bulk modulus that follows from these"),
    ({"effects": [{"effect": "gravty"}]}, "effects[0].effect: unknown effect 'gravty'. Did you mean 'gravity'?"),
    ({"effects": {}}, "effects: must be a list"),
    ({"supports": []}, "supports: leave the body free to move along x and y and z"),
    ({"supports": [{"region": "a", "fix": ["x", "y"]}]}, "supports: leave the body free to move along z"),
    ({"supports": [{"region": "a", "fix": ["q"]}]}, "supports[0].fix[0]: must be 'x', 'y', 'z' or 'normal', not 'q'"),
    ({"supports": [{"region": "a"}]}, "supports[0]: needs exactly one of 'fix'"),
    (
        {"supports": [{"region": "a", "fix": ["x"], "surface": "x"}]},
        "supports[0].surface: is valid with 'fix: [normal]' only",
    ),
    (
        {"supports": [{"region": "a", "fix": ["normal"], "surface": "x", "normal": [1, 0, 0]}]},
        "supports[0].surface: has its own normals: leave 'normal' out",
    ),
    (
        {"supports": [{"region": "a", "fix": ["normal"], "surface": "x - R"}]},
        "supports[0].surface: unknown name 'R' in 'x - R'",
    ),
    (
        {"supports": [{"region": "a", "fix": ["normal"], "surface": "pi"}]},
        "supports[0].surface: 'pi' does not depend on x, y or z",
    ),
    (
        {"supports": [{"region": "a", "fix": ["normal"], "surface": "x < 1"}]},
        "supports[0].surface: must be a number, but 'x < 1' is a condition",
    ),
    (
        {"supports": [{"region": "a", "fix": ["normal"], "surface": "sphere", "constants": {"R": 1}}]},
        "supports[0].constants: are not valid without a formula",
    ),
    ({"supports": [{"region": "a", "fix": ["x"], "displacement": [0, 0, 0]}]}, "supports[0]: needs exactly one of"),
    ({"supports": [{"region": "a", "displacement": [0, 0]}]}, "supports[0].displacement[2]: is needed"),
    ({"supports": [{"region": "a", "displacement": [None] * 3}]}, "supports[0]: prescribes no component"),
    ({"supports": [{"region": "a", "displacement": ["k*y", 0, 0]}]}, "supports[0].displacement[0]: unknown name 'k'"),
    ({"supports": [{"region": "a", "displacement": ["x < 1", 0, 0]}]}, "must be a length, but 'x < 1' is a condition"),
    ({"supports": [{"region": "a", "displacement": ["x*y", 0, 0]}]}, "must be a length, but 'x*y' is an area"),
    (
        {"supports": [{"region": "a", "displacement": [0, 0, 0], "constants": {"x": 1}}]},
        "supports[0].constants.x: is already the name of something else",
    ),
    ({"supports": [{"region": "a", "fix": ["x"], "constants": {"k": 1}}]}, "supports[0].constants: are not valid"),
    ({"supports": [{"region": "a", "fix": ["x", "y", "z"]}] * 2}, "supports[1]: prescribes x on 'a' a second time"),
    ({"discretisation": {"displacement": 5}}, "discretisation.displacement: must be at most 4, not 5"),
    ({"discretisation": {"pressure": 2}}, "discretisation.pressure: must be below the displacement's degree 2"),
    ({"discretisation": {"displacement": 1}}, "discretisation.displacement: must be 2 or more: the material is nearly"),
    ({"discretisation": {"formulation": "mixed", "displacement": 1}}, "discretisation.displacement: must be 2 or more"),
    ({"discretisation": {"formulation": "displacement", "pressure": 1}}, "discretisation.pressure: is not valid"),
    ({"solver": {"steps": 4}}, "solver.steps: is not valid with 'strategy: adaptive'; remove it, or choose"),
    (
        {"solver": {"strategy": "fixed", "initial_step": 0.1}},
        "solver.initial_step: is not valid with 'strategy: fixed'",
    ),
    ({"solver": {"branch": "positive"}}, "solver.branch: is not valid without 'continuation: series'"),
    ({"solver": {"initial_step": 1e-4}}, "solver.minimum_step: must not exceed initial_step, which is 0.0001"),
    ({"solver": {"tolerance": "1e-8"}}, "solver.tolerance: must be a number, not '1e-8'"),
    ({"solver": {"maximum_iterations": True}}, "solver.maximum_iterations: must be a whole number, not True"),
    ({"solver": {"reuse_tangent": 1}}, "solver.reuse_tangent: must be true or false, not 1"),
    ({"solver": {"nested_iteration": "yes"}}, "solver.nested_iteration: must be 'auto', 'on' or 'off', not 'yes'"),
    (
        {"solver": {"nested_iteration": "on", "strategy": "fixed"}},
        "solver.nested_iteration: needs 'strategy: adaptive'",
    ),
    ({"solver": {"nested_iteration": "on"}, "method": "aitken"}, "solver.nested_iteration: needs 'method: direct'"),
    ({"solver": {"petsc": {"-ksp_type": "cg"}}}, "solver.petsc.-ksp_type: is written without the dash: ksp_type"),
    ({"solver": {"petsc": {"a": [1]}}}, "solver.petsc.a: must be text, a number, true, false or nothing"),
    ({"checkpoint": {"every": -1}}, "checkpoint.every: must be at least 0, not -1"),
    (
        {"output": {"mesh": ["stl"]}},
        "output.mesh[0]: must be 'bdf', 'bp', 'cdb', 'e', 'ex2', 'exo', 'feb', 'fem', 'g', 'inp', 'med', 'mesh', 'msh',"
        " 'nas', 'unv', 'vtk' or 'vtu', not 'stl'",
    ),
    ({"quantities": [{"name": "a", "of": "x"}]}, "quantities[0]: needs exactly one of 'at'"),
    ({"quantities": [{"name": "a", "of": "x", "on": "side"}]}, "quantities[0].reduce: is needed on a region"),
    (
        {"quantities": [{"name": "a", "of": "x", "at": [0, 0, 0], "reduce": "max"}]},
        "quantities[0].reduce: is not valid",
    ),
    (
        {"quantities": [{"name": "a", "of": "displacement", "on": "s", "reduce": "max"}]},
        "quantities[0].of: is a vector",
    ),
    ({"quantities": [{"name": "a", "of": "reaction"}]}, "quantities[0].on: is needed for a reaction"),
    (
        {"quantities": [{"name": "a", "of": "reaction", "on": "s", "reduce": "max"}]},
        "quantities[0].reduce: is not valid",
    ),
    (
        {"quantities": [{"name": "a", "of": "reaction", "on": "clam"}]},
        "quantities[0].on: 'clam' is not the region of a support: those with supports are clamp",
    ),
    (
        {"quantities": [{"name": "a", "of": "reaction", "on": "clamp", "about": [0, 0, 0]}]},
        "quantities[0].about: is valid only with 'of: reaction_moment'",
    ),
    (
        {"quantities": [{"name": "a", "of": "x", "at": [0, 0, 0], "about": [0, 0, 0]}]},
        "quantities[0].about: is valid only with 'of: reaction_moment'",
    ),
    (
        {"quantities": [{"name": "a", "of": "reaction", "on": "clamp"}], "accuracy": {"a": "1 N"}},
        "accuracy.a: is a reaction, which has no error estimate",
    ),
    ({"quantities": [{"name": "a", "of": "x < 1", "at": [0, 0, 0]}]}, "quantities[0].of: must be a number, but"),
    ({"quantities": [{"name": "a", "of": "x + w", "at": [0, 0, 0]}]}, "quantities[0].of: unknown name 'w'"),
    ({"quantities": [{"name": "a", "of": "x", "at": [0, 0, 0]}] * 2}, "quantities[1].name: 'a' is the name of an"),
    ({"expected_shape": {"file": "../meshes/none.py"}}, "expected_shape.file: there is no file"),
    ({"mesh": {"file": "else/where.msh"}}, "where.msh'. Paths start from the directory of the job file"),
    ({"mesh": {"image": "no.nii", "labels": {"a": 1}, "size": 0.1}}, "mesh.image: there is no file"),
    ({"mesh": {"surface": "no.stl", "unit": "mm", "size": 0.1}}, "mesh.surface: there is no file"),
    ({"mesh": {"cad": 3, "size": 0.1}}, "mesh.cad: must be text, not 3"),
    ({"mesh": {"lumen": "no.vtp", "unit": "mm", "size": 0.1, "wall": 0.1}}, "mesh.lumen: there is no file"),
    ({"expected_shape": {"image": "no.nii"}}, "expected_shape.image: there is no file"),
]


@pytest.mark.parametrize(("change", "message"), CASES, ids=[message[:60] for _, message in CASES])
def test_each_mistake_is_reported_by_its_place(
    problems: Callable[[Edit], list[str]], change: dict[str, Any], message: str
) -> None:
    faults = problems(lambda job: job.update(change))
    assert [p for p in faults if message in p], faults
    for problem in faults:
        assert not JARGON.search(problem)


def test_nested_iteration_needs_a_generator_and_no_search(problems: Callable[[Edit], list[str]]) -> None:
    def with_file(job: dict[str, Any]) -> None:
        job["mesh"] = {"file": "../meshes/beam.msh"}
        job["solver"] = {"nested_iteration": "on"}

    def with_search(job: dict[str, Any]) -> None:
        job["quantities"] = [{"name": "tip", "of": "uy", "at": [0, 0, 0]}]
        job["accuracy"] = {"tip": "1 mm"}
        job["solver"] = {"nested_iteration": "on"}

    def with_contact(job: dict[str, Any]) -> None:
        floor = {"shape": "plane", "point": [0, 0, 0], "normal": [0, 1, 0]}
        job["analysis"] = "forward"
        job["effects"] = [{"effect": "contact", "region": "clamp", "obstacle": floor}]
        job["solver"] = {"nested_iteration": "on"}

    assert any("solver.nested_iteration: needs a mesh that a generator makes" in p for p in problems(with_file))
    assert any("solver.nested_iteration: cannot be combined with 'accuracy'" in p for p in problems(with_search))
    assert any("solver.nested_iteration: is not possible with a contact" in p for p in problems(with_contact))


@pytest.mark.parametrize("key", ["mesh", "material"])
def test_missing_keys_are_reported_with_their_meaning(problems: Callable[[Edit], list[str]], key: str) -> None:
    [problem] = problems(lambda job: job.pop(key))
    assert re.fullmatch(f"{key}: is needed: .{{20,}}", problem)


JUNK = (None, True, 3, "x", "1 mm", [], [1], [[]], {}, {"a": 1}, {"law": []}, {"effect": {}}, math.nan, 10**400)


def places(data: Any, where: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    for key, value in data.items() if isinstance(data, dict) else enumerate(data if isinstance(data, list) else ()):
        yield (*where, key)
        yield from places(value, (*where, key))


@pytest.mark.parametrize("junk", JUNK, ids=repr)
def test_junk_anywhere_ends_in_a_job_or_in_plain_words(load: Loader, tmp_path: Path, junk: object) -> None:
    load()
    full = yaml.safe_load(BEAM) | {
        "regions": {"a": "x < 1"},
        "solver": {"petsc": {"a": 1}},
        "output": {"mesh": ["msh"]},
    }
    for where in places(full):
        contents = copy.deepcopy(full)
        functools.reduce(lambda part, key: part[key], where[:-1], contents)[where[-1]] = junk
        faults: tuple[str, ...] = ()
        try:
            parse(contents, tmp_path / "jobs" / "arm.yaml")
        except JobError as error:
            faults = error.problems
        assert not [problem for problem in faults if JARGON.search(problem)]


def test_all_mistakes_are_reported_at_once(problems: Callable[[Edit], list[str]]) -> None:
    def edit(job: dict[str, Any]) -> None:
        job["analysis"] = "backward"
        job["mesh"]["parameters"] = {"size": "1 s", "sizes": 1}
        job["material"].update(c1="3 mm", c3=1)
        job["effects"][0].update(density="963 g", acceleration=[0, 1])
        job["supports"] = [{"region": "a", "fix": ["w"]}]
        job["solver"] = {"steps": 3}

    places = [p.split(":")[0] for p in problems(edit)]
    assert places == [
        *("analysis", "mesh.parameters.size", "mesh.parameters.sizes", "material.c1", "material.c3"),
        *("effects[0].acceleration[2]", "effects[0].density", "supports[0].fix[0]", "solver.steps"),
    ]


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


# fingerprints


def test_the_fingerprint_ignores_how_the_same_physics_is_written_and_solved(load: Loader, tmp_path: Path) -> None:
    def edit(job: dict[str, Any]) -> None:
        job["material"]["c1"] = "101.709668 kPa"
        job["mesh"].update(partition="scotch", file="../meshes/moved.py")
        job["discretisation"] = {"formulation": "mixed", "pressure": 1}
        job["solver"] = {"strategy": "fixed"}
        job["output"] = {"fields": False}

    (tmp_path / "meshes" / "moved.py").write_text(GENERATOR)
    assert difference(fingerprint(load()), fingerprint(load(edit))) == []


def test_the_fingerprint_is_json_and_differs_for_other_physics(load: Loader) -> None:
    def edit(job: dict[str, Any]) -> None:
        job["material"].update(c1=99999, d1="incompressible")
        job["effects"][0]["density_in"] = "reference"
        job["supports"].append({"region": "tip", "fix": ["x"]})

    old, new = fingerprint(load()), fingerprint(load(edit))
    assert difference(json.loads(json.dumps(old)), new) == [
        "material.c1: 101709.668 -> 99999.0",
        "material.d1: 796527268.9 -> incompressible",
        "effects[0].density_in: current -> reference",
        "supports[1].region: absent -> tip",
        "supports[1].fix[0]: absent -> x",
    ]


def test_the_fingerprint_follows_the_contents_of_the_mesh_file(load: Loader, tmp_path: Path) -> None:
    old = fingerprint(load())
    (tmp_path / "meshes" / "beam.py").write_text(GENERATOR + "\n# changed\n")
    [line] = difference(old, fingerprint(load()))
    assert line.startswith("mesh.file: ")


def test_the_fingerprint_of_an_xdmf_mesh_covers_its_hdf5_file(load: Loader, tmp_path: Path) -> None:
    (tmp_path / "meshes" / "m.xdmf").write_text('<DataItem Format="HDF">m.h5:/Mesh/topology</DataItem>')
    (tmp_path / "meshes" / "m.h5").write_bytes(b"one")
    old = fingerprint(load(lambda j: j.update(mesh={"file": "../meshes/m.xdmf"})))
    (tmp_path / "meshes" / "m.h5").write_bytes(b"two")
    assert old != fingerprint(load(lambda j: j.update(mesh={"file": "../meshes/m.xdmf"})))


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


def test_long_lists_are_refused_before_anything_in_them_is_checked(problems: Callable[[Edit], list[str]]) -> None:
    assert problems(lambda j: j.update(quantities=[{}] * 10_001)) == [
        "quantities: has 10,001 entries, but may have 10,000"
    ]


def test_the_first_of_many_problems_are_reported_and_the_others_counted(problems: Callable[[Edit], list[str]]) -> None:
    faults = problems(lambda j: j.update({f"unknown{i}": 1 for i in range(9000)}))
    assert len(faults) == 51
    assert faults[0].startswith("unknown0: unknown key")
    assert faults[-1] == "and 8,950 more problems like these"


@pytest.mark.parametrize(
    ("header", "voxels"),
    [
        ("a.mhd: ElementDataFile = a.raw", "a.raw"),
        ("a.mhd: ElementDataFile = LIST\na1.raw\na2.raw", "a2.raw"),
        ("a.mhd: ElementDataFile = a%02d.raw 1 9 1", "a07.raw"),
        ("a.nrrd: data file: a.bin", "a.bin"),
        ("a.nrrd: datafile: LIST\na.bin\nb.bin", "b.bin"),
    ],
)
def test_the_identity_of_an_image_has_the_files_of_its_voxels(header: str, voxels: str, tmp_path: Path) -> None:
    name, _, text = header.partition(": ")
    (tmp_path / name).write_text(f"NDims = 3\n{text}\n")
    digests = set()
    for content in ("yesterday", "today"):
        (tmp_path / voxels).write_text(content)
        digests.add(file_digest(tmp_path / name))
    assert len(digests) == 2
