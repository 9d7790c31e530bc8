"""Power sums of the isochoric principal stretches, against eigenvalues in mpmath with 50 digits.

The stress is compared with its spectral form, and its derivative in a direction with the difference of two such
stresses 1e-18 apart, which is exact to 32 digits.
"""

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
from hpcinv.physics.kinematics.kinematics import Deformation
from hpcinv.physics.kinematics.principal_stretches import IsochoricStretches

pytestmark = pytest.mark.slow

I = np.eye(3)
ALPHAS = (2.0, -2.0, 1.3, 5.0, -3.0, 0.01)
STEEP = (30.0, -30.0)
DISTANCES = 10.0 ** -np.arange(1.0, 13.0)


@pytest.fixture(scope="module")
def power_sum() -> Callable[..., list[Any]]:
    """Value, derivative by ``H``, and the derivative of that in the direction ``G``, as UFL gives them."""
    mesh = create_unit_cube(MPI.COMM_SELF, 1, 1, 1)
    H_value, G, alpha = fem.Constant(mesh, 0 * I), fem.Constant(mesh, 0 * I), fem.Constant(mesh, 0.0)
    H = ufl.variable(H_value)
    psi = IsochoricStretches(Deformation(H)).power_sum_minus_3(alpha)
    P = ufl.diff(psi, H)
    both = [tensor[i, j] for tensor in (P, ufl.diff(ufl.inner(P, G), H)) for i, j in np.ndindex(3, 3)]
    compiled = fem.Expression(ufl.as_vector([psi, *both]), np.full((1, 3), 0.25))

    def evaluate(h: Any, direction: Any, exponent: float) -> list[Any]:
        H_value.value[...], G.value[...], alpha.value = h, direction, exponent
        evaluated = compiled.eval(mesh, np.array([0], dtype=np.int32)).ravel()
        return [evaluated[0], evaluated[1:10].reshape(3, 3), evaluated[10:].reshape(3, 3)]

    return evaluate


def spectral(F: Any, alpha: float) -> tuple[Any, Any]:
    """``Σ λ̄ᵢ^α - 3`` and its derivative by ``F``: ``F Σᵢ α (λ̄ᵢ^α - ⅓ Σⱼ λ̄ⱼ^α) λᵢ⁻² nᵢ⊗nᵢ``."""
    squares, n = mp.eigsy(F.T * F)
    powers = [(square / mp.cbrt(mp.det(F)) ** 2) ** (mp.mpf(alpha) / 2) for square in squares]
    S = mp.zeros(3)
    for i in range(3):
        S += alpha * (powers[i] - sum(powers) / 3) / squares[i] * n[:, i] * n[:, i].T
    return sum(powers) - 3, F * S


def exact(H: Any, G: Any, alpha: float) -> list[Any]:
    with mp.workdps(50):
        F, step = mp.eye(3) + mp.matrix(H.tolist()), mp.mpf("1e-18") * mp.matrix(G.tolist())
        value, P = spectral(F, alpha)
        change = (spectral(F + step, alpha)[1] - spectral(F - step, alpha)[1]) / mp.mpf("2e-18")
        return [float(value), *(np.array(tensor.tolist(), dtype=float) for tensor in (P, change))]


class Cases:
    """Displacement gradients from stretches and random rotations."""

    def __init__(self) -> None:
        self.random = np.random.default_rng(20)

    def rotation(self) -> Any:
        Q, _ = np.linalg.qr(self.random.standard_normal((3, 3)))
        return Q * np.linalg.det(Q)

    def stretched(self, *stretches: float) -> Any:
        return self.rotation() @ np.diag(stretches) @ self.rotation() - I

    def along_axes(self, *stretches: float) -> Any:
        """As above, but such that equal stretches are equal to the last bit."""
        return np.diag(stretches) - I

    def any_strain(self, size: float) -> Any:
        return size * self.random.standard_normal((3, 3))


def compare(power_sum: Callable[..., list[Any]], H: Any, alphas: tuple[float, ...], rtol: float) -> None:
    """The last term is what rounding ``F`` and ``C`` by some 1e-15 amounts to, and negligible at small strain."""
    G = np.random.default_rng(21).standard_normal((3, 3))
    h, inverse = np.abs(H).max(), np.linalg.norm(np.linalg.inv(I + H), 2)
    for alpha in alphas:
        sums, expected = power_sum(H, G, alpha), exact(H, G, alpha)
        for order in range(3):
            rounding = 2e-14 * alpha**2 * h ** (2 - order) * inverse**order
            error, size = np.abs(sums[order] - expected[order]).max(), np.abs(expected[order]).max()
            assert error <= rtol * size + rounding, (alpha, order, error, size)


