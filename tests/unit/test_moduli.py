"""Elastic moduli instead of a law's own parameters: every pair, every isotropic law, and what cannot be."""

from __future__ import annotations

from itertools import combinations
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import BLOCK, write_job
from pydantic import ValidationError

from hpcinv.__main__ import main
from hpcinv.physics.materials import MaterialLaw, laws
from hpcinv.physics.materials.moduli import shear_and_bulk, young_and_poisson

YOUNG, POISSON = 9.1e4, 0.37
ALL = {
    "young": YOUNG,
    "poisson": POISSON,
    "shear_modulus": YOUNG / (2 * (1 + POISSON)),
    "bulk_modulus": YOUNG / (3 * (1 - 2 * POISSON)),
    "lame": YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON)),
}
ISOTROPIC = {name: law for name, law in laws().items() if law.replaceable is not None and law.replaceable[0]}


def others(law: type[MaterialLaw]) -> dict[str, Any]:
    """What an example of a law says besides the two parameters that moduli determine."""
    assert law.replaceable is not None
    settings_read = {key: value for key, value in law.example.items() if key not in law.replaceable}
    if law.example["law"] == "ogden":
        settings_read["mu"] = law.example["mu"][:-1]
    return settings_read


def moduli(law: MaterialLaw) -> tuple[float, float]:
    (par,) = law.cases()
    return law.shear_modulus(par), inf if law.is_incompressible else law.bulk_modulus(par)


@pytest.mark.parametrize("pair", list(combinations(ALL, 2)))
def test_any_two_moduli_determine_the_others(pair: tuple[str, str]) -> None:
    mu, kappa = shear_and_bulk({name: ALL[name] for name in pair})
    assert mu == pytest.approx(ALL["shear_modulus"], rel=1e-13)
    assert kappa == pytest.approx(ALL["bulk_modulus"], rel=1e-13)
    assert young_and_poisson(mu, kappa) == pytest.approx((YOUNG, POISSON), rel=1e-13)


@pytest.mark.parametrize("name", ISOTROPIC)
def test_every_isotropic_law_takes_any_two_moduli(name: str) -> None:
    law = ISOTROPIC[name]
    for pair in combinations(ALL, 2):
        settings_read = law.model_validate({**others(law), **{modulus: ALL[modulus] for modulus in pair}})
        assert moduli(settings_read) == pytest.approx((ALL["shear_modulus"], ALL["bulk_modulus"]), rel=1e-12), pair


@pytest.mark.parametrize("name", ISOTROPIC)
def test_isotropic_laws_take_one_modulus_and_the_other_parameters(name: str) -> None:
    law = ISOTROPIC[name]
    assert law.replaceable is not None
    example = law.model_validate(law.example)
    young, poisson = young_and_poisson(*moduli(example))
    for left_out in law.replaceable:
        given = {key: value for key, value in law.example.items() if key != left_out}
        if name == "ogden" and left_out == "mu":
            given["mu"] = law.example["mu"][:-1]
        for modulus in ({"young": young}, {"poisson": poisson}):
            assert moduli(law.model_validate(given | modulus)) == pytest.approx(moduli(example), rel=1e-11)


@pytest.mark.parametrize("name", [name for name in ISOTROPIC if name != "st-venant-kirchhoff"])
@pytest.mark.parametrize(
    "pair",
    [
        {"young": YOUNG, "poisson": 0.5},
        {"young": YOUNG, "bulk_modulus": "incompressible"},
        {"shear_modulus": YOUNG / 3, "lame": "incompressible"},
        {"poisson": 0.5, "shear_modulus": YOUNG / 3},
    ],
)
def test_an_incompressible_material(name: str, pair: dict[str, Any]) -> None:
    law = ISOTROPIC[name].model_validate(others(ISOTROPIC[name]) | pair)
    assert moduli(law) == (pytest.approx(YOUNG / 3, rel=1e-13), inf)


@pytest.mark.parametrize("name", ISOTROPIC)
@pytest.mark.parametrize("modulus", ["young", "poisson"])
def test_rates_agree_with_the_parameters(name: str, modulus: str) -> None:
    """Against central differences of what a job with other moduli is read as."""
    law = ISOTROPIC[name]
    given = {"young": YOUNG, "poisson": POISSON}
    rates = law.model_validate(others(law) | given).rates((modulus,))
    step = 1e-5 * given[modulus]
    below, above = (
        law.model_validate(others(law) | given | {modulus: given[modulus] + sign * step}).quantities()
        for sign in (-1, 1)
    )
    for parameter, (low, _) in below.items():
        high = above[parameter][0]
        if parameter not in rates:
            assert low == high
            continue
        pairs = (
            zip(low, high, rates[parameter][0], strict=True)
            if isinstance(low, tuple)
            else [(low, high, rates[parameter][0])]
        )
        for a, b, rate in pairs:
            assert rate == pytest.approx((b - a) / (2 * step), rel=1e-6, abs=1e-6)


