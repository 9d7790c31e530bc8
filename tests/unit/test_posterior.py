"""The posterior of identified parameters: calibrated on a model without a mesh, and equal to quadrature."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.optimize
import scipy.stats

from hpcinv.studies.identification.posterior import Posterior, Target, sample

emcee = pytest.importorskip("emcee")
X = np.linspace(0.0, 1.5, 5)
SD = 0.25
PRIORS = ((1.0, 0.4), (0.5, 0.4))
NO_BOUNDS = np.full(2, np.inf)


def target(data: np.ndarray, upper: np.ndarray = NO_BOUNDS) -> Target:
    """``a exp(b x)`` with errors, whose posterior is not normal."""

    def differences(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a, b = values
        growth = np.exp(b * X)
        return (a * growth - data) / SD, np.stack([growth, a * X * growth], axis=1) / SD

    def whole(values: np.ndarray) -> np.ndarray:
        pulls = [(v - mean) / sd for v, (mean, sd) in zip(values, PRIORS, strict=True)]
        return np.concatenate([differences(values)[0], pulls])

    found = scipy.optimize.least_squares(whole, [mean for mean, _ in PRIORS])
    return Target(differences, found.x, np.linalg.inv(found.jac.T @ found.jac), -NO_BOUNDS, upper, PRIORS)


def draw(random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Parameters of the prior, and data that they make."""
    values = np.array([random.normal(mean, sd) for mean, sd in PRIORS])
    return values, values[0] * np.exp(values[1] * X) + SD * random.standard_normal(len(X))


@pytest.mark.release
def test_simulation_based_calibration() -> None:
    """Ranks of the true parameters among samples are uniform (Talts et al. 2018, arXiv:1804.06788)."""
    random = np.random.default_rng(7)
    ranks, acceptance = [], []
    for seed in range(50):
        values, data = draw(random)
        posterior = sample(target(data), 39, seed, steps=150)
        ranks.append((posterior.samples < values).sum(axis=0))
        acceptance.append(posterior.acceptance)
    for parameter in np.transpose(ranks):
        counts = np.bincount(np.minimum(parameter // 8, 4), minlength=5)
        probability = scipy.stats.chisquare(counts).pvalue
        print(f"ranks by fifth {counts}, as uneven by chance {probability:.2g}; acceptance {np.mean(acceptance):.2f}")
        assert probability > 1e-3
    assert np.mean(acceptance) > 0.8


def test_effective_size() -> None:
    """A chain of independent proposals, a share a accepted, has an autocorrelation time of (2 - a)/a."""
    random, accepted = np.random.default_rng(2), 0.4
    new = np.cumsum(random.uniform(size=20_000) < accepted)
    samples = random.standard_normal((new[-1] + 1, 2))[new]
    (time,) = emcee.autocorr.integrated_time(samples)
    chain = Posterior(samples, samples, accepted, len(samples))
    print(len(samples) / chain.effective_size, time)
    assert len(samples) / chain.effective_size == pytest.approx((2 - accepted) / accepted, rel=0.05)
    assert time == pytest.approx((2 - accepted) / accepted, rel=0.2)


def test_samples_have_the_exact_posterior() -> None:
    """Means and standard deviations by quadrature, also where a bound cuts the posterior."""
    data = np.array([0.6, 1.3, 1.1, 2.4, 2.2])
    for upper in (NO_BOUNDS, np.array([np.inf, 0.6])):
        found = target(data, upper)
        posterior: Posterior = sample(found, 1500, 3, steps=1000)
        a, b = np.meshgrid(np.linspace(-0.5, 2.5, 301), np.linspace(-1, min(upper[1], 2), 301), indexing="ij")
        points = np.stack([a, b], axis=-1)
        chi = found.prior_chi(points) + (((a[..., None] * np.exp(b[..., None] * X) - data) / SD) ** 2).sum(axis=-1)
        weights = np.exp(-chi / 2)[..., None] / np.exp(-chi / 2).sum()
        mean = (weights * points).sum(axis=(0, 1))
        sd = np.sqrt((weights * (points - mean) ** 2).sum(axis=(0, 1)))
        print(posterior.samples.mean(axis=0), mean, posterior.samples.std(axis=0), sd, posterior.acceptance)
        assert posterior.samples.mean(axis=0) == pytest.approx(mean, abs=0.15 * sd.min())
        assert posterior.samples.std(axis=0) == pytest.approx(sd, rel=0.1)
        assert (posterior.samples <= upper).all()
