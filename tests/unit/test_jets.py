"""Energies as formulas, at strains where their terms cancel, against evaluation with 90 digits."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import mpmath as mp
import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import create_unit_cube
from ufl.classes import Variable

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.expressions import Expression
from hpcinv.base.quantity.functions import FUNCTIONS
from hpcinv.model.weak_form import LABEL
from hpcinv.physics.kinematics.kinematics import Deformation
from hpcinv.physics.kinematics.ufl_formulas import UFL_FUNCTIONS
from hpcinv.physics.materials.formula import Formula
from hpcinv.physics.materials.formula_law.algebras import FLOATS
from hpcinv.physics.materials.formula_law.coefficients import ONE, ZERO, Coefficient
from hpcinv.physics.materials.formula_law.invariants import PrincipalStretches, families_in, invariants
from hpcinv.physics.materials.formula_law.jet import JET_FUNCTIONS, Jet, Strains

FIBRES = {"f": (1, 2, 2), "s": (2, 1, -2)}  # of length 3, orthogonal
# Fibres f are stretched, s are compressed.
DIRECTION = np.random.default_rng(1).uniform(-1, 1, (3, 3)) - 0.1 * np.outer(FIBRES["s"], FIBRES["s"])
MP_FUNCTIONS: dict[str, Callable[..., Any]] = {
    **{name: getattr(mp, name) for name in ("exp", "log", "ln", "sqrt", "sin", "cos", "tan", "sinh", "cosh", "tanh")},
    "max": max,
    "min": min,
    "abs": abs,
    "norm": lambda *terms: mp.sqrt(sum(t * t for t in terms)),
}
LAWS: dict[str, tuple[str, dict[str, Any]]] = {
    "neo-Hookean": ("mu/2*(I1 - 3) - mu*ln(J) + lam/2*ln(J)**2", {"mu": "10 kPa", "lam": "40 kPa"}),
    "Mooney–Rivlin": (
        "c1*(I1 - 3) + c2*(I2 - 3) - 2*(c1 + 2*c2)*log(J) + k/2*(J - 1)^2",
        {"c1": "1 kPa", "c2": "2 kPa", "k": "50 kPa"},
    ),
    "isochoric by hand": (
        "c1*(J**(-2/3)*I1 - 3) + c2*(I2/J**(4/3) - 3) + k/4*(J**2 - 1 - 2*ln(J))",
        {"c1": "1 kPa", "c2": "2 kPa", "k": "50 kPa"},
    ),
    "Yeoh": (
        "c1*(I1_bar - 3) + c2*(I1_bar - 3)**2 + c3*(0.1*I2_bar - 0.3)**3 + k/2*(J - 1)**2",
        {"c1": "1 kPa", "c2": "2 kPa", "c3": "3 MPa", "k": "50 kPa"},
    ),
    "Fung": ("a/2/b*(exp(b*(I1_bar - 3)) - 1) + k/2*(J - 1)**2", {"a": "1 kPa", "b": 8, "k": "50 kPa"}),
    "Gent": ("-mu*jm/2*ln(1 - (I1_bar - 3)/jm) + k/2*(J - 1)**2", {"mu": "1 kPa", "jm": 20, "k": "50 kPa"}),
    "powers": (
        "3**(1 - n)/(2*n)*mu*(I1**n - 3**n) - mu*ln(J) + k/2*(sqrt(J) - 1/sqrt(J))**2",
        {"mu": "1 kPa", "n": 1.7, "k": "50 kPa"},
    ),
    "Holzapfel–Gasser–Ogden": (
        "mu/2*(I1_bar - 3) + k1/(2*k2)*(exp(k2*max(I4_f - 1, 0)**2) + exp(k2*max(I4_s - 1, 0)**2) - 2)"
        " + k/2*(J - 1)**2",
        {"mu": "1 kPa", "k1": "5 kPa", "k2": 3, "k": "50 kPa"},
    ),
    "dispersed and sheared fibres": (
        "mu/2*(I1_bar - 3) + k1/(2*k2)*(exp(k2*max(d*I1_bar + (1 - 3*d)*I4_f - 1, 0)**2) - 1) + a*I8_f_s**2"
        " + a*(I5_f - 2*I4_f + 1) + a*(min(I4_s, 1) - 1)**2 + k/2*(J - 1)**2",
        {"mu": "1 kPa", "a": "1 kPa", "k1": "5 kPa", "k2": 3, "d": 0.226, "k": "50 kPa"},
    ),
    "kinks": (
        "mu/2*(I1_bar - 3) + k*max(I4_f - 1, 0)**n + k*abs(J - 1)**n",
        {"mu": "1 kPa", "k": "5 kPa", "n": 2.5},
    ),
}


class Stress:
    """``P`` of a law at any ``H``, as the symbolic derivative of its energy gives it."""

    def __init__(self, energy: Callable[[Deformation, Any], Any], law: Formula, *, tangent: bool = False) -> None:
        self._mesh = create_unit_cube(MPI.COMM_SELF, 1, 1, 1)
        self._H, self._D = (fem.Constant(self._mesh, np.zeros((3, 3))) for _ in range(2))
        H = Variable(self._H, LABEL)
        values = {name: value for name, (value, _) in law.quantities().items() if value is not None}
        symbols = fem.Constant(self._mesh, list(values.values()))
        par = SimpleNamespace(**{name: symbols[i] for i, name in enumerate(values)})
        k = Deformation(H, {name: ufl.as_vector([a / 3 for a in direction]) for name, direction in FIBRES.items()})
        P = ufl.diff(energy(k, par), H)
        wanted = ufl.diff(ufl.inner(P, self._D), H) if tangent else P
        self._compiled = fem.Expression(wanted, np.array([[0.25, 0.25, 0.25]]))

    def __call__(self, H: np.ndarray, D: np.ndarray | None = None) -> np.ndarray:
        """``P(H)``, or the tangent's ``∂(P : D)/∂H``."""
        self._H.value[:] = H
        self._D.value[:] = 0 if D is None else D
        return self._compiled.eval(self._mesh, np.array([0], dtype=np.int32)).reshape(3, 3)


