"""Parameters that fit tests equally well: found for each law, said with the test that decides, one preferred."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hpcinv.__main__ import main
from hpcinv.physics.materials import laws
from hpcinv.studies.fitting.candidate import Candidate, candidate
from hpcinv.studies.fitting.equal_optima import Predictions
from hpcinv.studies.fitting.homogeneous import MODES, Response
from hpcinv.studies.fitting.least_squares import FitError, _LeastSquares, fit
from hpcinv.studies.fitting.measurements import Test

Test.__test__ = False  # type: ignore[attr-defined]  # pytest must not collect it
MEASURES = {"simple-shear": np.linspace(0.2, 1.2, 7), "planar": np.linspace(1.1, 1.8, 7)}
ISOTROPIC = [name for name, law in laws().items() if not law.model_validate(law.example).families]


def exact(law: Candidate, mode: str) -> Test:
    """A test without errors of a law with its starting values."""
    stress, _ = Response(law.law, []).stress(MODES[mode], MEASURES[mode], np.zeros(0))
    return Test(mode, MODES[mode], MEASURES[mode], stress)


def with_one_term(name: str, *, compressible: bool = False) -> Candidate:
    terms = ":1" if name == "ogden" else ""
    return candidate(name + terms, {}, compressible=compressible or name == "st-venant-kirchhoff")


@pytest.mark.parametrize("mode", MEASURES)
@pytest.mark.parametrize("law", ISOTROPIC)
def test_true_parameters_are_among_the_equally_good_ones(law: str, mode: str) -> None:
    """In all tests that were not made, unless the tests are said not to determine the parameters."""
    truth = with_one_term(law)
    test = exact(truth, mode)
    try:
        found = fit(truth, [test])
    except FitError as error:
        if not any(text in str(error) for text in ("do not separate", "do not depend", "no values were found")):
            raise
        return
    predictions = Predictions(found.response, [test])
    expected, _ = predictions.of(truth.start)
    differences = [
        np.nanmax(np.abs(predictions.of(values)[0] - expected)) / np.nanmax(np.abs(expected))
        for values in (found.values, *found.rivals)
    ]
    assert min(differences) < 1e-4
    assert bool(found.rivals) == bool(found.disagreements)


@pytest.mark.everyday("planar--2.3")
@pytest.mark.parametrize("alpha", [2.3, -2.3])
@pytest.mark.parametrize("mode", MEASURES)
def test_mirrored_ogden_is_said_in_shear_and_planar_tension(mode: str, alpha: float) -> None:
    """(μ, α) and (-μ, -α) have the same stress there; rubber has α near 2, which is preferred."""
    values = f"mu: [{np.copysign(0.4, alpha)} MPa], alpha: [{alpha}]"
    law = candidate(f"{{law: ogden, {values}, kappa: incompressible}}", {}, compressible=False)
    found = fit(law, [exact(law, mode)])
    assert found.values == pytest.approx([0.4e6, 2.3], rel=1e-5)
    assert [list(v) for v in found.rivals] == [pytest.approx([-0.4e6, -2.3], rel=1e-5)]
    tension = next(d for d in found.disagreements if d.probe.name == "uniaxial tension")
    stretch = tension.measure
    nominal = [0.4e6 * (stretch ** (a - 1) - stretch ** (-a / 2 - 1)) * np.sign(a) for a in (2.3, -2.3)]
    assert tension.stress == pytest.approx(nominal, rel=1e-5)
    shares = [d.share for d in found.disagreements]
    assert shares == sorted(shares, reverse=True)


@pytest.mark.release
def test_a_second_mode_decides() -> None:
    law = with_one_term("ogden")
    found = fit(law, [exact(law, mode) for mode in MEASURES])
    assert found.rivals
    stretch = np.linspace(1.1, 1.8, 7)
    stress, _ = Response(law.law, []).stress(MODES["uniaxial"], stretch, np.zeros(0))
    decided = fit(law, [exact(law, "planar"), Test("uniaxial", MODES["uniaxial"], stretch, stress)])
    assert not decided.rivals
    assert decided.values == pytest.approx(law.start, rel=1e-5)


def test_bulk_moduli_that_fit_planar_tension_equally_well_are_said() -> None:
    """A compressible law has a second optimum there, although it is linear in its parameters."""
    law = with_one_term("isochoric-neo-hookean", compressible=True)
    test = exact(law, "planar")
    scatter = 1 + 1e-3 * (-1.0) ** np.arange(len(test))
    found = fit(law, [Test("planar", test.mode, test.measure, test.stress * scatter)])
    assert found.values == pytest.approx(law.start, rel=0.05)
    (other,) = found.rivals
    assert other[0] < found.values[0] / 10
    assert found.disagreements[0].probe.name == "change of volume"


@pytest.mark.everyday("0.0")
@pytest.mark.parametrize("scatter", [0.0, 1e-5])
def test_points_of_a_flat_valley_are_rivals_only_within_the_scatter(scatter: float) -> None:
    """Two terms of Ogden's law, compressible, in planar tension: iterations go on for thousands of steps to the truth.

    On the way, residuals of 6e-6 and 1.2e-5 of the stress are far above the ones of exact data.
    """
    law = candidate("ogden:2", {}, compressible=True)
    test = exact(law, "planar")
    stress = test.stress * (1 + scatter * (-1.0) ** np.arange(len(test)))
    problem = _LeastSquares(law, [Test("planar", test.mode, test.measure, stress)])
    on_the_way = [[1.839e6, 1.246e5, 1.0e6, 2.239, 0.5589], [1.441e6, 1.893e5, -6.697e5, 2.039, -0.7432]]
    best, *others = (problem.solved(np.array(values), 3) for values in (law.start, *on_the_way))
    assert best is not None
    for other, residual in zip(others, (6.3e-6, 1.2e-5), strict=True):
        assert other is not None
        assert other.status == 0  # not converged
        assert np.sqrt((other.fun**2).mean()) == pytest.approx(residual, rel=0.1) or scatter
    found = problem.conclude(problem.equally_good(best, [other for other in others if other is not None]))
    assert bool(found.rivals) == bool(scatter)
    if not scatter:
        assert found.values == pytest.approx(law.start, rel=1e-6)


def test_command_names_the_rival_and_the_test_that_decides(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    law = with_one_term("ogden")
    test = exact(law, "simple-shear")
    rows = [f"{shear},{stress!r}" for shear, stress in zip(test.measure, test.stress.tolist(), strict=True)]
    table, output = tmp_path / "shear.csv", tmp_path / "fit.json"
    table.write_text("\n".join(["# mode: simple-shear", "amount of shear [-], shear stress [Pa]", *rows]))
    assert main(["fit", str(table), "--law", "ogden:1", "--output", str(output)]) == 0
    printed, warned = capsys.readouterr()
    assert "equally good: mu[0] = -0.63 MPa, alpha[0] = -1.3" in printed
    assert "another set fits these tests equally well" in warned
    assert "a test in equibiaxial tension decides" in warned
    data: dict[str, Any] = json.loads(output.read_text())["laws"][0]
    assert data["equally_good"] == [pytest.approx({"material.mu[0]": -0.63e6, "material.alpha[0]": -1.3})]
    assert data["disagreements"][0]["test"] == "equibiaxial tension"
