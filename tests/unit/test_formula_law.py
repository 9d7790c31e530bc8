"""The law 'formula': which energies it takes, which it refuses and in which words, and the moduli that follow."""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import create_unit_cube
from pydantic import ValidationError
from ufl.classes import Variable

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.schema import dotted_key, problems_in
from hpcinv.base.quantity.units import Dimension
from hpcinv.model.weak_form import LABEL
from hpcinv.physics.kinematics.kinematics import Deformation
from hpcinv.physics.materials import laws
from hpcinv.physics.materials.formula import Formula

STRESS = Dimension(-1, 1, -2)


def formula(energy: str, kappa: Any = None, **parameters: Any) -> Formula:
    return Formula.model_validate({"energy": energy, "kappa": kappa, "parameters": parameters})


def problems(**data: Any) -> list[str]:
    with pytest.raises(ValidationError) as caught:
        Formula.model_validate(data)
    return [f"{dotted_key(where)}: {what}" for where, what in problems_in(caught.value)]


def moduli(law: Formula) -> tuple[float, float]:
    (par,) = law.cases()
    return law.shear_modulus(par), law.bulk_modulus(par)


@pytest.mark.parametrize(
    ("law", "shear", "bulk"),
    [
        (formula("mu/2*(I1 - 3) - mu*ln(J) + lam/2*ln(J)**2", mu="10 kPa", lam="40 kPa"), 10e3, 140e3 / 3),
        (formula("mu/2*(I1 - 3) - mu*ln(J) + lam/2*ln(J)**2", mu="1 Pa", lam="1 GPa"), 1.0, 1e9 + 2 / 3),
        (formula("c1*(I1_bar - 3) + c2*(I2_bar - 3)", "1 MPa", c1="1 kPa", c2="2 kPa"), 6e3, 1e6),
        (formula("c1*(J^(-2/3)*I1 - 3) + c2*(J^(-4/3)*I2 - 3)", "1 MPa", c1="1 kPa", c2="2 kPa"), 6e3, 1e6),
        (formula("c*(I1_bar - 3)", "incompressible", c="2 kPa"), 4e3, np.inf),
        (formula("a/2/b*(exp(b*(I1_bar - 3)) - 1)", "1 MPa", a="7 kPa", b=1e4), 7e3, 1e6),
        (formula("-mu*jm/2*ln(1 - (I1_bar - 3)/jm)", 3.0, mu="7 kPa", jm=0.1), 7e3, 3.0),
        # Blatz–Ko: mu/2 (I2/J² + 2 J - 5), whose Poisson's ratio is 1/4, so that kappa = 5/3 mu
        (formula("mu/2*(I2/J**2 + 2*J - 5)", mu="3 kPa"), 3e3, 5e3),
        # mu/2 (I1 - 3) + mu/(2 b) (J^(-2 b) - 1), kappa = mu (b + 1/3) 2
        (formula("mu/2*(I1 - 3) + mu/(2*b)*(J**(-2*b) - 1)", mu="3 kPa", b=0.8), 3e3, 2 * 3e3 * (0.8 + 1 / 3)),
        # what fibres add is left out
        (formula("mu/2*(I1_bar - 3) + k*(I4_f - 1)**2 + k*I8_f_s**2", "9 kPa", mu="3 kPa", k="1 MPa"), 3e3, 9e3),
        # plain numbers in an energy are in Pa
        (formula("5000*(I1_bar - 3) + (3 kPa)*(J - 1)**2"), 10e3, 6e3),
        (formula("3*mu*(sqrt(I1_bar/3) - 1) + mu*(cosh(ln(J)) - 1)", mu="3 kPa"), 3e3, 3e3),
    ],
)
def test_small_strain_moduli_follow_from_the_formula(law: Formula, shear: float, bulk: float) -> None:
    assert moduli(law) == pytest.approx((shear, bulk), rel=1e-7)


NOT_STRESS_FREE = "is not stress-free at F = I, where it "