def law(name: str) -> Formula:
    energy, parameters = LAWS[name]
    return Formula.model_validate({"energy": energy, "parameters": parameters, "kappa": "1 Pa"})


def exact_stress(law: Formula, H: np.ndarray) -> Any:
    """``P``, by differences with 90 digits of the formula as it is written."""

    def energy(H: Any) -> Any:
        F = mp.eye(3) + H
        C, J = F.T * F, mp.det(F)
        C2 = C * C
        I1, trace = (sum(A[i, i] for i in range(3)) for A in (C, C2))
        I2 = (I1**2 - trace) / 2
        values = {"I1": I1, "I2": I2, "J": J, "I1_bar": I1 / mp.cbrt(J) ** 2, "I2_bar": I2 / mp.cbrt(J) ** 4}
        f, s = (mp.matrix(a) / 3 for a in FIBRES.values())
        values |= {"I4_f": (f.T * C * f)[0], "I4_s": (s.T * C * s)[0], "I5_f": (f.T * C2 * f)[0]}
        values |= {"I8_f_s": (f.T * C * s)[0]} | {n: mp.mpf(p.value) for n, p in law.parameters.items()}
        return law.energy.apply(values, MP_FUNCTIONS, mp.mpf)

    def derivative(i: int, j: int) -> Any:
        step = mp.zeros(3)
        step[i, j] = mp.mpf(10) ** -30
        return (energy(H + step) - energy(H - step)) / (2 * step[i, j])

    with mp.workdps(90):
        H = mp.matrix(H.tolist())
        return np.array([[derivative(i, j) for j in range(3)] for i in range(3)])


def relative_error(computed: np.ndarray, exact: Any) -> float:
    return float(np.abs(computed - exact).max() / np.abs(exact).max())


@pytest.mark.everyday("Gent")
@pytest.mark.parametrize("name", LAWS)
def test_no_digits_of_the_stress_are_lost_however_small_the_strain(name: str) -> None:
    stress = Stress(law(name).isochoric_energy, law(name))
    for size in (1e-14, 1e-10, 1e-6, 1e-3, 3e-3, 0.05, 0.3):
        H = size * DIRECTION
        assert relative_error(stress(H), exact_stress(law(name), H)) < 1e-13, size
    assert not stress(np.zeros((3, 3))).any()


def test_formulas_as_written_lose_digits_at_small_strain() -> None:
    """So that the test above means something."""
    written = law("neo-Hookean")

    def energy(k: Deformation, par: Any) -> Any:
        return written.energy.apply({"I1": ufl.tr(k.F.T * k.F), "J": ufl.det(k.F), **vars(par)}, UFL_FUNCTIONS)

    stress = Stress(energy, written)
    errors = [relative_error(stress(H), exact_stress(written, H)) for H in (1e-10 * DIRECTION, 0.3 * DIRECTION)]
    assert errors[0] > 1e-8
    assert errors[1] < 1e-14


