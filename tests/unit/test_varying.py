"""Quantities that vary over the body: what a job may say, what it means, how it comes back, and what is refused."""

from __future__ import annotations

import json
import math
import pickle
from pathlib import Path
from typing import Any

import pytest
import yaml
from helpers.verification import HERE

import hpcinv
from hpcinv.base.quantity.expressions import Expression
from hpcinv.base.quantity.spatial_fields import ByData, ByFormula, ByRegion, is_uniform
from hpcinv.errors import JobError
from hpcinv.job.fingerprint import fingerprint
from hpcinv.job.job import Job, parse
from hpcinv.output.run_directory import RunDirectory

BOX = Path(__file__).parents[2] / "meshes" / "box.py"
HELD = [{"region": "x0", "fix": ["x", "y", "z"]}]
SOFT = {"law": "isochoric-neo-hookean", "mu": "1 kPa", "kappa": "5 kPa"}
HELIX = {"direction": ["-y", "x", "k"], "constants": {"k": "3 mm"}, "given_on": "current"}
STATED = {"discretisation": {"formulation": "displacement"}}


def job(**data: Any) -> Job:
    return parse(data, HERE)


def data(**changes: Any) -> dict[str, Any]:
    return {"mesh": {"file": str(BOX)}, "material": SOFT, "supports": HELD, **STATED, **changes}


def mu(value: Any) -> Any:
    """What a job with this shear modulus has for it."""
    return job(**data(material=SOFT | {"mu": value})).material.mu


def problems(**changes: Any) -> list[str]:
    with pytest.raises(JobError) as caught:
        job(**data(**changes))
    return [p.split(": ", 1)[1] for p in caught.value.problems]


@pytest.mark.parametrize(
    ("value", "pascal"),
    [(1500, 1500.0), ("1.5 kPa", 1500.0), ("3*(0.5 kPa)", 1500.0), ("1e3 + 0.5e3", 1500.0)],
)
def test_constant_fields_are_one_number(value: Any, pascal: float) -> None:
    assert mu(value) == pascal
    assert is_uniform(mu(value))


def test_a_formula_is_evaluated_in_si() -> None:
    modulus = mu("1 kPa*(1 + X/(10 mm))")
    assert modulus == ByFormula(Expression("1 kPa*(1 + X/(10 mm))"))
    assert not is_uniform(modulus)
    assert modulus.formula.evaluate(X=[0.0, 0.01, 0.03]) == pytest.approx([1e3, 2e3, 4e3], rel=1e-15)


def test_a_value_for_each_region_is_read_with_its_unit() -> None:
    assert mu({"core": "1 kPa", "elsewhere": 2000}) == ByRegion({"core": 1000.0, "elsewhere": 2000.0})


def test_data_of_the_mesh_have_a_unit() -> None:
    modulus = mu({"data": "stiffness", "unit": "kPa"})
    assert modulus == ByData("stiffness", "kPa")
    assert modulus.factor == 1000.0
    assert mu({"data": "stiffness"}).factor == 1.0  # SI


def test_vectors_may_mix_numbers_and_fields() -> None:
    effect = {"effect": "traction", "region": "x1", "area_in": "reference", "traction": ["1 kPa", "2 Pa*Y/(1 m)", 0]}
    (entry,) = job(**data(effects=[effect])).effects
    assert entry.traction == (1000.0, ByFormula(Expression("2 Pa*Y/(1 m)")), 0.0)  # type: ignore[attr-defined]
    assert not is_uniform(entry.traction)  # type: ignore[attr-defined]