@pytest.mark.parametrize(
    ("energy", "parameters", "message"),
    [
        ("mu/2*(I1 - 3)", {"mu": "2 kPa"}, NOT_STRESS_FREE + "leaves 2000 Pa in all directions; take I1_bar"),
        ("mu*(I4_f - 1) + mu*(I1_bar - 3)", {"mu": "2 kPa"}, NOT_STRESS_FREE + "leaves 4000 Pa along f; square"),
        ("mu*I8_f_s + mu*(I1_bar - 3)", {"mu": "2 kPa"}, NOT_STRESS_FREE + "leaves 4000 Pa along f and s"),
        ("mu*(I1_bar - 3) + mu*max(I4_f - 1, 0)", {"mu": "2 kPa"}, NOT_STRESS_FREE + "has a kink"),
        ("mu*(I1_bar - 3) + mu*abs(ln(J))", {"mu": "2 kPa"}, NOT_STRESS_FREE + "has a kink"),
        ("mu/2*(I1 - 3) - d*ln(J)", {"mu": "2 kPa", "d": "1.9999 kPa"}, NOT_STRESS_FREE + "leaves 0.1 Pa"),
        ("mu*(I1_bar - 3)", {"mu": 2}, "must be a stress, but 'mu*(I1_bar - 3)' is a pure number"),
        ("mu*(I1_bar - 3)", {"mu": 2}, "is a pure number. Give 'mu' a unit, such as mu: 2 kPa"),
        ("mu/2*(I1_bar - 3) + b*(I1_bar - 3)**2", {"mu": "1 kPa", "b": 2}, "is a pure number. Give 'b' a unit"),
        ("mu*(I1_bar - 3)", {"mu": "2 mm"}, "must be a stress, but 'mu*(I1_bar - 3)' is a length"),
        ("mu*(I1_bar - 3) + I2_bar", {"mu": "2 kPa"}, "adds or compares a stress and a pure number"),
        ("mu*exp(mu*(I1_bar - 3))", {"mu": "2 kPa"}, "needs a pure number where it has a stress"),
        ("mu*I1 > mu", {"mu": "2 kPa"}, "must be a stress, but 'mu*I1 > mu' is a condition"),
        ("mu*(I1_bars - 3)", {"mu": "2 kPa"}, "unknown name 'I1_bars' in 'mu*(I1_bars - 3)'. Did you mean 'I1_bar'?"),
        ("mu*(I4 - 1)**2", {"mu": "2 kPa"}, "unknown name 'I4' in"),
        ("nu*(I1_bar - 3)", {}, "unknown name 'nu'"),
        ("mu*sinus(I1)", {"mu": "2 kPa"}, "unknown function 'sinus'"),
        ("mu*sin(I1_bar - 3)", {"mu": "2 kPa"}, "calls sin(), which energies know of a constant only"),
        ("mu*(I1_bar - 3)/(J - 1)", {"mu": "2 kPa"}, "divides by something that is 0 at F = I"),
        ("mu*(0.1*I1_bar - 3)/(0.1*I1_bar - 0.3)", {"mu": "2 kPa"}, "divides by something that is 0 at F = I"),
        ("mu*(I1_bar - 3)/(1 - n)", {"mu": "2 kPa", "n": 1}, "divides by something that is 0 at F = I"),
        ("mu*ln(I1_bar - 3)", {"mu": "2 kPa"}, "takes the logarithm of something that is not positive at F = I"),
        ("mu*sqrt(I1_bar - 3)", {"mu": "2 kPa"}, "takes the square root of something that is not positive at F = I"),
        ("mu*(I4_f - 1)**2.5", {"mu": "2 kPa"}, "raises something that is 0 at F = I to the power 2.5; write"),
        ("mu*max(I4_f - 1, 0)**1.5", {"mu": "2 kPa"}, "raises something that is 0 at F = I to the power 1.5; write"),
        (
            "mu*(I1_bar - 4)**n",
            {"mu": "2 kPa", "n": 2.5},
            "raises something that is negative at F = I to the power 2.5",
        ),
        ("mu*exp(b*I1_bar)", {"mu": "2 kPa", "b": 1000}, "has no finite value near F = I"),
        ("mu*(I1_bar - 3) +", {"mu": "2 kPa"}, "is not a formula"),
    ],
)
def test_invalid_energies_are_refused_in_one_sentence(energy: str, parameters: dict[str, Any], message: str) -> None:
    (problem,) = problems(energy=energy, parameters=parameters, kappa="1 MPa")
    assert problem.startswith("energy: ")
    assert message in problem
    assert energy in problem or "unknown function" in problem


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"energy": "-mu*(I1_bar - 3)", "kappa": 1.0}, "the shear modulus that follows from these parameters must be"),
        ({"energy": "mu*(I1_bar - 3)**2", "kappa": 1.0}, "must be positive, but is 0 Pa"),
        ({"energy": "mu*(I1_bar - 3) - mu*(J - 1)**2", "kappa": 1.0}, "the bulk modulus that follows"),
        ({"energy": "mu*(I1_bar - 3)"}, "energy: 'mu*(I1_bar - 3)' does not resist a change of volume: give kappa"),
        ({"energy": "mu*(I1/J**(2/3) - 3)"}, "does not resist a change of volume: give kappa"),
        ({"energy": "mu*(J - 1)**2 + mu*(I1_bar - 3)", "volumetric": "liu"}, "volumetric: is not valid without kappa"),
        ({"energy": "(1 Pa)*(I1_bar - 3)", "kappa": 1.0}, "parameters.mu: does not occur in the energy"),
        ({"kappa": 1.0}, "energy: is needed"),
        ({"energy": "mu*(I1_bar - 3)", "kappa": "1 mm"}, "kappa: must be a stress"),
    ],
)
def test_inadmissible_formula_laws_are_refused_in_one_sentence(data: dict[str, Any], message: str) -> None:
    (problem,) = problems(parameters={"mu": "2 kPa"}, **data)
    assert message in problem


