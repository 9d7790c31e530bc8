"""Mistakes in a job are reported by place and meaning, all at once."""

from __future__ import annotations

import copy
import functools
import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from helpers.job_cases import BEAM, Edit, Loader

from hpcinv.errors import JobError
from hpcinv.job.job import parse

JARGON = re.compile(r"pydantic|Input should|validat|function-|tagged|\[key\]|NoneType|dict|tuple")


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
    ({"material": {}}, "material.law: is needed. Known: arruda-boyce, "),  # plugins of earlier tests may follow
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


def test_long_lists_are_refused_before_anything_in_them_is_checked(problems: Callable[[Edit], list[str]]) -> None:
    assert problems(lambda j: j.update(quantities=[{}] * 10_001)) == [
        "quantities: has 10,001 entries, but may have 10,000"
    ]


def test_the_first_of_many_problems_are_reported_and_the_others_counted(problems: Callable[[Edit], list[str]]) -> None:
    faults = problems(lambda j: j.update({f"unknown{i}": 1 for i in range(9000)}))
    assert len(faults) == 51
    assert faults[0].startswith("unknown0: unknown key")
    assert faults[-1] == "and 8,950 more problems like these"
