"""What a job may say of each law, and the message if a law cannot be so."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.docstrings import meanings
from hpcinv.base.quantity.parameter_paths import Number
from hpcinv.base.quantity.quantity import quantities_of
from hpcinv.base.quantity.schema import dotted_key
from hpcinv.base.quantity.units import parse_unit
from hpcinv.errors import JobError
from hpcinv.job.job import Job, parse
from hpcinv.physics.materials import laws
from hpcinv.solver.workspace import Workspace
from hpcinv.studies.serving.job_model import JobModel

HERE = Path(__file__).parents[1] / "job.yaml"
JARGON = re.compile(r"pydantic|Input should|validat|NoneType|dict|tuple|Annotated")
LAWS = laws()
STRESS = parse_unit("Pa")[1]
MUST_BE_POSITIVE = {
    "st-venant-kirchhoff": ["mu"],
    "isochoric-neo-hookean": ["mu", "kappa"],
    "yeoh": ["c1", "kappa"],
    "gent": ["mu", "jm", "kappa"],
    "arruda-boyce": ["mu", "lambda_m", "kappa"],
    "fung-demiray": ["mu", "b", "kappa"],
    "veronda-westmann": ["c1", "c2", "kappa"],
    "ogden": ["kappa"],
    "holzapfel-gasser-ogden": ["mu", "k1", "k2", "kappa"],
    "holzapfel-ogden": ["a", "b", "b_f", "b_s", "b_fs", "kappa"],
    "guccione": ["c", "b_f", "b_t", "b_fs", "kappa"],
    "transversely-isotropic": ["mu", "k", "kappa"],
    "usyk-mcculloch": ["c", "b_f", "b_s", "b_n", "b_fs", "b_fn", "b_sn", "kappa"],
}


def job(material: dict[str, Any], fibres: list[str] | None = None) -> Job:
    """A job with this material and families of fibres; left out, those that the law refers to."""
    if fibres is None:
        fibres = list(LAWS[material["law"]].model_validate(material).families)
    return parse(
        {
            "mesh": {"file": "../meshes/box.py"},
            "fibres": {f: {"direction": [1, 0, 0], "given_on": "reference"} for f in fibres},
            "material": material,
            "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
        },
        HERE,
    )


def problems(material: dict[str, Any], fibres: list[str]) -> list[str]:
    with pytest.raises(JobError) as caught:
        job(material, fibres)
    assert not any(JARGON.search(p) for p in caught.value.problems)
    return [p.removeprefix(f"{HERE}: ") for p in caught.value.problems]


def families(law: str) -> list[str]:
    return list(LAWS[law].model_validate(LAWS[law].example).families)


def required() -> list[tuple[str, str]]:
    return [(law, name) for law, kind in LAWS.items() for name, f in kind.model_fields.items() if f.is_required()]


@pytest.mark.parametrize("law", LAWS)
def test_an_example_is_a_material_and_can_change_its_volume(law: str) -> None:
    case_job = job(LAWS[law].example)
    assert case_job.material == LAWS[law].model_validate(LAWS[law].example)
    assert not case_job.laws["material"].is_incompressible


@pytest.mark.parametrize("law", LAWS)
def test_every_field_of_a_law_says_what_it_means(law: str) -> None:
    fields = {name: f for name, f in LAWS[law].model_fields.items() if name != "law"}
    assert sorted(fields.keys() - meanings(LAWS[law]).keys()) == []


@pytest.mark.parametrize(("law", "name"), required())
def test_a_missing_parameter_is_named_with_its_meaning(law: str, name: str) -> None:
    given = {key: value for key, value in LAWS[law].example.items() if key != name}
    meaning = meanings(LAWS[law])[name]
    assert f"material.{name}: is needed: {meaning}" in problems(given, families(law))


@pytest.mark.parametrize("law", LAWS)
def test_stresses_that_are_all_negative_are_refused(law: str) -> None:
    valid = LAWS[law].model_validate(LAWS[law].example)
    stresses = {n: getattr(valid, n) for n, d in quantities_of(LAWS[law]).items() if d == STRESS}
    negative = {n: [-v for v in value] if isinstance(value, tuple) else -value for n, value in stresses.items()}
    names = "|".join(stresses)
    for problem in problems({**LAWS[law].example, **negative}, families(law)):
        assert re.match(rf"material(\.({names}): must be (above|at least) 0|: the (shear|bulk) modulus)", problem)


@pytest.mark.parametrize(("law", "name"), [(law, name) for law, names in MUST_BE_POSITIVE.items() for name in names])
def test_a_parameter_that_must_be_positive_is_refused_otherwise(law: str, name: str) -> None:
    for value in (-1, 0):
        (problem,) = problems({**LAWS[law].example, name: value}, families(law))
        assert problem == f"material.{name}: must be above {1 if name == 'lambda_m' else 0}, not {value}"


@pytest.mark.parametrize(
    ("law", "change", "expected"),
    [
        ("arruda-boyce", {"lambda_m": 1}, "material.lambda_m: must be above 1, not 1"),
        ("st-venant-kirchhoff", {"lam": "incompressible"}, "material.lam: must be finite; an incompressible"),
        ("st-venant-kirchhoff", {"lam": "-7 kPa"}, "material: the bulk modulus that follows from these parameters"),
        ("yeoh", {"c2": "incompressible"}, "material.c2: 'incompressible' is not a number"),
        ("gent", {"jm": "3 Pa"}, "material.jm: must be a pure number, but '3 Pa' is a stress"),
        ("gent", {"volumetric": "cubic"}, "material.volumetric: must be 'quadratic', 'logarithmic'"),
        ("ogden", {"alpha": [2, 3]}, "material.alpha: must have as many entries as mu, 3, not 2"),
        ("ogden", {"mu": ["1 kPa"]}, "material.alpha: must have as many entries as mu, 1, not 3"),
        ("ogden", {"alpha": [2, 0, 3]}, "material.alpha[1]: must not be 0"),
        ("ogden", {"alpha": []}, "material.alpha: must have at least one entry"),
        ("ogden", {"mu": "1 kPa"}, "material.mu: must be a list, not '1 kPa'"),
        ("ogden", {"mu": ["1 kPa", "2 mm", 3]}, "material.mu[1]: must be a stress"),
        ("ogden", {"mu": [1, 1, 1], "alpha": [2, 1, -3]}, "material: the shear modulus that follows"),
        ("holzapfel-gasser-ogden", {"dispersion": -0.01}, "material.dispersion: must be at least 0 and at most 0.33"),
        ("holzapfel-gasser-ogden", {"dispersion": 0.34}, "material.dispersion: must be at least 0 and at most 0.33"),
        ("holzapfel-gasser-ogden", {"fibres": []}, "material.fibres: must name at least one family of fibres"),
        ("holzapfel-gasser-ogden", {"fibres": ["fibre1", "fibre1"]}, "material.fibres[1]: 'fibre1' is duplicated"),
        ("holzapfel-ogden", {"sheet": "fibre"}, "material.sheet: must be another family than fibre"),
        ("usyk-mcculloch", {"sheet": "fibre"}, "material.sheet: must be another family than fibre"),
        ("holzapfel-ogden", {"a_s": -1}, "material.a_s: must be at least 0"),
    ],
)
def test_invalid_law_parameters_are_refused_at_their_key(law: str, change: dict[str, Any], expected: str) -> None:
    (problem,) = problems({**LAWS[law].example, **change}, families(law))
    assert problem.startswith(expected)


@pytest.mark.parametrize("law", [law for law in LAWS if families(law)])
def test_an_unknown_family_of_fibres_is_reported_with_its_field(law: str) -> None:
    fields = LAWS[law].model_validate(LAWS[law].example).families
    unknown = [f"material.{field}: there are no fibres '{f}'; define them in 'fibres'" for f, field in fields.items()]
    assert problems(LAWS[law].example, []) == unknown
    if others := list(fields)[1:]:
        (problem,) = problems(LAWS[law].example, others)
        assert problem.startswith(unknown[0])


@pytest.mark.parametrize(
    ("law", "change"),
    [
        ("st-venant-kirchhoff", {"lam": "-6 kPa"}),
        ("yeoh", {"c3": 0}),
        ("ogden", {"mu": ["-1 kPa"], "alpha": [-4]}),
        ("ogden", {"mu": 7 * ["1 kPa"], "alpha": [1, 2, 3, 4, 5, 6, 7]}),
        ("ogden", {"kappa": "incompressible"}),
        ("holzapfel-gasser-ogden", {"dispersion": 1 / 3}),
        ("holzapfel-gasser-ogden", {"dispersion": 0, "fibres": ["helix"]}),
        ("holzapfel-gasser-ogden", {"fibres": ["one", "two", "three"]}),
        ("holzapfel-ogden", {"a_s": 0, "a_fs": 0}),
        ("gent", {"mu": {"core": "0.2 MPa", "elsewhere": "0.3 MPa"}, "jm": {"core": 40, "elsewhere": 30}}),
    ],
)
def test_valid_law_parameters_are_accepted(law: str, change: dict[str, Any]) -> None:
    job({**LAWS[law].example, **change, "law": law})


BY_MODULI = [{"law": "neo-hookean", "young": 1e3, "poisson": 0.3}, {"law": "neo-hookean", "mu": 1e3, "poisson": 0.3}]


@pytest.mark.parametrize("material", [*(law.example for law in LAWS.values()), *BY_MODULI])
def test_only_numbers_that_the_job_states_can_be_set(material: dict[str, Any]) -> None:
    """By others results are differentiated, but 'identify' and 'serve' refuse them."""
    case = job(dict(material))
    for where, law in case.laws.items():
        for place, number in law.numbers().items():
            if isinstance(number, Number):
                unit = "" if number.dimension is None else number.dimension.unit
                try:
                    case.with_({dotted_key((where, *place)): f"{number.value!r} {unit}" if unit else number.value})
                    is_set = True
                except JobError:
                    is_set = False
                assert is_set == (not law.unset_number(place)), place


def test_numbers_that_follow_from_others_are_neither_sought_nor_served() -> None:
    young = {"parameters": {"material.young": {"start": "7 kPa"}}}
    observed = {"observations": [{"name": "w", "quantity": "w", "value": 0.03, "sd": 1e-5}]}
    quantities = [{"name": "w", "of": "Y", "on": "x1", "reduce": "mean"}]
    case = job({"law": "neo-hookean", "mu": 1e3, "lam": 2e3})
    with pytest.raises(JobError, match=r"identify.*material\.young follows from mu and lam, which the law has"):
        case.with_({"quantities": quantities, "identify": young | observed})
    differentiated = case.with_({"quantities": quantities, "sensitivities": ["material.young"]})
    with Workspace(MPI.COMM_SELF) as workspace, pytest.raises(JobError, match=r"material\.young follows from mu and"):
        JobModel(differentiated, workspace, lambda: False)
