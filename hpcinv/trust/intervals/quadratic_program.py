"""Convex quadratic programs of some hundred numbers, by an interior point.

    minimise ½ zᵀ H z + g·z    where    A z ≤ b,  E z = e

Source: Mehrotra (1992), doi:10.1137/0802028; Nocedal & Wright (2006), doi:10.1007/978-0-387-40065-5, algorithm 16.4.
"""

from __future__ import annotations

import numpy as np

from hpcinv.mesh.source import Floats

_MOST = 100
"""iterations; programs take 10 to 40. Raised, ones without a solution take longer."""
_SETTLED = 1e-10  # complementarity and residuals, in units of the scaled program
_DEPENDENT = 1e-9  # size of a combination of equations, by the largest, below which it is left out
_BACK = 0.995  # share of the way to the boundary that is taken


@np.errstate(over="ignore", invalid="ignore")  # duals grow without bound where the inequalities contradict each other
def solve_quadratic(
    H: Floats, g: Floats, inequalities: tuple[Floats, Floats], equations: tuple[Floats, Floats]
) -> Floats | None:
    """Return the z (n,) at which a convex quadratic function is least; ``None`` if none is found.

    Args:
        H, g: second (n, n) and first (n,) derivatives.
        inequalities, equations: matrices (m, n) and right sides (m,).
    """
    n = len(g)
    size = max(float(np.abs(np.diag(H)).max(initial=0.0)), 1e-300)
    # In units of the largest curvature; directions without any get a little.
    H, g = H / size + _DEPENDENT * np.eye(n), g / size
    A, b = _scaled_rows(*inequalities)
    E, e = _independent(*equations)
    z: Floats = E.T @ e  # rows are orthonormal
    y: Floats = np.zeros(len(e))
    unit = max(1e-12, float(np.abs(z).max(initial=0.0)), float(np.abs(b).max(initial=0.0)))
    slack = np.maximum(b - A @ z, unit)
    dual = np.full(len(b), max(unit, float(np.abs(g).max(initial=0.0))))
    for _ in range(_MOST):
        along = H @ z + g + A.T @ dual + E.T @ y
        above, off = A @ z + slack - b, E @ z - e
        gap = float(slack @ dual) / max(len(b), 1)
        left = max(float(np.abs(part).max(initial=0.0)) for part in (along, above, off))
        if gap < _SETTLED * unit**2 and left < _SETTLED**0.5 * unit:
            return z
        weights = dual / slack
        matrix = np.zeros((n + len(e), n + len(e)))
        matrix[:n, :n] = H + A.T @ (weights[:, None] * A)
        matrix[:n, n:], matrix[n:, :n] = E.T, E
        centred = slack * dual
        for is_corrected in (False, True):
            right = np.concatenate([-along - A.T @ (weights * above - centred / slack), -off])
            step = np.linalg.solve(matrix, right)
            dz, dy = step[:n], step[n:]
            d_slack = -above - A @ dz
            d_dual = -(centred + dual * d_slack) / slack
            way = _longest(slack, d_slack), _longest(dual, d_dual)
            if not is_corrected and gap > 0:
                after = float((slack + way[0] * d_slack) @ (dual + way[1] * d_dual)) / max(len(b), 1)
                centred = slack * dual + d_slack * d_dual - (after / gap) ** 3 * gap
        both = _BACK * min(way)
        z, slack, dual, y = z + both * dz, slack + both * d_slack, dual + both * d_dual, y + both * dy
        if not np.isfinite(z).all():
            return None
    return None


def _longest(values: Floats, changes: Floats) -> float:
    """Return the largest share, at most 1, of changes that leaves positive values so."""
    falls = changes < 0
    return float(min(1.0, (-values[falls] / changes[falls]).min(initial=1.0)))


def _scaled_rows(rows: Floats, right: Floats) -> tuple[Floats, Floats]:
    sizes = np.abs(rows).max(axis=1, initial=0.0)
    kept = sizes > 0
    return rows[kept] / sizes[kept, None], right[kept] / sizes[kept]


def _independent(rows: Floats, right: Floats) -> tuple[Floats, Floats]:
    """Return orthonormal combinations of equations, without the dependent ones."""
    if not len(right):
        return rows, right
    left, sizes, across = np.linalg.svd(rows, full_matrices=False)
    kept = sizes > _DEPENDENT * sizes.max(initial=0.0)
    return across[kept], (left.T @ right)[kept] / sizes[kept]
