"""Every law against its formula, evaluated by mpmath with 60 digits: energy, stress, small strain, volumetric energies.

The registry drives the tests: a new law is tested by its ``example`` and its ``formula``.
"""

from __future__ import annotations

import ctypes
from functools import cache, reduce
from types import SimpleNamespace
from typing import Any, NamedTuple
from unittest import mock

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import CellType, create_unit_cube
from mpmath import mp
from ufl.classes import Variable

from hpcinv.base.parallel.c_code import array_type, compile_library
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.expressions import Expression
from hpcinv.model.assembly.taylor_arrays import TaylorArrays
from hpcinv.model.assembly.taylor_code import LANES, taylor_code
from hpcinv.model.weak_form import LABEL
from hpcinv.physics.kinematics.kinematics import Deformation
from hpcinv.physics.kinematics.staged_derivatives import gradient, remove_stages
from hpcinv.physics.materials import MaterialLaw, laws
from hpcinv.physics.materials.isochoric import DILATATIONS
from hpcinv.physics.points.point_scalars import PointScalars
from hpcinv.physics.points.scalar_graph import NotAnalytic, ScalarGraph
from hpcinv.studies.fitting.homogeneous import Response

DIGITS = 60
SWITCHES = ("max(", "lambda1_bar")  # in laws without a Taylor series: fibres in tension, ordered principal stretches
ORDER = 10  # of the highest coefficient of a Taylor series
STEP = 1e-18  # of mpmath's central differences
POINTS, RADIUS = 24, mp.mpf(2) ** -10  # of the circle around which Taylor coefficients are integrated
THIRDS = np.array([[1, 2, 2], [2, 1, -2], [2, -2, 1]])  # three times the orthonormal directions of fibres
EXAMPLES: dict[str, MaterialLaw] = {name: law.model_validate(law.example) for name, law in laws().items()}
MPMATH = {
    **{name: getattr(mp, name) for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "log", "ln", "sqrt")},
    **{name: getattr(mp, name) for name in ("asin", "acos", "atan", "atan2")},
    "abs": abs,
    "min": min,
    "max": max,
    "norm": lambda *terms: reduce(mp.hypot, terms),
}

of_every_law = pytest.mark.parametrize("name", EXAMPLES)


def rotation(seed: int) -> np.ndarray:
    Q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return Q * np.linalg.det(Q)


def stretch(*stretches: float, seed: int | None = None) -> np.ndarray:
    """``F`` with these principal stretches: along the directions of fibres, or along some, and rotated."""
    if seed is None:
        return THIRDS.T @ np.diag(stretches) @ THIRDS / 9
    return rotation(seed) @ np.diag(stretches) @ rotation(seed + 1)


DEFORMATIONS = {
    "stretched along the first fibres": stretch(1.5, 0.8, 0.9),
    "compressed along the first fibres": stretch(0.7, 1.2, 1.1),
    "all fibres compressed": stretch(0.9, 0.8, 1.3),
    "sheared": np.eye(3) + 0.8 * np.outer(rotation(1)[0], rotation(1)[1]),
    "swollen": 1.3 * np.eye(3),
    "large": stretch(1.5, 1.2, 0.6, seed=2),
    "large in two directions": stretch(1.4, 1.35, 0.55, seed=4),
    "two stretches alike": stretch(1.25, 1.25, 0.7, seed=6),
    "two stretches almost alike": stretch(1.25, 1.25 + 1e-6, 0.7, seed=8),
    "small": stretch(1.03, 0.99, 1.01, seed=10),
}


class State(NamedTuple):
    """What a law gives at one deformation: energy (Pa), ``P = dψ/dF`` (Pa), and the scalars of its domain."""

    energy: float
    P: np.ndarray
    domain: np.ndarray


def parameters(law: MaterialLaw, mesh: Any) -> SimpleNamespace:
    """The parameters of a law as entries of one constant."""
    values = {name: value for name, (value, _) in law.quantities().items() if value is not None}
    symbols = iter(fem.Constant(mesh, np.concatenate([np.atleast_1d(value) for value in values.values()])))
    return SimpleNamespace(
        **{
            name: ufl.as_vector([next(symbols) for _ in value]) if isinstance(value, tuple) else next(symbols)
            for name, value in values.items()
        }
    )