REFUSED: list[tuple[Any, str]] = [
    ("1 m", "must be a stress (in Pa, or with a unit), but '1 m' is a length"),
    ("1 Pa*X", "must be a stress, but '1 Pa*X' is a force per length"),
    ("X", "must be a stress, but 'X' is a length"),
    ("1 kPa + X", "'1 kPa + X' adds or compares a stress and a length"),
    ("1 kPa*exp(X)", "'1 kPa*exp(X)' needs a pure number where it has a length"),
    ("X > 0", "must be a stress, but 'X > 0' is a condition"),
    ("1 kPa*(1 + Q)", "unknown name 'Q' in '1 kPa*(1 + Q)'. Known: X, Y, Z, x, y, z."),
    ("1 kPa*cosinus(X)", "unknown function 'cosinus' in '1 kPa*cosinus(X)'. Did you mean"),
    ("1 kPa*(1 + X/(10 mn))", "in '1 kPa*(1 + X/(10 mn))': unknown unit 'mn'. Did you mean"),
    ("1 kPa*", "'1 kPa*' is not a formula"),
    ("soft", "'soft' is not a number, with or without a unit"),
    ("-1 kPa", "must be above 0, not -1 kPa"),
    ("-(2 kPa)/2", "must be above 0, not -1000.0"),
    ("1 Pa + 1/0", "must be finite, not inf"),
    (math.nan, "must be finite, not nan"),
    (True, "must be a stress (in Pa, or with a unit), not True"),
    ([1, 2], "must be a stress (in Pa, or with a unit), not [1, 2]"),
    (None, "must be a stress (in Pa, or with a unit), not None"),
    ({}, "must name regions, such as {core: 1, elsewhere: 2}"),
    ({"core": "1 m"}, "in region 'core': must be a stress (in Pa, or with a unit), but '1 m' is a length"),
    ({"core": 1, "skin": -1}, "in region 'skin': must be above 0, not -1"),
    ({"core": "1 kPa*X"}, "in region 'core': unknown unit"),
    ({"data": 3}, "must name an array of the mesh file, as {data: NAME, unit: kPa}, not {'data': 3}"),
    ({"data": "a", "units": "kPa"}, "must name an array of the mesh file, as {data: NAME, unit: kPa}"),
    ({"data": "a", "unit": "m"}, "must be a stress (in Pa, or with a unit), but 'm' is a unit of a length"),
    ({"data": "a", "unit": "kP"}, "unknown unit 'kP'. Did you mean"),
]


@pytest.mark.parametrize(("value", "text"), REFUSED, ids=[str(value) for value, _ in REFUSED])
def test_values_of_the_wrong_dimension_are_refused_with_their_field(value: Any, text: str) -> None:
    [problem] = problems(material=SOFT | {"mu": value})
    assert problem.startswith(f"material.mu: {text}")


def test_the_field_is_named_in_regions_effects_and_vectors() -> None:
    laws = {"core": SOFT, "skin": SOFT | {"mu": "X"}}
    assert problems(material=laws)[0].startswith("material.skin.mu: must be a stress")
    effect = {"effect": "traction", "region": "x1", "area_in": "reference", "traction": [0, "1 Pa*W", 0]}
    assert problems(effects=[effect])[0].startswith("effects[0].traction[1]: unknown name 'W'")
    contraction = {"effect": "active-stress", "fibre": "fibre", "stress": {"core": "1 m"}}
    assert problems(effects=[contraction], fibres={"fibre": HELIX})[0].startswith("effects[0].stress: in region 'core'")


def test_bounds_hold_in_each_region_and_above_the_one_law() -> None:
    law = {"law": "holzapfel-gasser-ogden", "mu": 1, "k1": 1, "k2": 1, "kappa": 9}
    families = {"fibre1": HELIX, "fibre2": HELIX}
    faults = problems(fibres=families, material=law | {"dispersion": {"core": 0.1, "skin": 0.34}})
    assert faults[0] == "material.dispersion: in region 'skin': must be at least 0 and at most 0.333333, not 0.34"
    assert problems(material={"law": "neo-hookean", "mu": {"core": 1, "skin": -3}, "lam": 9}) == [
        "material: the shear modulus that follows from these parameters must be positive, but is -3 Pa"
    ]


def test_no_region_of_a_law_is_incompressible_alone() -> None:
    [faults] = problems(material=SOFT | {"kappa": {"core": "incompressible", "skin": "5 kPa"}})
    assert faults == ("material.kappa: in region 'core': cannot be 'incompressible'; give that region a separate law")


