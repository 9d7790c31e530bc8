"""Sobol indices against closed forms and scipy's estimates, and the command on records that are made up."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.stats
from helpers.sweeps import finish, write_sweep
from scipy.stats import qmc

from hpcinv.__main__ import main
from hpcinv.mesh.io.vtu import read_vtu
from hpcinv.mesh.mesh_files import save
from hpcinv.mesh.source import Floats, MeshSource
from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.ledger.holder import Holder
from hpcinv.studies.batch.ledger.ledger import Ledger, ledger_of
from hpcinv.studies.batch.sampling import Distribution
from hpcinv.studies.sweep.chaos import Indices, Regression, exponents, mean, polynomials, sobol_indices, terms
from hpcinv.studies.sweep.sweep_plan import SweepPlan, load_sweep

MU, LAM, DENSITY = "material.mu", "material.lam", "effects[0].density"


def cube(count: int, parameters: int, seed: int = 1) -> Floats:
    """Points of a Sobol sample in [-1, 1]."""
    points: Floats = 2 * qmc.Sobol(parameters, rng=seed).random(count) - 1
    return points


def indices_of(points: Floats, normal: list[bool], values: Floats) -> Indices:
    regression = Regression(points, normal)
    column = values[:, None]
    return sobol_indices(regression, regression.fit(column), column, 0.95)


# The surrogate


def test_polynomials_are_orthonormal() -> None:
    """By Gaussian quadrature of the two weights, which is exact here."""
    powers = exponents(2, 5)
    assert len(powers) == terms(2, 5) == 21
    x, wx = np.polynomial.legendre.leggauss(8)
    z, wz = np.polynomial.hermite_e.hermegauss(8)
    points = np.array([(a, b) for a in x for b in z])
    weights = np.array([a * b for a in wx / wx.sum() for b in wz / wz.sum()])
    products = polynomials(points, [False, True], powers)
    np.testing.assert_allclose((products * weights[:, None]).T @ products, np.eye(21), atol=1e-12)


def test_leave_one_out_errors_agree_with_fits_without_each_case() -> None:
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.uniform(-1, 1, 40), rng.standard_normal(40)])
    values = np.exp(points[:, :1] + 0.3 * points[:, 1:]) + 0.1 * rng.standard_normal((40, 1))
    surrogate = Regression(points, [False, True]).fit(values)
    assert surrogate.degree >= 1
    design = polynomials(points, [False, True], surrogate.powers)
    for i in range(40):
        others = np.arange(40) != i
        coefficients = np.linalg.lstsq(design[others], values[others], rcond=None)[0]
        np.testing.assert_allclose(surrogate.errors[i], values[i] - design[i] @ coefficients, rtol=1e-8, atol=1e-12)


def test_a_polynomial_is_found_whatever_the_sample() -> None:
    """Its degree, its values, and its indices by hand: 1 + 2x + 3xy with x, y in [-1, 1] has variance 4/3 + 1."""
    points = np.random.default_rng(5).uniform(-1, 1, (30, 2))
    values = 1 + 2 * points[:, 0] + 3 * points[:, 0] * points[:, 1]
    regression = Regression(points, [False, False])
    surrogate = regression.fit(values[:, None])
    other = np.array([[0.3, -0.7], [1.0, 1.0]])
    np.testing.assert_allclose(surrogate.predict(other, [False, False])[:, 0], [1.6 - 0.63, 6.0], rtol=1e-12)
    indices = indices_of(points, [False, False], values)
    assert indices.q2 == pytest.approx(1)
    assert indices.decided
    assert [i.value for i in indices.first] == pytest.approx([(4 / 3) / (7 / 3), 0], abs=1e-12)
    assert [i.value for i in indices.total] == pytest.approx([1, 1 / (7 / 3)])
    assert indices.interactions == pytest.approx(1 / (7 / 3))
    assert indices.sd.value == pytest.approx(math.sqrt(7 / 3))
    assert mean(regression, surrogate, 0.95).value == pytest.approx(1)


# Closed forms


def test_a_linear_quantity_has_the_shares_of_its_variances() -> None:
    """Three kinds of parameters; with one of no influence."""
    distributions = [
        Distribution("normal", 10.0, 2.0),
        Distribution("uniform", -1.0, 5.0),
        Distribution("normal", 0.0, 7.0),
    ]
    shares = qmc.Sobol(3, rng=2).random(32)
    drawn = [[d.quantile(share) for d, share in zip(distributions, row, strict=True)] for row in shares.tolist()]
    points = np.array([[d.standard(v) for d, v in zip(distributions, row, strict=True)] for row in drawn])
    values = np.array([3 * a - 4 * b for a, b, _ in drawn])
    variances = np.array([9 * 4, 16 * 36 / 12, 0])
    indices = indices_of(points, [True, False, True], values)
    assert indices.degree == 1
    for parts in (indices.first, indices.total):
        np.testing.assert_allclose([i.value for i in parts], variances / variances.sum(), atol=1e-10)
    assert indices.sd.value == pytest.approx(math.sqrt(variances.sum()))


def test_ishigami() -> None:
    """Ishigami & Homma (1990), doi:10.1109/ISUMA.1990.151285: sin x + 7 sin² y + 0.1 z⁴ sin x."""
    a, b = 7.0, 0.1
    v1, v2, v13 = (1 + b * math.pi**4 / 5) ** 2 / 2, a**2 / 8, b**2 * math.pi**8 * (1 / 18 - 1 / 50)
    v = v1 + v2 + v13
    first, total = [v1 / v, v2 / v, 0.0], [(v1 + v13) / v, v2 / v, v13 / v]
    points = cube(512, 3)
    x, y, z = math.pi * points.T
    indices = indices_of(points, [False] * 3, np.sin(x) + a * np.sin(y) ** 2 + b * z**4 * np.sin(x))
    assert indices.q2 > 0.99
    assert indices.decided
    assert math.sqrt(v) == pytest.approx(indices.sd.value, rel=0.005)
    for index, exact in zip((*indices.first, *indices.total), (*first, *total), strict=True):
        assert index.value == pytest.approx(exact, abs=0.005)
        assert index.low <= exact <= index.high
        assert index.high - index.low < 0.03
    few = indices_of(points[:64], [False] * 3, (np.sin(x) + a * np.sin(y) ** 2 + b * z**4 * np.sin(x))[:64])
    assert not few.decided


def test_a_product_of_lognormal_factors() -> None:
    """exp(Σ sᵢ zᵢ): with vᵢ = exp(sᵢ²) - 1, V = Π (1 + vᵢ) - 1, Sᵢ = vᵢ / V, Tᵢ = vᵢ Π_{j≠i} (1 + vⱼ) / V."""
    s = np.array([0.3, 0.2, 0.1])
    v = np.expm1(s**2)
    whole = np.prod(1 + v) - 1
    points = scipy.stats.norm.ppf(qmc.Sobol(3, rng=4).random(256))
    indices = indices_of(points, [True] * 3, np.exp(points @ s))
    np.testing.assert_allclose([i.value for i in indices.first], v / whole, atol=1e-3)
    np.testing.assert_allclose([i.value for i in indices.total], v * np.prod(1 + v) / (1 + v) / whole, atol=1e-3)


def test_scipy_estimates_the_same_indices() -> None:
    """Without a closed form, of mixed distributions: scipy's estimates from 2^14 × 5 evaluations."""
    distributions = [
        Distribution("log-uniform", 1.0, 4.0),
        Distribution("normal", 2.0, 0.3),
        Distribution("uniform", 0, 1),
    ]

    def f(x: Floats) -> Floats:
        value: Floats = x[1] ** 2 / x[0] + np.cos(2 * x[2]) * x[1]
        return value

    known = [scipy.stats.loguniform(1, 4), scipy.stats.norm(2, 0.3), scipy.stats.uniform()]
    expected = scipy.stats.sobol_indices(func=f, n=2**14, dists=known, rng=1)
    shares = qmc.Sobol(3, rng=6).random(256)
    drawn = [[d.quantile(share) for d, share in zip(distributions, row, strict=True)] for row in shares.tolist()]
    points = np.array([[d.standard(v) for d, v in zip(distributions, row, strict=True)] for row in drawn])
    indices = indices_of(points, [False, True, False], f(np.array(drawn).T))
    np.testing.assert_allclose([i.value for i in indices.first], expected.first_order, atol=0.01)
    np.testing.assert_allclose([i.value for i in indices.total], expected.total_order, atol=0.01)


