"""Powers of the isochoric principal stretches, smooth where stretches coincide and exact at small strain.

``C̄ = J^(-2/3) C`` has the eigenvalues ``λ̄ᵢ²``, the mean ``1 + (Ī1 - 3)/3`` and a deviator ``s``. With ``J2 = ½ s:s``
and ``J3 = det s`` the eigenvalue of ``s`` farthest from the other two has the sign of ``J3`` and is

    δ = ±2 √(J2/3) cos(⅓ arccos r),      r = ½ |J3| (3/J2)^(3/2),

a smooth function up to ``r = 1``, where the other two coincide: the isolated stretch is smooth, too. If it is the
smallest, the inverse deformation is used: there it is the largest, ``α`` is ``-α``, and ``Ī1`` and ``Ī2`` are
exchanged. Let it be ``x``. As ``det C̄ = 1``, the other two squared are ``e^η/x`` and ``e^(-η)/x``, so that

    Σ λ̄ᵢ^α = x^α + 2 x^(-α/2) cosh(α η/2),      Ī2 = x⁻² + 2 x cosh η.

The second gives ``cosh η``, and the even function of ``η`` in the first is a smooth function of that: Chebyshev's
``T_ν(cosh η) = cosh ν η``, just as ``cos(⅓ arccos r)`` is ``T_⅓(r)``. Near 1 it is taken from its series.
"""

from functools import cached_property
from math import factorial
from typing import Any

import ufl

from hpcinv.physics.kinematics.kinematics import Deformation

# Second derivatives of the closed forms lose digits by rounding as stretches coincide: about 1e-14/√J2 where all do.
# Below these bounds series are used, whose truncation errors are up to |α| = 30 below 1e-17 and 5e-15.
_ALL_COINCIDE_BELOW = 1e-4  # J2
_TWO_COINCIDE_BELOW = 1e-6  # 1 - r and cosh η - 1
_LAST_POWER = 11


class IsochoricStretches:
    """The isochoric principal stretches ``λ̄ᵢ = J^(-1/3) λᵢ`` (no dimension) of a deformation."""

    def __init__(self, k: Deformation) -> None:
        g = k.J ** (-2 / 3)
        e = ufl.dev(k.E)  # s = 2 g e
        square, det = ufl.variable(ufl.inner(e, e)), ufl.variable(ufl.det(e))  # smooth stages of derivatives
        self._is_largest = ufl.ge(det, 0)
        self._sign = ufl.conditional(self._is_largest, 1, -1)
        radius = self._sign * ufl.sqrt(square / 6)
        self._r = det / (2 * radius**3)
        self._delta_max = 4 * g * radius  # ±2 √(J2/3)
        self._J2 = 2 * g**2 * square
        self._I1_minus_3 = k.I1_bar_minus_3
        self._I2_minus_3 = 2 * self._I1_minus_3 + self._I1_minus_3**2 / 3 - self._J2

    def power_sum_minus_3(self, alpha: Any) -> Any:
        """Return ``Σ λ̄ᵢ^α - 3``.

        At stretches from 1/6 to 6 and ``|α| ≤ 30`` the relative error is below 1e-10, also of the derivatives.
        """
        coinciding, isolated = self._identity_series(alpha / 2), self._isolated_form(self._sign * alpha / 2)
        return ufl.conditional(ufl.lt(self._J2, _ALL_COINCIDE_BELOW), coinciding, isolated)

    @property
    def log_square_sum(self) -> Any:
        """Return ``Σ (ln λ̄ᵢ)²``, ``¼ p₂`` or ``3/2 (ln x)² + ½ η²``: the limit of ``(Σ λ̄ᵢ^α - 3) 2/α²`` for small α."""
        x, z, eta = self._isolated_and_pair
        pair = ufl.conditional(ufl.lt(z, _TWO_COINCIDE_BELOW), z * (1 - z / 6 * (1 - 4 / 15 * z)), eta**2 / 2)
        isolated = 1.5 * ufl.ln(x) ** 2 + pair
        return ufl.conditional(ufl.lt(self._J2, _ALL_COINCIDE_BELOW), self._j2_and_j3[0] / 2, isolated)

    def _identity_series(self, beta: Any) -> Any:
        """Return ``Σ e^(β hᵢ) - 3 = Σ βⁿ pₙ/n!`` from n = 2 to 11, ``h = ln C̄`` and ``pₙ = Σ hᵢⁿ``.

        The invariants ``j2 = ½ h:h`` and ``j3 = det h`` follow from ``Ī1 - 3`` and ``Ī2 - 3``, which are ``β = ±1``, by
        series reversion. As ``h`` has no trace, ``hᵢ³ = j2 hᵢ + j3`` gives each power sum from those before it.
        """
        j2, j3 = self._j2_and_j3
        p: list[Any] = [0, 0, 2 * j2, 3 * j3]
        for n in range(4, _LAST_POWER + 1):
            p.append(j2 * p[n - 2] + j3 * p[n - 3])
        return sum(beta**n / factorial(n) * p[n] for n in range(2, _LAST_POWER + 1))

    @cached_property
    def _j2_and_j3(self) -> tuple[Any, Any]:
        even, odd = (self._I1_minus_3 + self._I2_minus_3) / 2, (self._I1_minus_3 - self._I2_minus_3) / 2
        j2 = even - even**2 / 12 + even**3 / 90 - odd**2 / 60
        return j2, 2 * odd * (1 - j2 / 12 + j2**2 / 240)

    def _isolated_form(self, beta: Any) -> Any:
        """Return ``x^(2β) + 2 x^(-β) cosh βη - 3``, written as a sum of positive terms."""
        x, z, eta = self._isolated_and_pair
        w = beta * ufl.ln(x)
        p = ufl.exp(w)
        pair = ufl.conditional(
            ufl.lt(z, _TWO_COINCIDE_BELOW), _chebyshev_minus_1(beta, z), 2 * ufl.sinh(beta * eta / 2) ** 2
        )
        return 4 * (p + 2) * ufl.sinh(w / 2) ** 2 + 2 * pair / p

    @cached_property
    def _isolated_and_pair(self) -> tuple[Any, Any, Any]:
        """``x``, ``z = cosh η - 1`` and ``η``."""
        r, I1, I2 = self._r, self._I1_minus_3, self._I2_minus_3
        cosine = ufl.conditional(
            ufl.gt(r, 1 - _TWO_COINCIDE_BELOW),
            1 + _chebyshev_minus_1(1 / 3, r - 1),
            ufl.cos(2 / 3 * ufl.asin(ufl.sqrt((1 - r) / 2))),
        )
        m = I1 / 3 + self._delta_max * cosine  # the eigenvalue of C̄, less 1
        inverse = m * (m - 1 - I1) + I2 - I1  # 1/(1 + m) - 1, from the characteristic polynomial
        x2_minus_1 = ufl.conditional(self._is_largest, m, inverse)
        I2 = ufl.conditional(self._is_largest, I2, I1)
        x = ufl.sqrt(1 + x2_minus_1)
        y = x2_minus_1 / (1 + x + x2_minus_1)  # 1 - 1/x
        z = (I2 - y * (I2 + y * (3 - y))) / 2
        return x, z, ufl.ln(1 + z + ufl.sqrt(z * (2 + z)))


def _chebyshev_minus_1(nu: Any, z: Any) -> Any:
    """Return ``T_ν(1 + z) - 1`` to third order in ``z``."""
    return nu**2 * z * (1 + (nu**2 - 1) / 6 * z * (1 + (nu**2 - 4) / 15 * z))