def test_a_formula_takes_poissons_ratio_instead_of_its_bulk_modulus() -> None:
    data = {"law": "formula", "energy": "mu/2*(I1_bar - 3)", "parameters": {"mu": "10 kPa"}}
    law = laws()["formula"].model_validate(data | {"poisson": POISSON})
    assert young_and_poisson(*moduli(law))[1] == pytest.approx(POISSON, rel=1e-9)


FAULTS = [
    ({"young": 1e4}, "young", "needs a second modulus: one of poisson, shear_modulus, bulk_modulus, lame"),
    ({"young": 1e4, "poisson": 0.3, "mu": 1e4}, "young", "give any two moduli, not 3: young, poisson, mu"),
    ({"shear_modulus": 1e4, "mu": 1e4}, "shear_modulus", "is determined by mu already: remove one of them"),
    ({"young": 1e4, "bulk_modulus": 1e3}, "young", "which must both be positive"),
    ({"young": -1e4, "poisson": 0.3}, "young", "must be positive, not -10000"),
    ({"young": 1e4, "poisson": 0.6}, "poisson", "must be above -1 and at most 0.5, not 0.6"),
    ({"poisson": 0.5, "bulk_modulus": "incompressible"}, "poisson", "do not determine the other moduli"),
    ({"poisson": 0.3, "mu": "1 kPa*(1 + x/(1 m))"}, "poisson", "only where the other parameters are plain numbers"),
    ({"young": "1 m", "poisson": 0.3}, "young", "must be a stress"),
    ({"yuong": 1e4, "poisson": 0.3, "mu": 1e3}, "yuong", "Did you mean 'young'?"),
]


@pytest.mark.parametrize(("given", "key", "message"), FAULTS, ids=lambda v: str(v) if isinstance(v, dict) else "")
def test_moduli_that_cannot_be_are_refused_at_their_key(given: dict[str, Any], key: str, message: str) -> None:
    with pytest.raises(ValidationError) as caught:
        laws()["gent"].model_validate({"law": "gent", "jm": 30} | given)
    messages = {error["loc"]: error["msg"] for error in caught.value.errors()}
    assert message in messages[key,]


def test_validate_names_the_convention_of_a_modulus_that_no_one_means(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Abaqus's D1 = 2/K instead of d1 = K/2, as a warning: the file is valid."""
    material = {"law": "mooney-rivlin", "c1": 9e5, "c2": 0, "d1": 2e-10}
    job = write_job(tmp_path / "job.yaml", BLOCK, material=material)
    assert main(["validate", str(job)]) == 0
    message = capsys.readouterr().err
    assert message.startswith(f"warning: {job}: material: Poisson's ratio is -1, ")
    assert "Abaqus's D1 is 1/d1" in message
    write_job(job, BLOCK, material=material | {"d1": "1/2e-10"})
    assert main(["validate", str(job)]) == 0
    assert capsys.readouterr().err == ""


MIXED = [pair for pair in combinations(ALL, 2) if pair != ("young", "poisson")]


@pytest.mark.parametrize("name", ISOTROPIC)
def test_rates_keep_the_other_modulus_that_the_job_gives(name: str) -> None:
    """Against central differences of what a job with another value is read as; also a parameter with a modulus."""
    law = ISOTROPIC[name]
    assert law.replaceable is not None
    cases = [others(law) | {modulus: ALL[modulus] for modulus in pair} for pair in MIXED]
    if name != "ogden":
        cases += [{k: v for k, v in law.example.items() if k != law.replaceable[1]} | {"poisson": 0.3}]
    for data in cases:
        read = law.model_validate(data)
        for (key, *rest), number in read.numbers().items():
            if rest or key not in data or isinstance(number, str):
                continue
            step = 1e-5 * abs(number.value)
            below, above = (
                law.model_validate(data | {key: number.value + sign * step}).quantities() for sign in (-1, 1)
            )
            rates = read.rates((key,))
            for parameter, (low, _) in below.items():
                expected = (np.array(above[parameter][0]) - np.array(low)) / (2 * step)
                got = rates[parameter][0] if parameter in rates else 0.0
                scale = max(1.0, float(np.abs(np.array(low)).max()) / abs(number.value))
                assert got == pytest.approx(expected, rel=1e-6, abs=1e-6 * scale), (data, key, parameter)