class Compiled:
    """A law as the solver evaluates it, for each choice of its volumetric energy."""

    def __init__(self, law: MaterialLaw) -> None:
        self.law = law
        self.mesh = create_unit_cube(MPI.COMM_SELF, 1, 1, 1, CellType.hexahedron)
        par = parameters(law, self.mesh)
        self.H = fem.Constant(self.mesh, np.zeros((3, 3)))
        H = Variable(self.H, LABEL)
        k = Deformation(H, {f: ufl.as_vector(list(THIRDS[i] / 3)) for i, f in enumerate(law.families)})
        self.choices = list(volumetric_choices(law))
        energies = [law.isochoric_energy(k, par)]
        energies += [other.volumetric_modulus(par) / 2 * other.dilatation(k) ** 2 for other in self.choices]
        parts = [part for psi in energies for part in (psi, *np.ravel(components(ufl.diff(psi, H))))]
        everything = ufl.as_vector([*parts, *law.domain(k, par)])
        self.count = len(energies)
        self.expression = fem.Expression(everything, np.full((1, 3), 0.25))

    def __call__(self, H: np.ndarray, choice: int = 0) -> State:
        self.H.value[:] = H
        values = self.expression.eval(self.mesh, np.array([0], dtype=np.int32)).ravel()
        parts = values[: 10 * self.count].reshape(self.count, 10)
        psi, *P = parts[0] + parts[1 + choice]
        return State(psi, np.reshape(P, (3, 3)), values[10 * self.count :])


def volumetric_choices(law: MaterialLaw) -> list[MaterialLaw]:
    """The law with each volumetric energy, its own first."""
    if "volumetric" not in type(law).model_fields:
        return [law]
    own = law.volumetric  # type: ignore[attr-defined]
    return [law.model_copy(update={"volumetric": v}) for v in sorted(DILATATIONS, key=lambda v: v != own)]


def components(tensor: Any) -> list[list[Any]]:
    return [[tensor[i, j] for j in range(3)] for i in range(3)]


@cache
def compiled(name: str) -> Compiled:
    return Compiled(EXAMPLES[name])


class Reference:
    """A law's ``energy_formula`` in mpmath, from ``F`` by the invariants' definitions."""

    def __init__(self, law: MaterialLaw) -> None:
        self.formula = Expression(law.energy_formula)
        self.parameters: dict[str, Any] = {}
        for name, (value, _) in law.quantities().items():
            entries = {f"{name}{i}": v for i, v in enumerate(value, 1)} if isinstance(value, tuple) else {name: value}
            self.parameters |= {n: mp.mpf(v) for n, v in entries.items() if v is not None}
        with mp.workdps(DIGITS):
            directions = [mp.matrix([int(c) for c in row]) / 3 for row in THIRDS]
        self.fibres = dict(zip(fibre_names(law), directions, strict=False))

    def energy(self, F: Any) -> Any:
        invariants = self.invariants(F)
        return self.formula.apply(invariants | self.parameters, MPMATH, mp.mpf)

    def state(self, H: np.ndarray) -> State:
        """Energy and stress at ``F = I + H``, ``H`` taken as exact."""
        with mp.workdps(DIGITS):
            F = mp.eye(3) + mp.matrix(H.tolist())
            P = [[float(self.slope(F, i, j)) for j in range(3)] for i in range(3)]
            return State(float(self.energy(F)), np.array(P), np.array([]))

    def coefficients(self, path: np.ndarray, D: np.ndarray, order: int) -> list[float]:
        """Taylor coefficients of ``P : D`` along a polynomial path of ``H`` and the parameters, by Cauchy's integral.

        Args:
            path: coefficients by order, of the components of ``H`` and then of the parameters.
        """
        with mp.workdps(2 * DIGITS):
            values, roots, kept = [], mp.unitroots(POINTS), self.parameters
            step = mp.mpf(STEP) ** 2
            way = step * mp.matrix(D.tolist())
            exact = [[mp.mpf(c) for c in row] for row in path.tolist()]
            for root in roots:
                at = [sum(row[i] * (RADIUS * root) ** k for k, row in enumerate(exact)) for i in range(len(exact[0]))]
                F = mp.eye(3) + mp.matrix([at[:3], at[3:6], at[6:9]])
                self.parameters = dict(zip(kept, at[9:], strict=True))
                values.append((self.energy(F + way) - self.energy(F - way)) / (2 * step))
            self.parameters = kept
            return [
                float(mp.re(sum(v * roots[-j * k % POINTS] for j, v in enumerate(values)))) / float(POINTS * RADIUS**k)
                for k in range(order + 1)
            ]

    def slope(self, F: Any, i: int, j: int) -> Any:
        ends = []
        for sign in (1, -1):
            moved = F.copy()
            moved[i, j] += sign * mp.mpf(STEP)
            ends.append(self.energy(moved))
        return (ends[0] - ends[1]) / (2 * mp.mpf(STEP))

    def invariants(self, F: Any) -> dict[str, Any]:
        C, J = F.T * F, determinant(F)
        I1 = C[0, 0] + C[1, 1] + C[2, 2]
        I2 = (I1**2 - sum(c * c for c in C)) / 2
        J13 = mp.cbrt(J)
        invariants = {"I1": I1, "I2": I2, "J": J, "I1_bar": I1 / J13**2, "I2_bar": I2 / J13**4}
        if any(name.startswith("lambda") and name.endswith("_bar") for name in self.formula.names):
            squares = mp.eigsy(C, eigvals_only=True)
            invariants |= {f"lambda{i + 1}_bar": mp.sqrt(squares[i]) / J13 for i in range(3)}
        squared = C * C if self.fibres else None
        for f, a in self.fibres.items():
            invariants |= {f"I4_{f}": (a.T * C * a)[0], f"I5_{f}": (a.T * squared * a)[0]}
            invariants |= {f"I8_{f}_{s}": (a.T * C * b)[0] - (a.T * b)[0] for s, b in self.fibres.items() if s != f}
        return invariants