@pytest.mark.release
@pytest.mark.parametrize("kind", ["kinks", "noise"])
def test_intervals_contain_the_indices_as_often_as_they_say(kind: str) -> None:
    """95 % of 100 random samples, of a quantity with kinks, Π (1 + cᵢ |xᵢ|), and of a linear one with noise.

    With variances vᵢ = (cᵢ²/12) / (1 + cᵢ/2)² of the factors, relative to their means, the indices follow as for any
    product. With a coverage of 95 %, less than 89 of 100 have a probability below 1 %.
    """
    rng = np.random.default_rng(7)
    c = np.array([1.0, 0.5])
    v = (c**2 / 12) / (1 + c / 2) ** 2 if kind == "kinks" else c**2
    whole = np.prod(1 + v) - 1 if kind == "kinks" else np.sum(v)
    other = np.prod(1 + v) / (1 + v) if kind == "kinks" else 1.0
    exact = np.array([*(v / whole), *(v * other / whole)])
    inside = []
    for _ in range(100):
        points = rng.uniform(-1, 1, (50, 2))
        values = points @ c + 0.1 * rng.standard_normal(50)
        if kind == "kinks":
            values = np.prod(1 + c * np.abs(points), axis=1)
        indices = indices_of(points, [False] * 2, values)
        intervals = np.array([*indices.first, *indices.total])
        inside.append((intervals[:, 1] <= exact) & (exact <= intervals[:, 2]))
    coverage = np.mean(inside, axis=0)
    print(kind, coverage)
    assert np.all(coverage >= 0.89)


