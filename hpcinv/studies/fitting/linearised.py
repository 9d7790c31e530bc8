"""Linearised least squares at a solution: covariance of the parameters, and combinations that the data leave free."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hpcinv.base.quantity.arrays import Floats

DEPENDENT = 1e-9
"""ratio of singular values below which parameters cannot be distinguished"""
_FEW, _STRONG = 3, 0.9
"""Parameters of which all correlations are shown, and size of a correlation that is shown of more."""
_INVOLVED = 0.1  # smallest share of a parameter in a combination that is named


@dataclass(frozen=True)
class Combination:
    """A unit vector of parameters, in units of their scales.

    Attributes:
        deviation: standard deviation of the parameters along it, in these units; infinite if the data do not change.
    """

    vector: Floats
    deviation: float

    @property
    def involved(self) -> list[int]:
        """Numbers of the parameters that are part of it."""
        return [i for i, share in enumerate(self.vector) if abs(share) > _INVOLVED]


@dataclass(frozen=True)
class Linearised:
    """Residuals with standard deviation 1, linear in the parameters.

    Attributes:
        jacobian: derivatives of the residuals, (n, k).
        scales: sizes of the parameters (k,) in combinations; by default those that change the data by 1.
        dependent: ratio of singular values below which a combination counts as free.
    """

    jacobian: Floats
    scales: Floats | None = None
    dependent: float = DEPENDENT

    @cached_property
    def lengths(self) -> Floats:
        """Norms of the columns, (k,)."""
        return np.asarray(np.linalg.norm(self.jacobian, axis=0))

    def idle(self, size: float) -> list[int]:
        """Numbers of the parameters on which the data do not depend, compared with data of that ``size``."""
        return [i for i, length in enumerate(self.lengths) if not length > self.dependent * size]

    @cached_property
    def combinations(self) -> list[Combination]:
        """Combinations that have independent errors, the best determined one first."""
        scales = self.scales if self.scales is not None else 1 / np.where(self.lengths > 0, self.lengths, 1.0)
        triangle = np.linalg.qr(self.jacobian * scales, mode="r")  # memory linear in the number of data
        _, singular, rows = np.linalg.svd(triangle, full_matrices=True)
        values = np.zeros(len(rows))
        values[: len(singular)] = singular
        least = self.dependent * values.max(initial=0.0)
        return [Combination(v, float(1 / s) if s > least else np.inf) for v, s in zip(rows, values, strict=True)]

    def free(self) -> list[Combination]:
        """Combinations that change no data."""
        return [combination for combination in self.combinations if not np.isfinite(combination.deviation)]

    def covariance(self) -> Floats:
        """Return the covariance (k, k) of the parameters within the determined combinations."""
        scales = self.scales if self.scales is not None else 1 / np.where(self.lengths > 0, self.lengths, 1.0)
        total = np.zeros((len(scales), len(scales)))
        for combination in self.combinations:
            if np.isfinite(combination.deviation):
                total += np.outer(combination.vector, combination.vector) * combination.deviation**2
        return total * np.outer(scales, scales)

    def undetermined(self) -> list[int]:
        """Numbers of the parameters that are part of a free combination."""
        return sorted({i for combination in self.free() for i in combination.involved})


def correlation_of(covariance: Floats) -> Floats:
    """Return the correlation (k, k) of a covariance."""
    deviations = np.sqrt(np.diag(covariance))
    scale = np.where(deviations > 0, deviations, 1.0)
    return np.asarray(covariance / np.outer(scale, scale))


def correlations(names: Sequence[str], correlation: Floats) -> str:
    """Return correlations as text; of more than `_FEW` parameters the strong ones."""
    pairs = [(i, j) for i in range(len(names)) for j in range(i)]
    shown = [(i, j) for i, j in pairs if len(names) <= _FEW or abs(correlation[i, j]) >= _STRONG]
    texts = [f"{names[j]}–{names[i]} {correlation[i, j]:.3f}" for i, j in shown]
    return ", ".join(texts + ([f"others below {_STRONG:g}"] if len(shown) < len(pairs) else []))