def determinant(F: Any) -> Any:
    """Return the determinant of a 3 x 3 matrix in less time than mpmath."""
    minors = [F[1, i] * F[2, j] - F[1, j] * F[2, i] for i, j in ((1, 2), (2, 0), (0, 1))]
    return F[0, 0] * minors[0] + F[0, 1] * minors[1] + F[0, 2] * minors[2]


def fibre_names(law: MaterialLaw) -> list[str]:
    """What the law's formula calls each of its families: by the field that names it, and its number in a list."""

    def name(family: str, field: str) -> str:
        match getattr(law, field):
            case tuple() as several:
                return f"{field}{several.index(family) + 1}"
            case str():
                return field
        return family  # a law 'formula', whose energy names it

    return [name(*item) for item in law.families.items()]


def assert_close(computed: State, expected: State, what: str, tolerance: float = 1e-10) -> float:
    """The relative error of the stress, after a check of it and of the energy."""
    error = float(np.linalg.norm(computed.P - expected.P) / np.linalg.norm(expected.P))
    assert error <= tolerance, f"{what}: relative error {error:.1e} of the stress"
    assert computed.energy == pytest.approx(expected.energy, rel=tolerance, abs=0), what
    return error


@pytest.mark.everyday(
    "formula",
    "fung-demiray",
    "gent",
    "isochoric-neo-hookean",
    "mooney-rivlin",
    "neo-hookean",
    "st-venant-kirchhoff",
    "veronda-westmann",
    "yeoh",
)
@of_every_law
def test_energy_and_stress_agree_with_the_formula(name: str) -> None:
    law, reference = compiled(name), Reference(EXAMPLES[name])
    errors = []
    for what, F in DEFORMATIONS.items():
        H = F - np.eye(3)
        response = law(H)
        errors.append(assert_close(response, reference.state(H), what))
        assert (response.domain > 0).all()
    print(f"{name}, moderate deformations: {max(errors):.1e}")


@pytest.mark.everyday(
    "arruda-boyce",
    "formula",
    "fung-demiray",
    "gent",
    "isochoric-neo-hookean",
    "mooney-rivlin",
    "neo-hookean",
    "st-venant-kirchhoff",
    "transversely-isotropic",
    "veronda-westmann",
    "yeoh",
)
@of_every_law
def test_stress_keeps_its_digits_at_small_strain(name: str) -> None:
    law, reference = compiled(name), Reference(EXAMPLES[name])
    direction = np.random.default_rng(12).normal(size=(3, 3))
    errors = []
    for sign in (1, -1):
        for exponent in (-1, -2, -4, -6, -8, -10, -12):
            H = sign * direction / np.linalg.norm(direction) * 10.0**exponent
            errors.append(assert_close(law(H), reference.state(H), f"strain {sign}e{exponent}"))
    print(f"{name}, small strain: {max(errors):.1e}")


