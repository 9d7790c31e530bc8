"""Posterior of identified parameters: a surrogate is sampled first, and exact evaluations correct it.

With ``z`` the parameters relative to the estimate, in its axes of standard deviation 1, the differences are expanded to

    r(z) = r + A z + 1/2 zᵀ H z,

where H comes from exact derivatives at two points on each axis. An ensemble of walkers samples the posterior of this
surrogate. A subset of these samples are proposals of a second chain: a proposal ``z'`` after ``z`` is accepted with

    min(1, w(z')/w(z)),      w = exp((χ²_surrogate - χ²_exact)/2),

so that the second chain has the exact posterior, however rough the surrogate is. A rough one is rarely accepted.

Sources: Christen & Fox, J. Comput. Graph. Stat. 14, 795-810, 2005, doi:10.1198/106186005X76983 (delayed acceptance);
Foreman-Mackey, Hogg, Lang & Goodman, PASP 125, 306-312, 2013, doi:10.1086/670067 (ensemble sampler).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hpcinv.errors import JobError
from hpcinv.mesh.source import Floats

_AXIS_STEP = 1.5
"""Distance on each axis, in standard deviations: derivatives there give H. Larger: better in the tails."""
_WALKERS = 4  # for each parameter
_STEPS = 2000
"""Steps of each walker, a quarter of which are left out at the beginning. More: less noise of the first stage."""
_QUANTILES = (0.025, 0.25, 0.5, 0.75, 0.975)

type Differences = Callable[[Floats], tuple[Floats, Floats] | None]
"""Differences in standard deviations (n,) and their derivatives (n, k) at parameters (k,), ``None`` if not reached."""


@dataclass(frozen=True)
class Target:
    """Posterior density to be sampled.

    Attributes:
        differences: exact evaluation.
        center: the estimate, (k,); covariance: its covariance (k, k), which is regular.
        lower, upper: bounds, (k,).
        priors: mean and standard deviation by parameter, ``None`` without one.
    """

    differences: Differences
    center: Floats
    covariance: Floats
    lower: Floats
    upper: Floats
    priors: Sequence[tuple[float, float] | None]

    def prior_chi(self, values: Floats) -> Floats:
        """Return the part of χ² of the priors at parameters (…, k), infinite outside of the bounds."""
        chi = np.where(((values >= self.lower) & (values <= self.upper)).all(axis=-1), 0.0, np.inf)
        for i, prior in enumerate(self.priors):
            if prior is not None:
                chi = chi + ((values[..., i] - prior[0]) / prior[1]) ** 2
        return chi


@dataclass(frozen=True)
class Posterior:
    """Samples of the exact posterior.

    Attributes:
        samples: (n, k), in order of the second chain; a repeated one was not left.
        differences: of each, in standard deviations (n, m).
        acceptance: share of proposals that were accepted: 1 for an exact surrogate.
        evaluations: number of exact evaluations.
        quantities: quantities of interest of each sample by name, (n,) or (n, 3) in SI.
        shapes: of each computed shape, mean and standard deviation of its nodes' coordinates, (nodes, 3) m.
    """

    samples: Floats
    differences: Floats
    acceptance: float
    evaluations: int
    quantities: Mapping[str, Floats] = field(default_factory=dict)
    shapes: Mapping[str, tuple[Floats, Floats]] = field(default_factory=dict)

    @property
    def quantiles(self) -> Floats:
        """Quantiles of the parameters at 2.5, 25, 50, 75 and 97.5 %, (5, k)."""
        return np.asarray(np.quantile(self.samples, _QUANTILES, axis=0))

    @property
    def effective_size(self) -> float:
        """Number of independent samples that would be as good.

        With independent proposals, (Σ n)²/Σ n² of the numbers n of times that samples are repeated is the length of
        the chain over its autocorrelation time.
        """
        is_new = np.any(np.diff(self.samples, axis=0) != 0, axis=1)
        ends = np.concatenate([[0], np.flatnonzero(is_new) + 1, [len(self.samples)]])
        return float(len(self.samples) ** 2 / (np.diff(ends) ** 2).sum())

    def band(self, name: str) -> tuple[Floats, Floats]:
        """Return the quantiles of a quantity at 2.5 and 97.5 %."""
        low, high = np.quantile(self.quantities[name], (_QUANTILES[0], _QUANTILES[-1]), axis=0)
        return low, high

    @property
    def shape_deviations(self) -> dict[str, float]:
        """Largest standard deviation √(Σ of the three coordinates' variances) of a node by shape, in m."""
        return {name: float(np.sqrt((sd**2).sum(axis=1)).max()) for name, (_, sd) in self.shapes.items()}

    def as_data(self) -> dict[str, Any]:
        return {
            "samples": len(self.samples),
            "acceptance": self.acceptance,
            "effective_size": self.effective_size,
            "evaluations": self.evaluations,
            "mean": self.samples.mean(axis=0),
            "sd": self.samples.std(axis=0, ddof=1),
            "probabilities": list(_QUANTILES),
            "quantiles": self.quantiles,
            "quantities": {name: np.quantile(values, _QUANTILES, axis=0) for name, values in self.quantities.items()},
            "shapes": {name: {"sd": sd} for name, sd in self.shape_deviations.items()},
        }


def sample(target: Target, count: int, seed: int, steps: int = _STEPS) -> Posterior:
    """Return samples of the posterior after ``count`` exact evaluations of the second stage.

    Args:
        steps: of each walker of the first stage.

    Raises:
        JobError: the sampler is not installed.
    """
    surrogate = _Surrogate(target)
    proposals = _walk(surrogate, count, seed, steps)
    random = np.random.default_rng(seed)
    chain: list[tuple[Floats, Floats]] = []
    weight, accepted = -np.inf, 0
    for z in proposals:
        values = surrogate.values(z)
        exact = target.differences(values)
        surrogate.evaluations += 1
        new = -np.inf if exact is None else float(surrogate.chi(z) - exact[0] @ exact[0]) / 2
        if exact is not None and (not chain or np.log(random.uniform()) < new - weight):
            accepted += bool(chain)
            chain.append((values, exact[0]))
            weight = new
        elif chain:
            chain.append(chain[-1])
    if not chain:
        raise JobError("posterior: no sample has a solution: give closer bounds or priors")
    return Posterior(
        np.array([values for values, _ in chain]),
        np.array([r for _, r in chain]),
        accepted / max(len(proposals) - 1, 1),
        surrogate.evaluations,
    )


class _Surrogate:
    """Differences to second order about the estimate."""

    def __init__(self, target: Target) -> None:
        self.target, self.evaluations = target, 1
        self._axes = np.linalg.cholesky(target.covariance)
        center = target.differences(target.center)
        assert center is not None  # the estimate has a solution
        self._r, self._A = center[0], center[1] @ self._axes
        k = len(target.center)
        self._H = np.zeros((len(self._r), k, k))
        for axis in range(k):
            self._H[:, axis, :] = self._curvature(axis)
        self._H = (self._H + self._H.transpose(0, 2, 1)) / 2

    def _curvature(self, axis: int) -> Floats:
        """Return the change of the derivatives along an axis; 0 where it has no two points."""
        points = [(0.0, self._A)]
        for sign in (-1.0, 1.0):
            z = np.zeros(len(self.target.center))
            z[axis] = sign * _AXIS_STEP
            values = self.values(z)
            if np.isfinite(self.target.prior_chi(values)):
                self.evaluations += 1
                if (there := self.target.differences(values)) is not None:
                    points.append((z[axis], there[1] @ self._axes))
        first, last = min(points, key=lambda point: point[0]), max(points, key=lambda point: point[0])
        return (last[1] - first[1]) / (last[0] - first[0]) if last[0] > first[0] else np.zeros_like(self._A)

    def values(self, z: Floats) -> Floats:
        """Return the parameters at points (…, k)."""
        return np.asarray(self.target.center + z @ self._axes.T)

    def chi(self, z: Floats) -> Floats:
        """Return χ² of the observations at points (…, k)."""
        products = (z[..., :, None] * z[..., None, :]).reshape(*z.shape[:-1], -1)
        r = self._r + z @ self._A.T + products @ self._H.reshape(len(self._r), -1).T / 2
        return np.asarray((r**2).sum(axis=-1))

    def log_density(self, z: Floats) -> Floats:
        return np.asarray(-(self.chi(z) + self.target.prior_chi(self.values(z))) / 2)


def _walk(surrogate: _Surrogate, count: int, seed: int, steps: int) -> Floats:
    """Return samples (count, k) of the surrogate's posterior, far apart in the chains of its walkers."""
    try:
        import emcee
    except ImportError:
        raise JobError("the posterior needs the package 'emcee': pip install 'hpcinv[posterior]'") from None
    random = np.random.default_rng(seed)
    k = len(surrogate.target.center)
    walkers = max(_WALKERS * k, 8)
    start: list[Floats] = []
    while len(start) < walkers:
        z = 0.5 * random.standard_normal(k)
        if np.isfinite(surrogate.log_density(z)):
            start.append(z)
    sampler = emcee.EnsembleSampler(walkers, k, surrogate.log_density, vectorize=True)
    state = emcee.State(np.array(start), random_state=np.random.RandomState(seed).get_state())
    sampler.run_mcmc(state, steps, skip_initial_state_check=True)
    flat = sampler.get_chain(discard=steps // 4, flat=True)
    return np.asarray(flat[random.choice(len(flat), count, replace=len(flat) < count)])
