"""Strong ellipticity (Legendre and Hadamard) of isotropic laws, also called strict rank-one convexity.

It is ``D²W[a ⊗ b, a ⊗ b] > 0`` for all vectors a and b but zero; of an incompressible material for those that keep the
volume, ``a · F⁻ᵀ b = 0``. Where it is lost, waves of some direction do not propagate, the strain may jump across a
surface, and results depend on the mesh.

In principal axes with ``H = a ⊗ b`` and ``p_i = a_i b_i``,

    D²W[H, H] = Σ_ij W_ij p_i p_j + Σ_{i<j} ((P_ij + M_ij)/2 (H_ij² + H_ji²) + (P_ij - M_ij) p_i p_j),
    P_ij = (W_i - W_j)/(λ_i - λ_j),  M_ij = (W_i + W_j)/(λ_i + λ_j).

``H_ij² + H_ji² ≥ 2 |p_i p_j|``, with equality for all pairs at once if ``|a_i| = |b_i|``. So the condition holds if and
only if all ``P_ij + M_ij > 0`` and, for each choice of the signs of p, the matrix of the quadratic form in ``|p_i|`` is
strictly copositive (positive for vectors without negative entries). Where the volume is kept, ``Σ p_i/λ_i = 0``
eliminates that ``|p_k|`` whose sign differs from the two others.

Source: Simpson & Spector (1983), "On copositive matrices and strong ellipticity for isotropic elastic materials",
doi:10.1007/BF00251548; Hadeler (1983), "On copositive matrices", doi:10.1016/0024-3795(83)90095-2.
"""

from itertools import combinations

import numpy as np

from hpcinv.base.quantity.arrays import Booleans, Floats
from hpcinv.studies.fitting.homogeneous import Mode, Response

_EQUAL = 1e-4
"""Relative difference of stretches up to which the limit of ``P_ij`` is taken: its error is that squared."""
_PAIRS = tuple(combinations(range(3), 2))


def is_elliptic(response: Response, parameters: Floats, mode: Mode, measure: Floats) -> Booleans:
    """Return whether a law is strongly elliptic (n,) in the states of a test; false where the law is not defined."""
    stretches = response.state(mode, measure, parameters)
    W = response.energy(stretches, parameters, slopes=False)
    defined = np.isfinite(W.value) & np.isfinite(W.gradient).all(axis=1) & np.isfinite(W.hessian).all(axis=(1, 2))
    elliptic = np.zeros(len(measure), dtype=bool)
    check = _keeps_volume if response.is_incompressible else _is_general
    elliptic[defined] = check(stretches[defined], W.gradient[defined], W.hessian[defined])
    return elliptic


def _is_general(stretches: Floats, slope: Floats, curvature: Floats) -> Booleans:
    alike, opposite = _mixed(stretches, slope, curvature)
    elliptic: Booleans = np.all(alike + opposite > 0, axis=1)
    for differs in (None, 0, 1, 2):
        elliptic &= _is_copositive_of_three(_quadratic(stretches, alike, opposite, curvature, differs))
    return elliptic


def _keeps_volume(stretches: Floats, slope: Floats, curvature: Floats) -> Booleans:
    alike, opposite = _mixed(stretches, slope, curvature)
    elliptic: Booleans = np.all(alike + opposite > 0, axis=1)
    for k in range(3):
        i, j = (n for n in range(3) if n != k)
        A = _quadratic(stretches, alike, opposite, curvature, k)
        # |p_k|/λ_k = |p_i|/λ_i + |p_j|/λ_j
        first = A[:, i, i] + 2 * A[:, i, k] + A[:, k, k]
        second = A[:, j, j] + 2 * A[:, j, k] + A[:, k, k]
        elliptic &= _is_copositive(first, second, A[:, i, j] + A[:, i, k] + A[:, j, k] + A[:, k, k])
    return elliptic


def _mixed(stretches: Floats, slope: Floats, curvature: Floats) -> tuple[Floats, Floats]:
    """Return ``W_ij + P_ij`` and ``M_ij - W_ij``, (n, 3) by pair: the entries for like and for opposite signs."""
    alike, opposite = np.empty((2, len(stretches), 3))
    for number, (i, j) in enumerate(_PAIRS):
        a, b = stretches[:, i], stretches[:, j]
        W_ij, close = curvature[:, i, j], np.abs(a - b) <= _EQUAL * (a + b)
        limit = (curvature[:, i, i] + curvature[:, j, j]) / 2 - W_ij
        P = np.where(close, limit, (slope[:, i] - slope[:, j]) / np.where(close, 1.0, a - b))
        alike[:, number] = W_ij + P
        opposite[:, number] = (slope[:, i] + slope[:, j]) / (a + b) - W_ij
    return alike, opposite


def _quadratic(stretches: Floats, alike: Floats, opposite: Floats, curvature: Floats, differs: int | None) -> Floats:
    """Return the matrix (n, 3, 3) of the form in ``|p_i|/λ_i`` (Pa), where one p may differ in sign."""
    A = np.zeros_like(curvature)
    A[:, range(3), range(3)] = curvature[:, range(3), range(3)]
    for number, (i, j) in enumerate(_PAIRS):
        A[:, i, j] = A[:, j, i] = (opposite if differs in (i, j) else alike)[:, number]
    scaled: Floats = A * stretches[:, :, None] * stretches[:, None, :]
    return scaled


def _is_copositive(a: Floats, b: Floats, mixed: Floats) -> Booleans:
    copositive: Booleans = (a > 0) & (b > 0) & (mixed + np.sqrt(np.maximum(a * b, 0.0)) > 0)
    return copositive


def _is_copositive_of_three(A: Floats) -> Booleans:
    """Return whether symmetric matrices (n, 3, 3) are strictly copositive, by Hadeler's criterion."""
    roots = np.sqrt(np.maximum(A[:, range(3), range(3)], 0.0))
    copositive = np.all(A[:, range(3), range(3)] > 0, axis=1)
    product, total = np.full(len(A), 2.0), roots.prod(axis=1)
    for i, j in _PAIRS:
        bounded = A[:, i, j] + roots[:, i] * roots[:, j]
        copositive &= bounded > 0
        product *= np.maximum(bounded, 0.0)
        total += A[:, i, j] * roots[:, 3 - i - j]
    last: Booleans = total + np.sqrt(product) > 0
    return np.logical_and(copositive, last)