def test_parameters_must_have_names_and_values_of_their_own() -> None:
    taken = dict.fromkeys(("I1", "J", "I2_bar", "I4_f", "I8_f_s", "ln", "max", "pi", "kappa"), 1)
    faults = problems(energy="(1 Pa)*(I1_bar - 3)", kappa=1.0, parameters=taken)
    text = "is already the name of something else; 'hpcinv formulas' lists the reserved names"
    assert faults == [f"parameters.{name}: {text}" for name in taken]
    words = dict.fromkeys(("lambda", "c-1", "_a", "if"), 1)
    faults = problems(energy="(1 Pa)*(I1_bar - 3)", kappa=1.0, parameters=words)
    assert faults == [
        f"parameters.{n}: cannot be a name in a formula; choose a name of letters, digits and _" for n in words
    ]
    faults = problems(energy="c*(I1_bar - 3)", kappa=1.0, parameters={"c": "2 kPascal", "d": True, "e": None})
    assert [re.match(r"parameters\.(\w): .*(unknown unit|not (True|None))", p) is not None for p in faults] == 3 * [
        True
    ]
    free = Formula.model_validate(
        {"energy": "kappa*(J - 1)**2 + kappa*(I1 - 3 - 2*ln(J))", "parameters": {"kappa": "2 kPa"}}
    )
    assert moduli(free) == pytest.approx((4e3, 4e3 + 8e3 / 3), rel=1e-7)


def test_parameters_keep_their_dimension_through_json() -> None:
    law = formula("(a*b)**0.5*(I1_bar - 3)", 1.0, a="1.1 mm^-2 N", b="2.7e-3 MPa")
    assert law.parameters["b"].value == 2700.0
    assert law.parameters["b"].dimension == STRESS
    copy = Formula.model_validate(law.model_dump(mode="json"))
    assert copy == law
    assert formula("n*(1 Pa)*(I1_bar - 3)", 1.0, n=3).model_dump(mode="json")["parameters"] == {"n": 3.0}