@pytest.mark.everyday("hencky", "holzapfel-gasser-ogden", "holzapfel-ogden", "neo-hookean", "yeoh")
@of_every_law
def test_taylor_coefficients_of_stress_agree_with_the_energy(name: str) -> None:
    """``P : D`` where strain and parameters are polynomials: from a moderate strain, and from none."""
    law, reference, mesh = EXAMPLES[name], Reference(EXAMPLES[name]), create_unit_cube(MPI.COMM_SELF, 1, 1, 1)
    par, symbol = parameters(law, mesh), fem.Constant(mesh, np.zeros((3, 3)))
    H = Variable(symbol, LABEL)
    k = Deformation(H, {f: ufl.as_vector(list(THIRDS[i] / 3)) for i, f in enumerate(law.families)})
    psi = law.isochoric_energy(k, par) + law.volumetric_modulus(par) * law.dilatation(k) ** 2 / 2
    graph, entries = ScalarGraph(), [e for e in vars(par).values() for e in (e if e.ufl_shape else [e])]
    varied = [*((symbol, i) for i in range(9)), *((e.ufl_operands[0], int(e.ufl_operands[1][0])) for e in entries)]
    count = len(varied)
    outputs = PointScalars(graph, entries=varied).of(remove_stages(gradient(psi, H)))
    leaves_of = {("constant", *entry): number for number, entry in enumerate(varied)}
    if any(word in law.energy_formula for word in SWITCHES):
        with pytest.raises(NotAnalytic, match="switch"):
            graph.cut(outputs, leaves_of)
        return
    for node, operation in enumerate(graph.operations):
        if operation[0] == "leaf":
            graph.operations[node] = "leaf", leaves_of[operation[1]]
    code = taylor_code(graph, count, outputs)
    sweep = compile_library(MPI.COMM_SELF, code.text).sweep
    doubles, masks = array_type(np.float64), array_type(np.int64)
    sweep.argtypes = [ctypes.c_int64, *2 * [ctypes.c_int], *3 * [doubles], masks, doubles]
    stored, random = ORDER + 1, np.random.default_rng(5)
    numbers = np.array([float(value) for value in reference.parameters.values()])
    changed = numbers * [not parameter.startswith("_") for parameter in reference.parameters]  # not units of formulas
    paths = np.concatenate([random.normal(size=(2, 9)), random.uniform(-1, 1, (2, len(numbers))) * changed], axis=1)
    paths *= np.array([[0.15], [0.05]])  # coefficients of orders 1 and 2
    D, errors = random.normal(size=(3, 3)), []
    for H0 in (0.4 * paths[0, :9], np.zeros(9)):
        leaves, path = np.zeros((1, count, stored, LANES)), np.stack([np.concatenate([H0, numbers]), *paths])
        leaves[0, :, :3] = path.T[..., None]
        kept = np.empty((code.kept, stored, LANES))
        choices, P = np.empty((code.choices, LANES), dtype=np.int64), np.empty((1, 9, LANES))
        expected, series = reference.coefficients(path, D, ORDER), TaylorArrays(graph, outputs).begin(1, stored)
        for order in range(stored):
            sweep(1, stored, order, leaves, np.empty((1, 0, LANES)), kept, choices, P)
            again = series.sweep(order, leaves, np.empty((1, 0, LANES)))
            np.testing.assert_allclose(again, P, rtol=1e-12, atol=1e-14 * np.abs(P).max())
            parts = P[0, :, 0] * D.ravel()
            size = float(np.abs(parts).sum())
            errors.append(abs(float(parts.sum()) - expected[order]) / size if size else abs(expected[order]))
    print(f"{name}, orders 0 to {ORDER}: {max(errors):.1e}")
    assert max(errors) <= 1e-10