@pytest.mark.release
@pytest.mark.parametrize("name", ["Fung", "kinks"])
def test_the_tangent_at_rest_is_finite_and_right(name: str) -> None:
    """Where Newton begins: for hyperelastic laws ``∂(P : D)/∂H`` at rest is the stress per size of a strain ``D``."""
    tangent = Stress(law(name).isochoric_energy, law(name), tangent=True)(np.zeros((3, 3)), DIRECTION)
    exact = exact_stress(law(name), 1e-25 * DIRECTION) * mp.mpf(10) ** 25
    assert relative_error(tangent, exact) < 1e-11  # kinks: |J - 1|^1.5


# Functions of x = 1.2 + 2 s - 3 t and y = s - 2 t, as jets in floats.
FORMULAS = [
    "x*y + 3*x - y/x",
    "(x + y)**3/(2 - x*x)",
    "x**-4 - 2*y**2 + y**7 + y**0",
    "x**0.3 + x**(2*y) + 2**y",
    "(x - 2)**5",
    "exp(2*x) + log(3*x) - ln(x + y)",
    "sqrt(x)*sqrt(2 + y) - norm(x, y, 1)",
    "sinh(y)*cosh(x) - tanh(x + y)",
    "sin(pi/6)*x + cos(2)*tan(1)*y + asin(0.5) + acos(0.3)*atan(2)*x*y",
    "max(x, y)**2 + min(x, y, 3) + abs(-x*y - 3)",
]


@pytest.mark.parametrize("text", FORMULAS)
@pytest.mark.parametrize("size", [1e-5, -0.05])
def test_the_parts_of_a_jet_are_value_slope_and_remainder(text: str, size: float) -> None:
    s, t = size, 0.7 * size
    strains = Strains(FLOATS, {"s": s, "t": t})

    def linear(constant: float, of_s: float, of_t: float) -> Jet:
        slopes = {"s": Coefficient.literal(of_s), "t": Coefficient.literal(of_t)}
        return Jet(strains, Coefficient.literal(constant), slopes, 0.0, 2)

    formula = Expression(text)
    jet = formula.apply({"x": linear(1.2, 2.0, -3.0), "y": linear(0.0, 1.0, -2.0)}, JET_FUNCTIONS, strains.number)
    with mp.workdps(50):
        functions = MP_FUNCTIONS | {name: getattr(mp, name) for name in ("asin", "acos", "atan")}

        def exact(s: Any, t: Any) -> Any:
            x, y = mp.mpf(1.2) + 2 * s - 3 * t, s - 2 * t
            return formula.apply({"x": x, "y": y}, functions, mp.mpf)

        origin = exact(mp.mpf(0), mp.mpf(0))
        slopes = {"s": mp.diff(exact, (0, 0), (1, 0)), "t": mp.diff(exact, (0, 0), (0, 1))}
        s, t = mp.mpf(s), mp.mpf(t)
        remainder = exact(s, t) - origin - slopes["s"] * s - slopes["t"] * t
    assert jet.constant.value == pytest.approx(float(origin), rel=1e-14, abs=1e-15)
    for name, slope in slopes.items():
        assert jet.slopes.get(name, ZERO).value == pytest.approx(float(slope), rel=1e-13)
    assert jet.remainder == pytest.approx(float(remainder), rel=1e-9)
    assert jet.change == pytest.approx(float(exact(s, t) - origin), rel=1e-12)


@pytest.mark.parametrize(
    ("text", "change"),
    [
        ("max(y, 0)", 2e-3),
        ("max(-y, 0)", 0.0),
        ("max(y, 0)**2", 4e-6),
        ("abs(-y)**3", 8e-9),
        ("min(y, 0)", 0.0),
        ("max(y, 0)**2.5", 2e-3**2.5),
        ("max(-y, 0)**2.5", 0.0),
        ("max(3 + y, 0)", 2e-3),
        ("max(y - 3, 0)", 0.0),
        ("max(y - 1e-3, 0)", 1e-3),
        ("max(1e-3 - y, 0)", -1e-3),
        ("exp(max(y, 0)) - 1", np.expm1(2e-3)),
    ],
)
def test_kinks_are_where_they_belong(text: str, change: float) -> None:
    strains = Strains(FLOATS, {"t": 1e-3})
    y = Jet(strains, ZERO, {"t": Coefficient.literal(2.0)}, 0.0, 2)
    assert Expression(text).apply({"y": y}, JET_FUNCTIONS, strains.number).change == pytest.approx(change, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "order"),
    [
        ("y + y**2", 2),
        ("max(y, 0)", 1),
        ("max(y, 0) - y", 1),
        ("max(y, 0)*y", 2),
        ("max(y, 0)**3", 3),
        ("max(y, 0)**2.5", 2.5),
        ("cosh(max(y, 0))", 1),  # not seen: the kinks of exp(y) and exp(-y) cancel
        ("exp(max(y, 0)**2)", 2),
        ("3*max(y + 1, 0)", 2),
        ("2 + 3", float("inf")),
    ],
)
def test_the_order_of_a_remainder_shows_whether_it_has_a_kink(text: str, order: float) -> None:
    strains = Strains(FLOATS, {"t": 1e-3})
    y = Jet(strains, ZERO, {"t": Coefficient.literal(2.0)}, 0.0, 2)
    assert Expression(text).apply({"y": y}, JET_FUNCTIONS, strains.number).order == order