def test_a_formula_law_states_its_fibres_and_formulation() -> None:
    law = formula("mu*(I1_bar - 3) + mu*(I4_muscle - 1)**2 + mu*I8_s_f**2", "incompressible", mu="2 kPa")
    assert law.families == {"muscle": "energy", "f": "energy", "s": "energy"}
    assert law.is_split
    assert law.is_incompressible
    assert law.stiffness_ratio == np.inf
    whole = formula("mu*(I1_bar - 3) + mu*ln(J)**2", mu="2 kPa")
    assert whole.families == {}
    assert not whole.is_split
    assert not whole.is_incompressible
    assert whole.energy_formula == "mu*(I1_bar - 3) + mu*ln(J)**2 + 0"
    assert laws()["formula"] is Formula
    Formula.model_validate(Formula.example)


def test_other_values_make_the_same_form() -> None:
    mesh = create_unit_cube(MPI.COMM_SELF, 1, 1, 1)
    H = fem.Constant(mesh, np.zeros((3, 3)))

    def signature(law: Formula) -> str:
        values = [value for value, _ in law.quantities().values()]
        symbols = fem.Constant(mesh, values)
        par = SimpleNamespace(**{name: symbols[i] for i, name in enumerate(law.quantities())})
        k = Deformation(Variable(H, LABEL), {"f": ufl.as_vector([1, 0, 0])})
        psi = law.isochoric_energy(k, par) + law.volumetric_modulus(par) * law.dilatation(k) ** 2 / 2
        return str((psi * (law.shear_modulus(par) + law.bulk_modulus(par)) * ufl.dx(mesh)).signature())

    energy = "mu*(I1_bar**n - 3**n)/n + mu*max(d*I1_bar + (1 - 3*d)*I4_f - 1, 0)**2"
    first = signature(formula(energy, "1 MPa", mu="2 kPa", n=1.3, d=0.2))
    assert signature(formula(energy, "2 MPa", mu="3 kPa", n=2, d=0.3)) == first
    assert signature(formula(energy + " + mu*(J - 1)**2", "2 MPa", mu="3 kPa", n=2, d=0.3)) != first


@pytest.mark.parametrize("name", sorted(laws().keys() - {"formula", "hencky", "ogden"}))
def test_the_printed_formula_of_a_law_is_one_of_this_law(name: str) -> None:
    """With its parameters it has the same moduli."""
    law = laws()[name].model_validate(laws()[name].example)
    parameters: dict[str, float | str] = {}
    for key, (value, dimension) in law.quantities().items():
        entries = {f"{key}{i}": x for i, x in enumerate(value, 1)} if isinstance(value, tuple) else {key: value}
        parameters |= {k: f"{x!r} {dimension.unit}" if dimension.unit else x for k, x in entries.items()}
    copied = laws()["formula"].model_validate(
        {"law": "formula", "energy": law.energy_formula, "parameters": parameters}
    )
    (own,), (of_copy,) = law.cases(), copied.cases()
    if not law.families or name == "transversely-isotropic":
        assert copied.shear_modulus(of_copy) == pytest.approx(law.shear_modulus(own), rel=1e-8)
        assert copied.bulk_modulus(of_copy) == pytest.approx(law.bulk_modulus(own), rel=1e-4)


def test_principal_stretches_are_refused_with_the_law_that_has_them() -> None:
    with pytest.raises(ValidationError, match=r"'lambda1_bar' is a principal stretch.*take 'law: ogden'"):
        laws()["formula"].model_validate(
            {
                "law": "formula",
                "energy": laws()["ogden"].formula.replace("_i", "1"),
                "parameters": {"mu1": "1 MPa", "alpha1": 2},
            }
        )


def test_a_parameter_called_like_a_unit_prevails() -> None:
    energy = "6 kPa/m*(I1_bar - 3)"
    section = {"law": "formula", "energy": energy, "parameters": {"m": 3}, "kappa": "1 MPa"}
    law = laws()["formula"].model_validate(section)
    (par,) = law.cases()
    assert law.shear_modulus(par) == pytest.approx(4e3, rel=1e-8)
