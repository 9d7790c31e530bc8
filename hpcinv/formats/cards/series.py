"""Formulas of functions without one: an integral over the stretch of a fibre, and the inverse Langevin function."""

from fractions import Fraction

import numpy as np

POINTS = 8
"""Gauss points of the integral over the stretch of a fibre; more change no digit of 12 at 2 % to 80 % of stretch."""


def exponential_integral(strain: str, factor: str) -> str:
    """Return a formula of the integral of (exp(factor (l - 1)) - 1)/l over the stretch l from 1 to 1 + strain."""
    nodes, weights = np.polynomial.legendre.leggauss(POINTS)
    terms = (
        f"{w / 2:.17g}*(exp({(x + 1) / 2:.17g}*{factor}*{strain}) - 1)/(1 + {(x + 1) / 2:.17g}*{strain})"
        for x, w in zip(nodes, weights, strict=True)
    )
    return f"{strain}*({' + '.join(terms)})"


def inverse_langevin(terms: int) -> list[float]:
    """Return the coefficients of x, x³, x⁵, … of the inverse of coth b - 1/b, by exact reversion of its series."""
    # L(b) b sinh b = b cosh b - sinh b, in powers of b²
    factorial = [1]
    for i in range(1, 2 * terms + 4):
        factorial.append(factorial[-1] * i)
    top = [Fraction(1, factorial[2 * k + 2]) - Fraction(1, factorial[2 * k + 3]) for k in range(terms)]
    bottom = [Fraction(1, factorial[2 * k + 1]) for k in range(terms)]
    langevin: list[Fraction] = []
    for k in range(terms):
        langevin.append(top[k] - sum((langevin[i] * bottom[k - i] for i in range(k)), Fraction(0)))
    inverse = [1 / langevin[0]]
    for k in range(1, terms):
        # coefficient of x^(2k+1) in L(inverse(x)) without the next term of the inverse, which must cancel it
        power, square = [*inverse, Fraction(0)], _product(inverse, inverse, k + 1)
        rest = Fraction(0)
        for i in range(k + 1):
            rest += langevin[i] * power[k]
            power = _product(power, [Fraction(0), *square], k + 1)
        inverse.append(-rest / langevin[0])
    return [float(c) for c in inverse]


def _product(a: list[Fraction], b: list[Fraction], count: int) -> list[Fraction]:
    """First coefficients of the product of two series."""
    a, b = ([*series, *[Fraction(0)] * count] for series in (a, b))
    return [sum((a[i] * b[k - i] for i in range(k + 1)), Fraction(0)) for k in range(count)]
