"""The two programs of the page on learning: small ones by SciPy, and whole ones by PyTorch."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from helpers.command_line import ROOT
from helpers.learning import PACKAGES
from helpers.other_packages import run_with
from scipy.optimize import minimize

PROGRAMS = ROOT / "docs" / "learning"


def program(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, PROGRAMS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_moduli_of_cells_from_a_rest_shape(tmp_path: Path) -> None:
    problem = program("moduli").Problem(tmp_path, (3, 2, 2))
    assert problem.neighbours.shape == (8 + 6 + 6, 2)

    def misfit(logarithms: np.ndarray) -> tuple[float, np.ndarray]:
        value, gradient = problem.misfit(np.exp(logarithms), problem.observed)
        return value, gradient * np.exp(logarithms)

    found = minimize(
        misfit, np.full(12, np.log(7.0)), jac=True, method="L-BFGS-B", options={"maxiter": 40, "ftol": 1e-6}
    )
    assert misfit(np.full(12, np.log(7.0)))[0] > 1e4
    assert found.fun < 1e-2  # displacements are within a hundredth of the noise
    error = np.abs(found.x - np.log(problem.truth))
    smallest = np.linalg.svd(problem.slopes(), compute_uv=False)[-1] / 2e-5
    assert np.linalg.norm(error) < 2 * np.sqrt(2 * found.fun) / smallest + 1e-6


def test_a_loaded_shape_whose_rest_shape_is_round() -> None:
    problem = program("round_dome").Problem(1, 2)
    begin = np.zeros(len(problem.start))

    def unevenness(percent: np.ndarray) -> tuple[float, np.ndarray]:
        value, gradient = problem.roundness(percent / 100)
        return value, gradient / 100

    found = minimize(unevenness, begin, jac=True, method="L-BFGS-B", options={"maxiter": 20})
    assert unevenness(begin)[0] > 10
    assert found.fun < 1e-4
    radii = problem.radii_at_rest(found.x / 100)
    assert np.ptp(radii[problem.layers == 1]) < 0.02  # mm, of 6


@pytest.mark.release
@pytest.mark.parametrize(
    ("name", "pattern", "most"),
    [
        ("round_dome", r"found shape: .* off by (\S+) mm", 1e-4),
        ("moduli", r"without noise: median error (\S+) %", 10.0),
    ],
)
def test_whole_programs_with_pytorch(name: str, pattern: str, most: float, tmp_path: Path) -> None:
    picture = tmp_path / "picture.png"
    printed = run_with([PACKAGES["torch"]], "python", str(PROGRAMS / f"{name}.py"), str(picture))
    (figure,) = re.findall(pattern, printed)
    assert float(figure) < most
    assert picture.stat().st_size > 10_000