def test_a_power_of_a_strain_becomes_at_most_a_thousand_factors() -> None:
    strains = Strains(FLOATS, {"t": 0.5})
    y = Jet(strains, ZERO, {"t": Coefficient.literal(2.0)}, 0.0, 2)
    assert Expression("y**1000").apply({"y": y}, JET_FUNCTIONS, strains.number).change == pytest.approx(1.0)
    with pytest.raises(ValueError, match="raises a strain to the power 1001, and the largest is 1000"):
        Expression("y**1001").apply({"y": y}, JET_FUNCTIONS, strains.number)


def test_rounding_errors_of_coefficients_are_zero() -> None:
    literal = Coefficient.literal
    assert 0.1 * 3 - 0.3 != 0.0
    assert not literal(0.1) * literal(3.0) - literal(0.3)
    assert not (literal(0.1) * literal(3.0) / literal(0.3)).apply("log", FLOATS, slope=1.0)
    assert math.sin(math.pi) != 0.0
    assert not literal(math.pi).apply("sin", FLOATS)
    # and what does not, is not
    assert (ONE + literal(1e-12) - ONE).value == pytest.approx(1e-12, rel=1e-3)
    assert literal(1e-20).apply("sin", FLOATS).value == 1e-20
    assert (literal(1e-20) * literal(1e-20)).value == pytest.approx(1e-40)


def test_a_parameter_that_happens_to_be_a_whole_number_is_none_for_good() -> None:
    """Else a form would be another one for other values."""
    two, n = Coefficient.literal(2.0), Coefficient.parameter(2.0, "n")
    assert (two * two).is_literal
    assert not n.is_literal
    assert not (Coefficient.parameter(2.0, 2.0) * two).is_literal


def test_a_formula_names_what_must_stay_positive() -> None:
    deformation = PrincipalStretches(0.3, -0.3, 0.0)
    I1_bar = 1 + 2 * math.cosh(0.6)

    def positive(text: str) -> list[float]:
        strains = Strains(FLOATS)
        values = invariants(Expression(text).names, deformation, strains)
        Expression(text).apply(values, JET_FUNCTIONS, strains.number)
        return strains.positive

    assert positive("ln(1 - (I1_bar - 3)/4)") == pytest.approx([1 - (I1_bar - 3) / 4])
    assert positive("1/(2 - (I1_bar - 3))") == pytest.approx([1 - (I1_bar - 3) / 2])
    assert positive("sqrt(8 - 2*I2)") == pytest.approx([(8 - 2 * I1_bar) / 2])  # I2 = I1 here
    assert positive("ln(J) + I1**1.5 + 1/(I1_bar*J + exp(J - 2)) + sqrt(2*I1/J)") == []


def test_names_of_invariants_hold_the_families_of_fibres() -> None:
    assert families_in("I1_bar") == ()
    assert families_in("I4_muscle") == ("muscle",)
    assert families_in("I8_f_s") == ("f", "s")
    for name in ("I3", "I4", "I4_", "I6_f", "I8_f", "i1", "I4_f_s", "mu"):
        assert families_in(name) is None


def test_every_function_of_formulas_is_known_or_refused_in_words() -> None:
    strains = Strains(FLOATS, {"t": 0.0})
    x = Jet(strains, ONE, {"t": ONE}, 0.0, 2)
    for text in ("sin(x)", "acos(x)", "atan2(x, x)"):
        with pytest.raises(ValueError, match=r"which energies know of a constant only"):
            Expression(text).apply({"x": x}, JET_FUNCTIONS, strains.number)
    assert JET_FUNCTIONS.keys() == FUNCTIONS.keys()