@pytest.mark.release
def test_random_deformations(power_sum: Callable[..., list[Any]]) -> None:
    cases = Cases()
    for _ in range(4):
        compare(power_sum, cases.any_strain(0.3), ALPHAS + STEEP, 1e-12)
    for _ in range(4):
        compare(power_sum, cases.stretched(*np.exp(cases.random.uniform(-1.8, 1.8, 3))), ALPHAS, 1e-11)


@pytest.mark.parametrize("size", [1e-1, 1e-2, 1e-3, 3e-4, 1e-4, 5e-5, 2e-5, 1e-6, 1e-8, 1e-10])
def test_small_strain(power_sum: Callable[..., list[Any]], size: float) -> None:
    compare(power_sum, Cases().any_strain(size), ALPHAS + STEEP, 1e-11)


@pytest.mark.everyday("6.0")
@pytest.mark.parametrize("stretch", [0.2, 0.5, 0.9, 1.1, 2.0, 6.0])
def test_uniaxial_stretch(power_sum: Callable[..., list[Any]], stretch: float) -> None:
    cases = Cases()
    for H in (
        cases.stretched(stretch, stretch**-0.5, stretch**-0.5),
        cases.along_axes(stretch, stretch**-0.5, stretch**-0.5),
        cases.along_axes(1.0, 1.0, stretch),
    ):
        compare(power_sum, H, ALPHAS + STEEP, 1e-11)


@pytest.mark.parametrize("distance", DISTANCES)
@pytest.mark.parametrize("isolated", [0.6, 1.7, 4.0])
def test_two_stretches_almost_coincide(power_sum: Callable[..., list[Any]], isolated: float, distance: float) -> None:
    compare(power_sum, Cases().stretched(isolated, 1.0, 1 + distance), (5.0, -3.0, *STEEP), 1e-11)


@pytest.mark.release
@pytest.mark.parametrize("distance", DISTANCES)
def test_three_stretches_almost_coincide(power_sum: Callable[..., list[Any]], distance: float) -> None:
    """Several rotations of each: rounding errors of one alone may happen to cancel."""
    cases = Cases()
    for size in (0.5, 2.0):
        for apart in ((1, 0.3, -0.5), (1, 1, -2), (2, -1, -1)):
            for _ in range(2):
                compare(power_sum, cases.stretched(*(size * (1 + distance * np.array(apart)))), (5.0, -3.0), 1e-11)


@pytest.mark.release
@pytest.mark.parametrize("stretches", [(2, -1, -1), (1, 1, -2), (1, 0.3, -0.5)])
def test_evaluation_changes_where_all_stretches_almost_coincide(
    power_sum: Callable[..., list[Any]], stretches: tuple[float, ...]
) -> None:
    """Just above the distance at which the series takes over, where rounding costs the closed form the most."""
    cases = Cases()
    for distance in np.geomspace(1.5e-3, 8e-3, 12):
        compare(power_sum, cases.stretched(*(1 + distance * np.array(stretches))), (5.0, -3.0), 1e-11)


@pytest.mark.release
def test_all_stretches_coincide(power_sum: Callable[..., list[Any]]) -> None:
    cases = Cases()
    for H in (0 * I, I, -I / 2, cases.stretched(1.0, 1.0, 1.0)):
        compare(power_sum, H, ALPHAS + STEEP, 1e-12)


@pytest.mark.release
def test_simple_shear_has_a_stretch_of_1(power_sum: Callable[..., list[Any]]) -> None:
    # λ₁ = 1/λ₃ = λ with λ - 1/λ = g: neither of the outer stretches is the isolated one.
    for g in (1e-6, 1e-3, 0.5, 4.0):
        H = np.array([[0, g, 0], [0, 0, 0], [0, 0, 0]])
        compare(power_sum, H, ALPHAS + STEEP, 1e-11)
        t = 2 * np.arcsinh(g / 2)
        assert power_sum(H, I, 3.0)[0] == pytest.approx(4 * np.sinh(3 * t / 4) ** 2, rel=1e-11, abs=0)


def test_extreme_deformations_give_numbers(power_sum: Callable[..., list[Any]]) -> None:
    cases = Cases()
    for stretches in ((1e3, 0.03, 0.03), (1e-4, 100.0, 100.0), (1e4, 1e-2, 1e-2), (1e3, 1e3, 1e-6)):
        for alpha in (5.0, -5.0):
            sums = power_sum(cases.stretched(*stretches), I, alpha)
            assert all(np.isfinite(part).all() for part in sums), (stretches, alpha)
