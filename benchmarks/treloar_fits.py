"""Starting values of rubber for isotropic laws: least-squares fits to Treloar's uniaxial test of vulcanized rubber.

Run: ``python benchmarks/treloar_fits.py``. It prints what stands in the laws as ``starting_values``.

The data are nominal stresses of Treloar (1944), "Stress-strain data for vulcanised rubber under various types of
deformation", doi:10.1039/TF9444000059. The stress of an incompressible material in this test is ``dpsi/dlambda`` with
``lambda2 = lambda3 = lambda^(-1/2)``, here by central differences of the law's printed formula.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import least_squares

from hpcinv.materials import laws
from hpcinv.quantity.expressions import Expression

KGF_PER_CM2 = 98066.5  # Pa
# Stretch, and nominal stress in kgf/cm².
# fmt: off
DATA = np.array([
    [1.02, 0.26], [1.125, 1.37], [1.24, 2.3], [1.39, 3.23], [1.585, 4.16], [1.9, 5.1],
    [2.18, 6.0], [2.42, 6.9], [3.02, 8.8], [3.57, 10.7], [4.03, 12.5], [4.76, 16.2],
    [5.36, 19.9], [5.75, 23.6], [6.15, 27.4], [6.4, 31.0], [6.6, 34.8], [6.85, 38.5],
    [7.05, 42.1], [7.15, 45.8], [7.25, 49.6], [7.4, 53.3], [7.5, 57.0], [7.6, 64.4],
])
# fmt: on
STRETCHES, STRESSES = DATA[:, 0], KGF_PER_CM2 * DATA[:, 1]
# Law, parameters with a first guess (Pa or none), and the largest stretch that the law can follow.
FITS: list[tuple[str, dict[str, float], float]] = [
    ("isochoric-neo-hookean", {"mu": 0.4e6}, 3.0),
    ("mooney-rivlin", {"c1": 0.15e6, "c2": 0.02e6}, 4.0),
    ("yeoh", {"c1": 0.2e6, "c2": -1e3, "c3": 30.0}, 7.6),
    ("gent", {"mu": 0.3e6, "jm": 80.0}, 7.6),
    ("arruda-boyce", {"mu": 0.3e6, "lambda_m": 5.0}, 7.6),
]


def energy(formula: Expression, stretch: float, parameters: dict[str, float]) -> float:
    """Energy (Pa) in uniaxial tension of an incompressible body."""
    invariants = {"I1_bar": stretch**2 + 2 / stretch, "I2_bar": 2 * stretch + stretch**-2}
    names = invariants | parameters
    return float(formula.evaluate(**{name: value for name, value in names.items() if name in formula.names}))


def stress(formula: Expression, stretch: float, parameters: dict[str, float]) -> float:
    """Nominal stress in Pa."""
    step = 1e-5 * stretch
    return (energy(formula, stretch + step, parameters) - energy(formula, stretch - step, parameters)) / (2 * step)


def fit(name: str, guess: dict[str, float], largest: float) -> tuple[dict[str, float], float]:
    """The parameters with the least relative error, and that error (root of the mean square)."""
    formula, used = Expression(laws()[name].formula), largest >= STRETCHES

    def misfit(scaled: Any) -> Any:
        parameters = {key: value * s for (key, value), s in zip(guess.items(), scaled, strict=True)}
        found = np.array([stress(formula, stretch, parameters) for stretch in STRETCHES[used]])
        return found / STRESSES[used] - 1

    # Gent's law has no stress beyond its limit: keep to values of jm for which all of the data are within it.
    lowest = np.array([0.75 if key == "jm" else -np.inf for key in guess])
    found = least_squares(misfit, np.ones(len(guess)), bounds=(lowest, np.inf))
    fitted = {key: value * s for (key, value), s in zip(guess.items(), found.x, strict=True)}
    return fitted, float(np.sqrt(np.mean(found.fun**2)))


if __name__ == "__main__":
    for name, guess, largest in FITS:
        found, error = fit(name, guess, largest)
        values = ", ".join(f"{key} = {value:.4g}" for key, value in found.items())
        print(f"{name}: {values} up to a stretch of {largest:g}, relative error {100 * error:.1f} %")
