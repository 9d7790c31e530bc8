"""Elementary functions of UFL scalars, accurate together with their symbolic derivatives where the argument is small.

Laws use these instead of ``ln(1 + x)`` or ``exp(x) - 1``, which lose their digits at small strain.
"""

import math
from typing import Any

_SERIES_BELOW = 2.0**-3  # |x| below which logarithms are computed from series
_SERIES_TERMS = 6  # errors of second derivatives there: 1e-13 by truncation, 1e-12 by rounding of ln(1 + x)
_REMAINDERS_BELOW = 2.0**-9  # |x| below which other functions are series, of few terms, which keep forms small
_EXP_TERMS, _POWER_TERMS = 5, 8  # truncation error: 1e-17 of the sum, for powers from -20 to 20


def sqrt(x: Any) -> Any:
    """Square root."""
    import ufl

    return ufl.sqrt(x)


def expm1(x: Any) -> Any:
    """``eˣ - 1 = 2 sinh(x/2) e^(x/2)``; errors of derivatives are relative for ``x > 0``, else absolute."""
    import ufl

    return 2 * ufl.sinh(x / 2) * ufl.exp(x / 2)


def expm1_remainder(x: Any) -> Any:
    """``eˣ - 1 - x``; ``x²/2`` to leading order."""
    import ufl

    terms = [1 / math.factorial(k) for k in range(2, 2 + _EXP_TERMS)]
    return _series_or_closed(x, x**2 * polynomial(x, terms), ufl.exp(x) - 1 - x, _REMAINDERS_BELOW)


def power_remainder(x: Any, n: Any) -> Any:
    """``(1 + x)ⁿ - 1 - n x``, ``x > -1``; ``n (n - 1) x²/2`` to leading order."""
    terms = [n * (n - 1) / 2]  # binomial coefficients
    for k in range(2, 1 + _POWER_TERMS):
        terms.append(terms[-1] * (n - k) / (k + 1))
    return _series_or_closed(x, x**2 * polynomial(x, terms), (1 + x) ** n - 1 - n * x, _REMAINDERS_BELOW)


def log1p(x: Any) -> Any:
    """``ln(1 + x)``, ``x > -1``."""
    import ufl

    z, tail = _artanh_series(x)
    return _series_or_closed(x, 2 * z * (1 + z**2 * tail), ufl.ln(1 + x))


def log1p_remainder(x: Any) -> Any:
    """``ln(1 + x) - x``, ``x > -1``; ``-x²/2`` to leading order."""
    import ufl

    z, tail = _artanh_series(x)
    return _series_or_closed(x, z * (2 * z**2 * tail - x), ufl.ln(1 + x) - x)


def log1p_remainder_ratio(x: Any) -> Any:
    """``(ln(1 + x) - x) / x²``, ``x > -1``; ``-1/2`` at 0."""
    import ufl

    z, tail = _artanh_series(x)
    return _series_or_closed(x, (2 * z * tail / (2 + x) - 1) / (2 + x), (ufl.ln(1 + x) - x) / x**2)


def positive_part(x: Any) -> Any:
    """``max(x, 0)``, with the derivative 0 at 0."""
    import ufl

    return ufl.conditional(ufl.gt(x, 0), x, 0.0)


def rounded_positive_part(x: Any, width: Any) -> Any:
    """``max(x, 0)`` with a parabola for ``|x| < width``, so that its derivative is continuous; 1/2 at 0."""
    import ufl

    parabola = (x + width) ** 2 / (4 * width)
    return ufl.conditional(ufl.gt(x, width), x, ufl.conditional(ufl.gt(x, -width), parabola, 0.0))


def polynomial(x: Any, coefficients: list[Any]) -> Any:
    """``c₀ + c₁ x + c₂ x² + …`` by Horner's rule."""
    total = coefficients[-1]
    for c in reversed(coefficients[:-1]):
        total = c + x * total
    return total


def _artanh_series(x: Any) -> tuple[Any, Any]:
    """``z = x/(2 + x)`` and ``t = 1/3 + z²/5 + z⁴/7 + …``: ``ln(1 + x) = 2 artanh z = 2 z (1 + z² t)``."""
    z = x / (2 + x)
    return z, polynomial(z**2, [1 / (2 * n + 3) for n in range(_SERIES_TERMS)])


def _series_or_closed(x: Any, series: Any, closed: Any, bound: float = _SERIES_BELOW) -> Any:
    import ufl

    return ufl.conditional(ufl.lt(abs(x), bound), series, closed)