@pytest.mark.release
def test_intervals_that_a_long_tail_makes_too_narrow_are_reported() -> None:
    """Indices of exp(0.8 z₁ + 0.5 z₂), a product of lognormal factors."""
    rng = np.random.default_rng(11)
    s = np.array([0.8, 0.5])
    v = np.expm1(s**2)
    whole = np.prod(1 + v) - 1
    exact = np.array([*(v / whole), *(v * np.prod(1 + v) / (1 + v) / whole)])
    inside, message = [], []
    for _ in range(100):
        points = rng.standard_normal((60, 2))
        indices = indices_of(points, [True] * 2, np.exp(points @ s))
        intervals = np.array([*indices.first, *indices.total])
        inside.append((intervals[:, 1] <= exact) & (exact <= intervals[:, 2]))
        message.append(indices.has_long_tail)
    print("long tail", np.mean(inside, axis=0), np.mean(message))
    assert np.mean(message) > 0.9
    uniform = rng.uniform(-1, 1, (60, 2))
    assert not indices_of(uniform, [False] * 2, uniform @ s).has_long_tail


def test_noise_is_not_decided() -> None:
    points = cube(64, 2)
    indices = indices_of(points, [False] * 2, np.random.default_rng(8).standard_normal(64))
    assert not indices.decided
    assert indices.q2 < 0.3


# The command


def draw(directory: Path, count: int = 32, *more: dict[str, Any], kind: str = "sobol") -> SweepPlan:
    sample = {MU: {"normal": ["10 kPa", "500 Pa"]}, DENSITY: ["150 kg/m^3", "250 kg/m^3"]}
    return load_sweep(write_sweep(directory, [{kind: sample, "count": count}, *more]))


@pytest.fixture
def solve(tmp_path: Path) -> Callable[..., None]:
    """Put records of made-up quantities in the store; cases without quantities have failed."""

    def done(plan: SweepPlan, quantities: Callable[[float, float], dict[str, Any]], first: int | None = None) -> None:
        with Holder(tmp_path / "store") as holder:
            ledger = Ledger(tmp_path / "store", holder)
            for case in plan.cases[:first]:
                values = quantities(case.parameters[MU], case.parameters[DENSITY])
                statistics = {"quantities": values, "certificate": {"verdict": "pass", "estimate": None}}
                record = CaseRecord(
                    "converged" if values else "no equilibrium", "", statistics if values else {}, 2.0, 1
                )
                finish(ledger, case.key, record)

    return done


def linear(mu: float, density: float) -> dict[str, Any]:
    """Of variances (2 · 500)² and (30 · 100)² / 12, one that is constant, and a vector."""
    return {"top": 2 * mu + 30 * density, "same": 4.5, "where": [mu, 0.0, -density]}


