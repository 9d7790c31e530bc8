"""Elementary functions and their first two derivatives, as UFL makes them, against mpmath with 50 digits."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mpmath as mp
import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import create_unit_cube

from hpcinv.base.parallel.runtime import MPI
from hpcinv.physics.kinematics import stable_functions

TINY = [sign * 10.0**-n for n in (4, 8, 12, 16, 30, 80) for sign in (-1, 1)]
MEDIUM = [-0.9, -0.5, -0.126, -0.125, -0.124, -0.06, -0.01, -0.001, 0.001, 0.01, 0.06, 0.124, 0.125, 0.126, 0.5, 0.9]
BIG = [2.0, 10.0, 40.0]
ABOVE_MINUS_1 = [0.0, -1 + 1e-6, *TINY, *MEDIUM, *BIG, 1e6]


@pytest.fixture(scope="module")
def derivatives() -> Callable[[str, float], Any]:
    """Value and first two derivatives of a function, by name, at ``x``."""
    mesh = create_unit_cube(MPI.COMM_SELF, 1, 1, 1)
    at = fem.Constant(mesh, 0.0)
    x = ufl.variable(at)
    names = ["sqrt", "expm1", "log1p", "log1p_remainder", "log1p_remainder_ratio", "positive_part"]
    values = [getattr(stable_functions, name)(x) for name in names]
    values += [stable_functions.polynomial(x, [3.0, -2.0, 0.5])]
    slopes = [ufl.diff(value, x) for value in values]
    all_of_them = ufl.as_vector([*values, *slopes, *(ufl.diff(slope, x) for slope in slopes)])
    compiled = fem.Expression(all_of_them, np.full((1, 3), 0.25))

    def evaluate(name: str, value: float) -> Any:
        at.value = value
        evaluated = compiled.eval(mesh, np.array([0], dtype=np.int32)).reshape(3, -1)
        return evaluated[:, [*names, "polynomial"].index(name)]

    return evaluate


def log1p_family(x: float) -> dict[str, list[Any]]:
    """``ln(1 + x)`` and what is left of it, each with two derivatives."""
    with mp.workdps(300):  # of which the differences at 1e-80 cancel 240
        x = mp.mpf(x)
        f = [mp.log(1 + x), 1 / (1 + x), -1 / (1 + x) ** 2]
        r = [f[0] - x, f[1] - 1, f[2]]
        if x == 0:
            ratio = [-mp.mpf(1) / 2, mp.mpf(1) / 3, -mp.mpf(1) / 2]  # of -1/2 + x/3 - x²/4 + …
        else:
            ratio = [r[0] / x**2, r[1] / x**2 - 2 * r[0] / x**3, r[2] / x**2 - 4 * r[1] / x**3 + 6 * r[0] / x**4]
        return {
            name: [float(v) for v in values]
            for name, values in (("log1p", f), ("log1p_remainder", r), ("log1p_remainder_ratio", ratio))
        }


@pytest.mark.parametrize(
    ("name", "tolerances"),
    [
        ("log1p", (1e-15, 1e-15, 1e-14)),
        ("log1p_remainder", (1e-13, 1e-14, 1e-14)),
        ("log1p_remainder_ratio", (1e-13, 1e-12, 1e-11)),
    ],
)
def test_logarithms_keep_their_digits(
    derivatives: Callable[[str, float], Any], name: str, tolerances: tuple[float, ...]
) -> None:
    for x in ABOVE_MINUS_1:
        exact = log1p_family(x)[name]
        for order, (entry, expected, tolerance) in enumerate(zip(derivatives(name, x), exact, tolerances, strict=True)):
            assert entry == pytest.approx(expected, rel=tolerance, abs=0), (x, order)


def test_exponential_less_1_keeps_its_digits(derivatives: Callable[[str, float], Any]) -> None:
    with mp.workdps(100):
        for x in [0.0, *TINY, *MEDIUM, *BIG, 300.0, -2.0, -10.0, -40.0]:
            value, slope, curvature = derivatives("expm1", x)
            assert value == pytest.approx(float(mp.expm1(mp.mpf(x))), rel=4e-15, abs=0), x
            for derivative in (slope, curvature):
                assert derivative == pytest.approx(
                    float(mp.exp(mp.mpf(x))), rel=1e-13 if x > 0 else 4e-16, abs=4e-16
                ), x


def test_kinks_and_plain_functions(derivatives: Callable[[str, float], Any]) -> None:
    for x, expected in ((-1e-300, (0, 0, 0)), (0.0, (0, 0, 0)), (1e-300, (1e-300, 1, 0)), (2.5, (2.5, 1, 0))):
        assert tuple(derivatives("positive_part", x)) == expected
    assert derivatives("sqrt", 1.44) == pytest.approx([1.2, 1 / 2.4, -1 / (4 * 1.2**3)], rel=1e-15)
    assert derivatives("polynomial", 0.3) == pytest.approx([3 - 0.6 + 0.045, -1.7, 1.0], rel=1e-15)