def test_moduli_that_vary_leave_the_form_to_the_job_unless_the_law_is_incompressible() -> None:
    graded = SOFT | {"mu": "1 kPa*(1 + X/(1 m))"}
    [faults] = problems(material=graded, discretisation={})
    assert faults == (
        "discretisation.formulation: must be stated, displacement or mixed, since the moduli of material vary over "
        "the body"
    )
    assert job(**data(material=graded | {"kappa": "incompressible"}, discretisation={})).is_mixed
    by_region = SOFT | {"mu": {"core": "1 kPa", "skin": "0.2 kPa"}}
    assert job(**data(material=by_region, discretisation={})).is_mixed  # 5/0.2 is more than 20
    assert problems(material=graded | {"kappa": "incompressible"})[0].startswith(
        "discretisation.formulation: must be mixed"
    )


VARIED: dict[str, dict[str, Any]] = {
    "formula": {"material": SOFT | {"mu": "1 kPa*(1 + X/(10 mm))"}},
    "by region": {"material": SOFT | {"mu": {"core": "1 kPa", "elsewhere": "2 kPa"}}},
    "data": {"material": SOFT | {"mu": {"data": "stiffness", "unit": "kPa"}, "kappa": {"data": "bulk"}}},
    "incompressible": {
        "material": SOFT | {"mu": "1 Pa + 1 Pa*x/(1 m)", "kappa": "incompressible"},
        "discretisation": {},
    },
    "laws by region": {"material": {"core": SOFT, "elsewhere": {"law": "neo-hookean", "young": 9e3, "poisson": 0.3}}},
    "regions": {"regions": {"core": "x < 0.5 and norm(y, z) > 1 mm", "tip": "x > 0.999 m"}},
    "fibres": {
        "fibres": {
            "helix": HELIX,
            "fibre": {"data": "grain", "given_on": "reference"},
        },
        "material": {"law": "transversely-isotropic", "mu": 1e3, "k": "2 kPa*(1 + Z/(1 m))", "kappa": 5e3},
        "effects": [{"effect": "active-stress", "fibre": "helix", "stress": "3 kPa*cos(X/(1 m))"}],
    },
    "load cases": {
        "load_cases": ["weight", "pull"],
        "effects": [
            {"effect": "gravity", "acceleration": [0, 0, -9.81], "density": "1 g/cm^3", "case": "weight"},
            {"effect": "pressure", "region": "y1", "pressure": "1 kPa*Z/(1 m)", "case": "pull"},
        ],
        "supports": [
            *HELD,
            {"region": "x1", "displacement": ["k*x", None, 0], "constants": {"k": 0.1}, "case": "pull"},
        ],
    },
}


@pytest.mark.parametrize("name", VARIED)
def test_a_job_comes_back_from_json_from_another_rank_and_from_its_run_directory(name: str, tmp_path: Path) -> None:
    given = data(**VARIED[name])
    whole = job(**given)
    assert whole.path is not None
    plain = json.loads(json.dumps(whole.model_dump(mode="json", exclude_unset=True)))
    assert parse(plain, whole.path) == whole
    copy = pickle.loads(pickle.dumps(whole))
    assert (copy, copy.path) == (whole, whole.path)

    (tmp_path / "jobs").mkdir()
    (tmp_path / "box.py").write_text(BOX.read_text())
    file = tmp_path / "jobs" / "a.yaml"
    file.write_text(yaml.safe_dump(given | {"mesh": {"file": "../box.py", "parameters": {"lx": "2 mm"}}}))
    saved = hpcinv.load(file)
    directory = RunDirectory(tmp_path / "results" / "a")
    directory.create(saved, overwrite=False)
    resumed = directory.job(None)
    assert (resumed, resumed.path) == (saved, file)
    assert fingerprint(resumed) == fingerprint(saved)


def test_another_field_is_another_problem() -> None:
    print_of_region = fingerprint(job(**data(material=SOFT | {"mu": {"core": "1 kPa", "elsewhere": 2000}})))
    same = fingerprint(job(**data(material=SOFT | {"mu": {"core": 1000, "elsewhere": "2 kPa"}})))
    other = fingerprint(job(**data(material=SOFT | {"mu": {"core": "1 kPa", "elsewhere": 2001}})))
    formula = fingerprint(job(**data(material=SOFT | {"mu": "1 kPa*(1 + X/(1 m))"})))
    assert print_of_region == same
    assert print_of_region != other
    assert print_of_region != formula