@pytest.mark.everyday(
    "formula",
    "fung-demiray",
    "gent",
    "isochoric-neo-hookean",
    "mooney-rivlin",
    "neo-hookean",
    "st-venant-kirchhoff",
    "yeoh",
)
@of_every_law
def test_every_volumetric_energy_agrees_with_its_formula(name: str) -> None:
    law = compiled(name)
    for number, choice in enumerate(law.choices[1:], start=1):
        reference = Reference(choice)
        for what in ("compressed along the first fibres", "swollen", "large", "small"):
            H = DEFORMATIONS[what] - np.eye(3)
            assert_close(law(H, number), reference.state(H), f"{choice.volumetric}, {what}")
        for strain in (1e-5, -1e-10):
            H = strain * DEFORMATIONS["large"]
            assert_close(law(H, number), reference.state(H), f"{choice.volumetric}, strain {strain}")


@of_every_law
def test_stress_in_material_tests_agrees_with_the_solver(name: str) -> None:
    """Principal stresses and their slopes, as 'hpcinv fit' evaluates them."""
    law = compiled(name)
    if law.law.families:
        return
    places = [place for place, number in law.law.numbers().items() if place[0] not in ("young", "poisson")]
    response = Response(law.law, places)
    values = np.array([law.law.numbers()[place].value for place in places])  # type: ignore[union-attr]
    for stretches in ((1.5, 0.8, 0.9), (0.7, 1.2, 1.1), (1.3, 1.3, 0.7)):
        energy = response.energy(np.array([stretches]), values)
        expected = law(np.diag(stretches) - np.eye(3))
        size = np.abs(expected.P).max()
        assert energy.value[0] == pytest.approx(expected.energy, rel=1e-11)
        np.testing.assert_allclose(energy.gradient[0, :3], np.diag(expected.P), rtol=0, atol=1e-12 * size)
        for i, step in enumerate(1e-5 * np.diag(values)):
            ends = [response.energy(np.array([stretches]), values + s * step).gradient[0, :3] for s in (1, -1)]
            slope, change = (ends[0] - ends[1]) / 2, energy.hessian[0, :3, 3 + i] * step[i]
            np.testing.assert_allclose(change, slope, rtol=0, atol=1e-9 * size)


@of_every_law
def test_the_undeformed_body_is_free_of_stress(name: str) -> None:
    law = compiled(name)
    for number in range(len(law.choices)):
        state = law(np.zeros((3, 3)), number)
        assert np.abs(state.P).max() <= 1e-14 * moduli(law.law)[0]
        assert abs(state.energy) <= 1e-14 * moduli(law.law)[0]


@of_every_law
def test_a_rotation_of_space_changes_no_energy_and_turns_the_stress(name: str) -> None:
    law, F, Q = compiled(name), DEFORMATIONS["large"], rotation(14)
    before, after = law(F - np.eye(3)), law(Q @ F - np.eye(3))
    assert np.linalg.norm(before.P) > 0.01 * moduli(law.law)[0]
    assert after.energy == pytest.approx(before.energy, rel=1e-12)
    np.testing.assert_allclose(after.P, Q @ before.P, rtol=0, atol=1e-12 * np.linalg.norm(before.P))


@of_every_law
def test_small_strain_moduli_are_those_that_the_law_states(name: str) -> None:
    """With fibres, moduli of the ground substance: of a shear that does not strain fibres."""
    law = compiled(name)
    mu, kappa = moduli(law.law)
    _, t, n = THIRDS / 3
    strains = [(np.outer(t, n) + np.outer(n, t)) / 2]
    if not law.law.families:
        general = np.random.default_rng(16).normal(size=(3, 3))
        strains += [np.eye(3), (general + general.T) / 2]
    small = 1e-6
    for e in strains:
        slope = (law(small * e).P - law(-small * e).P) / (2 * small)
        dev = e - np.trace(e) / 3 * np.eye(3)
        expected = 2 * mu * dev + kappa * np.trace(e) * np.eye(3)
        np.testing.assert_allclose(slope, expected, rtol=0, atol=1e-8 * np.linalg.norm(expected))


def moduli(law: MaterialLaw) -> tuple[float, float]:
    (par,) = law.cases()
    return float(law.shear_modulus(par)), float(law.bulk_modulus(par))


def extended(I1_minus_3: float) -> np.ndarray:
    """``H`` of an isochoric stretch in one direction with ``I1 = λ² + 2/λ``."""
    largest = np.roots([1, 0, -3 - I1_minus_3, 2]).real.max()
    return stretch(largest, largest**-0.5, largest**-0.5, seed=18) - np.eye(3)