def test_the_command_prints_indices_of_every_quantity(
    tmp_path: Path, solve: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    plan = draw(tmp_path)
    solve(plan, lambda mu, density: {} if density > 247 else linear(mu, density))
    failed = [case.number for case in plan.cases if case.parameters[DENSITY] > 247]
    assert failed
    output = tmp_path / "new" / "indices.json"
    assert main(["sweep", "indices", str(plan.path), "--output", str(output)]) == 0
    text = capsys.readouterr().out
    assert f"{32 - len(failed)} of 32 cases, sobol sample of {MU} (normal), {DENSITY} (uniform)" in text
    assert f"left out: {len(failed)} failed: no equilibrium: case {failed[0]}" in text
    assert "same: constant, 4.5 in all 31 cases" in text
    assert "where[1]: constant" in text
    data = json.loads(output.read_text())
    shares = np.array([1000.0**2, 3000.0**2 / 12])
    for key, share in zip((MU, DENSITY), shares / shares.sum(), strict=True):
        assert data["quantities"]["top"]["indices"][key]["total"]["value"] == pytest.approx(share)
    assert data["quantities"]["top"]["mean"]["value"] == pytest.approx(26000)
    assert data["quantities"]["top"]["standard_deviation"]["value"] == pytest.approx(math.sqrt(shares.sum()))
    assert data["quantities"]["where[0]"]["indices"][MU]["first"]["value"] == pytest.approx(1)


def test_a_quantity_that_the_parameters_do_not_explain_is_not_decided(
    tmp_path: Path, solve: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    plan = draw(tmp_path)
    solve(plan, lambda mu, density: {"top": math.sin(1e4 * mu * density)})
    assert main(["sweep", "indices", str(plan.path)]) == 0
    text = capsys.readouterr().out
    assert "top: not decided" in text
    assert "more cases" in text
    assert "interactions" not in text


@pytest.mark.parametrize(("kind", "left"), [("sobol", 20 - 6), ("random", 20 - 6), ("latin_hypercube", 20)])
def test_the_cost_is_reported_before_the_sweep(
    kind: str, left: int, tmp_path: Path, solve: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    plan = draw(tmp_path, 16, kind=kind)
    command = ["sweep", "indices", str(plan.path), "--plan"]
    assert main(command) == 0
    assert "run some by 'sweep run --first 8'" in capsys.readouterr().out
    solve(plan, linear, first=6)
    assert main(command) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert lines[3] == ["2", "6", "12", "6", "12", "s"]
    assert lines[4] == ["3", "10", "20", str(left), str(2 * left), "s"]


def test_a_sweep_that_is_not_finished_is_refused(
    tmp_path: Path, solve: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    plan = draw(tmp_path, 16)
    solve(plan, linear, first=8)
    assert main(["sweep", "indices", str(plan.path)]) == 2
    assert "8 of 16 cases are not finished" in capsys.readouterr().err
    assert main(["sweep", "indices", str(plan.path), "--first", "8"]) == 0
    assert main(["sweep", "indices", str(plan.path), "--first", "4"]) == 2
    assert "4 cases have converged, but a surrogate of degree 1 in 2 parameters needs 6" in capsys.readouterr().err


def test_shapes_that_were_not_kept(
    tmp_path: Path, solve: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    plan = draw(tmp_path, 16)
    solve(plan, linear)
    shape = tmp_path / "spread.vtu"
    assert main(["sweep", "indices", str(plan.path), "--shape", str(shape)]) == 2
    assert "16 of 16 cases have kept no shape" in (message := capsys.readouterr().err)
    assert "set: {output: {mesh: [vtu]}}" in message
    assert "another 'store'" in message
    assert not shape.exists()


TETRAHEDRON = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


def keep_shapes(plan: SweepPlan, position: Callable[[float, float], Floats]) -> None:
    """Put a tetrahedron next to the record of each case, in mm."""
    ledger = ledger_of(plan.store)
    for case in plan.cases:
        points = position(case.parameters[MU], case.parameters[DENSITY])
        none = np.zeros((0, 3), dtype=np.int64)
        tags, cells = np.arange(1, len(points) + 1), np.arange(4)[None]
        source = MeshSource(Path("a.vtu"), "tetrahedron", 1, points, tags, cells, np.array([1]), none, unit=1e-3)
        path = ledger.directory(case.key) / "run-1-1" / "shape.vtu"
        path.parent.mkdir(parents=True)
        save(path, source, points)


def test_the_spread_of_a_shape(tmp_path: Path, solve: Callable[..., None], capsys: pytest.CaptureFixture[str]) -> None:
    """Node 1 moves with one parameter, node 3 with both in different directions, the others not at all."""

    def position(mu: float, density: float) -> Floats:
        mesh_read = TETRAHEDRON.copy()
        mesh_read[1, 1] += 1e-5 * mu
        mesh_read[3] += [2e-5 * mu, 0.0, 1e-3 * density]
        return mesh_read

    plan = draw(tmp_path, 16)
    solve(plan, linear)
    keep_shapes(plan, position)
    shape = tmp_path / "spread.vtu"
    assert main(["sweep", "indices", str(plan.path), "--shape", str(shape)]) == 0
    assert "largest standard deviation of a node 0.03055 m" in capsys.readouterr().out
    mesh_read = read_vtu(shape)
    of_mu, of_density = (2e-5 * 500) ** 2, (1e-3 * 100) ** 2 / 12
    values = {name: array.values[:, 0] for name, array in mesh_read.data.items()}
    np.testing.assert_allclose(values["sd"], [0, 5e-3, 0, math.sqrt(of_mu + of_density)], atol=1e-12)
    np.testing.assert_allclose(values[f"total index of {MU}"][[1, 3]], [1, of_mu / (of_mu + of_density)])
    assert np.isnan(values[f"first-order index of {DENSITY}"][[0, 2]]).all()
    assert values["dominating parameter"].tolist() == [-1, 0, -1, 1]
    np.testing.assert_allclose(mesh_read.points * 1e-3, position(1e4, 200.0), atol=1e-12)


def test_a_shape_that_does_not_change(
    tmp_path: Path, solve: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    plan = draw(tmp_path, 16)
    solve(plan, linear)
    keep_shapes(plan, lambda mu, density: TETRAHEDRON)
    assert main(["sweep", "indices", str(plan.path), "--shape", str(tmp_path / "spread.vtu")]) == 0
    assert "shape: the same in all cases" in capsys.readouterr().out


def test_shapes_of_different_meshes(
    tmp_path: Path, solve: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    plan = draw(tmp_path, 16)
    solve(plan, linear)
    keep_shapes(plan, lambda mu, density: TETRAHEDRON if density < 240 else np.vstack([TETRAHEDRON, [[1, 1, 1]]]))
    assert main(["sweep", "indices", str(plan.path), "--shape", str(tmp_path / "spread.vtu")]) == 2
    assert "have different meshes" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("axes", "fault"),
    [
        ([{"grid": {MU: [1e4, 2e4]}}], "axes[0]: is a grid, whose points have no probability"),
        ([{"grid": {MU: [1e4, 2e4]}}], "no axis is a sample"),
        ([{"sobol": {MU: [1e4, 2e4]}, "count": 8}, {"zip": {LAM: [1e4, 2e4]}}], "axes[1]: is a zip"),
        (
            [{"sobol": {MU: [1e4, 2e4]}, "count": 8}, {"branches": {"a": {"set": {LAM: 2e4}}}}],
            "axes[1]: has branches",
        ),
        (
            [{"sobol": {MU: [1e4, 2e4]}, "count": 8}, {"random": {LAM: [1e4, 2e4]}, "count": 2}],
            "axes[0] and axes[1] are samples that are combined",
        ),
    ],
)
@pytest.mark.parametrize("option", [(), ("--plan",)])
def test_indices_are_refused_for_unsuitable_axes(
    axes: list[dict[str, Any]],
    fault: str,
    option: tuple[str, ...],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = write_sweep(tmp_path, axes)
    assert main(["sweep", "indices", str(path), *option]) == 2
    assert fault in capsys.readouterr().err


def test_an_axis_of_one_point_is_a_constant(tmp_path: Path, solve: Callable[..., None]) -> None:
    plan = draw(tmp_path, 16, {"grid": {LAM: ["50 kPa"]}})
    solve(plan, linear)
    assert main(["sweep", "indices", str(plan.path)]) == 0


@pytest.mark.parametrize("option", [("--output", "a.csv"), ("--shape", "a.msh"), ("--confidence", "95")])
def test_options_that_are_wrong(option: tuple[str, str], tmp_path: Path) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["sweep", "indices", str(tmp_path / "sweep.yaml"), *option])
    assert ended.value.code == 2