def test_gent_ends_where_its_chains_are_stretched_out() -> None:
    law = compiled("gent")
    jm = EXAMPLES["gent"].jm  # type: ignore[attr-defined]
    for part in (0.5, 0.99, 1.01, 2.0):
        np.testing.assert_allclose(law(extended(part * jm)).domain, [1 - part], atol=1e-12)


def test_one_term_of_ogden_with_exponent_2_is_neo_hookean() -> None:
    ogden = laws()["ogden"].model_validate({"law": "ogden", "mu": ["10 kPa"], "alpha": [2], "kappa": "50 kPa"})
    single, neo_hookean = Compiled(ogden), compiled("isochoric-neo-hookean")
    for what, F in DEFORMATIONS.items():
        assert_close(single(F - np.eye(3)), neo_hookean(F - np.eye(3)), what, 1e-12)


@pytest.mark.parametrize("formula", ["mu/2*(I1 - 3)", "mu/2*I1_bar"])
def test_a_law_whose_formula_is_not_zero_and_free_of_stress_at_rest_is_refused(formula: str) -> None:
    law = EXAMPLES["isochoric-neo-hookean"]
    k = Deformation(ufl.zero(3, 3))
    with mock.patch.object(type(law), "formula", formula), pytest.raises(ValueError, match="not stress-free"):
        law.isochoric_energy(k, SimpleNamespace(mu=1.0))


@pytest.mark.everyday("guccione")
@pytest.mark.parametrize("name", ["guccione", "usyk-mcculloch"])
def test_energy_of_the_isochoric_strain_does_not_see_the_volume(name: str) -> None:
    law = EXAMPLES[name].model_copy(update={"strain": "isochoric"})
    compiled_law, reference, F = Compiled(law), Reference(law), DEFORMATIONS["sheared"]
    for H in (F - np.eye(3), 1e-9 * F):
        assert_close(compiled_law(H), reference.state(H), name)
    formula, by_total_strain = Expression(law.own_formula), Expression(EXAMPLES[name].own_formula)

    def energy(expression: Expression, ratio: float) -> float:
        with mp.workdps(DIGITS):
            scaled = mp.matrix((ratio * F / np.cbrt(np.linalg.det(F))).tolist())
            return float(expression.apply(reference.invariants(scaled) | reference.parameters, MPMATH, mp.mpf))

    assert energy(formula, 1.2) == pytest.approx(energy(formula, 1.0), rel=1e-13)
    assert energy(by_total_strain, 1.0) == pytest.approx(energy(formula, 1.0), rel=1e-13)
    assert energy(by_total_strain, 1.2) > 1.1 * energy(formula, 1.0)


@pytest.mark.release
def test_usyk_mcculloch_of_equal_exponents_across_the_fibres_is_guccione() -> None:
    shared = {"c": "2 kPa", "b_f": 8, "b_fs": 4, "kappa": "10 kPa"}
    guccione = Compiled(laws()["guccione"].model_validate({"law": "guccione", "b_t": 2, **shared}))
    across = {"b_s": 2, "b_n": 2, "b_sn": 2, "b_fn": 4}
    orthotropic = Compiled(laws()["usyk-mcculloch"].model_validate({"law": "usyk-mcculloch", **shared, **across}))
    for what, F in DEFORMATIONS.items():
        assert_close(orthotropic(F - np.eye(3)), guccione(F - np.eye(3)), what, 1e-12)


def test_sheets_of_usyk_mcculloch_lie_across_the_fibres() -> None:
    """The directions of sheets and fibres span the sheet, as deformed ones do that are carried back."""
    straight = compiled("usyk-mcculloch")
    oblique = np.array([THIRDS[0], THIRDS[1] + 0.8 * THIRDS[0]]) / 3
    with mock.patch(f"{__name__}.THIRDS", 3 * oblique / np.linalg.norm(oblique, axis=1, keepdims=True)):
        inclined = Compiled(EXAMPLES["usyk-mcculloch"])
    for what, F in DEFORMATIONS.items():
        assert_close(inclined(F - np.eye(3)), straight(F - np.eye(3)), what, 1e-12)
