"""Weighted least squares of the parameters of a job, by its exact derivatives, and what the data say of them.

Minimized is ``χ² = Σ ((computed - observed)/σ)² + Σ ((θ - mean)/σ_prior)²``, by the trust-region method of
`scipy.optimize.least_squares` (a Levenberg–Marquardt method with bounds), on rank 0; all ranks solve.

Hidden forces are sought if χ² without them is too large for the standard deviations of the observations. Their strength
then has the largest evidence (MacKay).

Sources: Branch, Coleman & Li, "A subspace, interior, and conjugate gradient method for large-scale bound-constrained
minimization problems" (1999), doi:10.1137/S1064827595289108; MacKay, "Bayesian interpolation" (1992),
doi:10.1162/neco.1992.4.3.415.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.optimize
import scipy.stats

from hpcinv.errors import JobError, SolveError
from hpcinv.job.identification import bounds_of, prior_of, start_of
from hpcinv.job.sensitivities import Parameter
from hpcinv.mesh.source import Floats
from hpcinv.studies.fitting.linearised import Combination, Linearised, correlation_of
from hpcinv.studies.identification.job_evaluation import Evaluation, Evaluations
from hpcinv.studies.identification.posterior import Posterior, Target, sample

DEPENDENT = 1e-7
"""ratio of singular values, relative to the parameters, below which a combination changes no data"""
_TOLERANCE = 1e-8  # of the parameters
_INSIGNIFICANT = 1e-4  # change of χ² with which the search ends, a hundredth of a standard deviation
_TIE = 1e-3  # to the starting values, in their sizes: what the data leave free stays there
_DIGITS = 10  # of the parameters
_AT_BOUND = 1e-6
_STRENGTHS = (1e-4, 1e4)
"""Range of the strength of hidden forces, in their priors' standard deviations. A wider one admits larger forces."""
_REJECTED = 0.95
"""Probability of a smaller χ² without hidden forces, above which they are sought. Higher: fewer spurious forces."""
_SEED = 1  # of samples of the posterior: a killed command takes the same ones again
_SAME_STRENGTH = 0.1  # relative change of the strength that is no longer followed
_MOST_STRENGTHS = 5
_IDLE = 1e-6  # standard deviations by which data change as a parameter doubles, below which they do not depend on it


@dataclass(frozen=True)
class Residuals:
    """Differences of one observation from what is computed, in its standard deviations."""

    name: str
    values: Floats
    deviation: float

    @property
    def rms(self) -> float:
        return float(np.sqrt((self.values**2).mean()))

    @property
    def largest(self) -> float:
        return float(np.abs(self.values).max())


@dataclass(frozen=True)
class HiddenForces:
    """Choice of the strength of hidden forces.

    Attributes:
        strength: number by which the standard deviations of their priors are multiplied; 0 if none is needed.
        without: χ² of the observations without them.
        numbers: number of observed numbers, which χ² is on average without errors of the model.
        unused: places of the parameters that stay at their means, if none is needed.
    """

    strength: float
    without: float
    numbers: int
    unused: tuple[int, ...] = ()


@dataclass(frozen=True)
class ParameterEstimate:
    """Parameters that fit the observations best.

    Attributes:
        values: in SI, (k,).
        scales: sizes of the parameters in combinations, (k,): the values', if they are not zero.
        jacobian: of the residuals in standard deviations, (n, k), without priors.
        priors: mean and standard deviation by parameter, ``None`` without one.
        bound_flags: whether parameters are at a bound.
        history: χ² after each evaluation, infinite where a state was not reached.
        converged: whether the tolerance was met; otherwise the evaluations ended it.
        hidden: what was found of hidden forces; ``None`` without any.
        sampled: samples of the posterior, if they were asked for.
    """

    parameters: Sequence[Parameter]
    values: Floats
    scales: Floats
    residuals: tuple[Residuals, ...]
    jacobian: Floats
    priors: Sequence[tuple[float, float] | None]
    bound_flags: Sequence[bool]
    evaluations: Sequence[Evaluation]
    history: Sequence[float]
    converged: bool
    hidden: HiddenForces | None = None
    sampled: Posterior | None = None

    @cached_property
    def posterior(self) -> Linearised:
        """Observations and priors, linearised."""
        rows = [np.eye(len(self.values))[i] / p[1] for i, p in enumerate(self.priors) if p is not None]
        return Linearised(
            np.concatenate([self.jacobian, np.reshape(rows, (-1, len(self.values)))]), self.scales, DEPENDENT
        )

    @cached_property
    def covariance(self) -> Floats:
        """Covariance (k, k), within the combinations that are determined."""
        return self.posterior.covariance()

    @property
    def correlation(self) -> Floats:
        return correlation_of(self.covariance)

    @cached_property
    def deviations(self) -> list[float | None]:
        """Standard deviations (SI), ``None`` of parameters that are not determined."""
        free = self.posterior.undetermined()
        deviations = np.sqrt(np.diag(self.covariance))
        return [None if i in free else float(sd) for i, sd in enumerate(deviations)]

    @property
    def combinations(self) -> list[Combination]:
        """Combinations of relative changes with independent errors, by the observations alone, best first.

        Hidden forces that are not needed are left out: they stay at their means.
        """
        unused = self.hidden.unused if self.hidden else ()
        used = [i for i in range(len(self.values)) if i not in unused]
        known = Linearised(self.jacobian[:, used], self.scales[used], DEPENDENT).combinations
        whole = np.eye(len(self.values))[used]
        return [replace(combination, vector=combination.vector @ whole) for combination in known]

    @property
    def chi_squared(self) -> float:
        """Of the observations."""
        return float(sum((residual.values**2).sum() for residual in self.residuals))

    @property
    def count(self) -> int:
        """Number of observed numbers."""
        return sum(len(residual.values) for residual in self.residuals)

    @property
    def freedom(self) -> int:
        """Degrees of freedom: observed numbers and priors, less determined combinations."""
        return self.count + sum(p is not None for p in self.priors) - len(self.values) + len(self.posterior.free())

    @property
    def probability(self) -> float | None:
        """Probability of at least this χ², with the priors', if model and standard deviations are right."""
        if self.freedom <= 0:
            return None
        total = self.chi_squared + sum(
            ((v - p[0]) / p[1]) ** 2 for v, p in zip(self.values, self.priors, strict=True) if p is not None
        )
        return float(scipy.stats.chi2.sf(total, self.freedom))


type Report = Callable[[int, Floats, float, Evaluation], None]
"""called on rank 0 with the number of an evaluation, the values, χ² and the evaluation"""


def estimate(evaluations: Evaluations, report: Report, samples: int = 0) -> ParameterEstimate:
    """Find the parameters, on all ranks; collective.

    Args:
        samples: number of exact evaluations that samples of the posterior take; 0 for none.

    Raises:
        JobError: on all ranks, if the observations cannot determine the parameters.
        SolveError: on all ranks, if the states are not reached with the starting values.
        Interrupted: on all ranks, if the run was asked to stop.
    """
    comm = evaluations.comm
    if comm.rank == 0:
        problem = _Problem(evaluations, report)
        result: ParameterEstimate | None = None
        try:
            result = problem.solve()
            if samples:
                sampled = problem.sampled(result, samples)
                result = replace(result, sampled=sampled, evaluations=problem.made)
        except (JobError, SolveError) as error:
            comm.bcast((None, error))
            raise
        comm.bcast((None, result))
        return result
    while True:
        values, ending = comm.bcast(None)
        if values is None:
            if isinstance(ending, Exception):
                raise ending
            assert isinstance(ending, ParameterEstimate)
            return ending
        evaluations.evaluate(values)


class _Problem:
    """The least squares on rank 0."""

    def __init__(self, evaluations: Evaluations, report: Report) -> None:
        section = evaluations.section
        self._evaluations, self._report = evaluations, report
        self.parameters = evaluations.parameters
        sought = [section.sought(p.key) for p in self.parameters]
        pairs = list(zip(self.parameters, sought, strict=True))
        self._start = np.array([start_of(p, s) for p, s in pairs])
        self._lower, self._upper = np.array([bounds_of(s) for s in sought]).T
        self._given_priors = self._priors = [prior_of(p, s) for p, s in pairs]
        self._forces = [i for i, s in enumerate(sought) if s.prior and s.prior.strength == "evidence"]
        self._most = section.maximum_evaluations
        self._counts = [observed.count for observed in evaluations.observed]
        self._deviation = np.repeat([observed.deviation for observed in evaluations.observed], self._counts)
        self._unit = np.array([self._size(i) for i in range(len(pairs))])
        self._known: dict[bytes, Evaluation] = {}
        self._history: list[float] = []

    def _size(self, i: int) -> float:
        """Return the size of a parameter, its divisor."""
        prior, width = self._priors[i], self._upper[i] - self._lower[i]
        candidates = [abs(self._start[i]), prior[1] if prior else 0.0, width if np.isfinite(width) else 0.0]
        return float(next((c for c in candidates if c > 0), 1.0))

    def solve(self) -> ParameterEstimate:
        first = self._evaluation(self._start)
        if first.failure:
            raise SolveError(
                f"with the starting values a state was not reached: {first.failure}",
                "See why with 'hpcinv run' on this job, or choose other values of 'start' in the section 'identify'.",
            )
        self._check(first)
        if self._forces:
            values, converged, hidden = self._with_hidden_forces()
        else:
            values, converged = self._minimised(self._start, range(len(self._start)))
            hidden = None
        last = self._evaluation(values)
        parts = np.split(last.differences / self._deviation, np.cumsum(self._counts)[:-1])
        observed = self._evaluations.observed
        tolerance = _AT_BOUND * self._unit
        return ParameterEstimate(
            parameters=self.parameters,
            values=values,
            scales=np.where(values != 0.0, np.abs(values), self._unit),
            residuals=tuple(Residuals(o.spec.name, r, o.deviation) for o, r in zip(observed, parts, strict=True)),
            jacobian=last.jacobian / self._deviation[:, None],
            priors=self._priors,
            bound_flags=((values - self._lower < tolerance) | (self._upper - values < tolerance)).tolist(),
            evaluations=self.made,
            history=self._history,
            converged=converged,
            hidden=hidden,
        )

    def sampled(self, estimated: ParameterEstimate, count: int) -> Posterior:
        """Return samples of the posterior about the estimate."""
        if free := estimated.posterior.undetermined():
            keys = " and ".join(self.parameters[i].key for i in free)
            raise JobError(
                f"{self._evaluations.job.path}: identify: {keys} is not determined, so that it has no posterior:"
                " give a prior, or observe more"
            )

        def differences(values: Floats) -> tuple[Floats, Floats] | None:
            evaluation = self._evaluation(values)
            if evaluation.failure:
                return None
            return evaluation.differences / self._deviation, evaluation.jacobian / self._deviation[:, None]

        target = Target(
            differences, estimated.values, estimated.covariance, self._lower, self._upper, list(self._priors)
        )
        posterior = sample(target, count, _SEED)
        samples = [self._evaluation(values) for values in posterior.samples]
        return replace(
            posterior,
            quantities={name: np.array([s.quantities[name] for s in samples]) for name in samples[0].quantities},
            shapes={name: _moments([s.shapes[name] for s in samples]) for name in samples[0].shapes},
        )

    @property
    def made(self) -> list[Evaluation]:
        """Evaluations so far, without their shapes."""
        return [replace(evaluation, shapes={}) for evaluation in self._known.values()]

    def _minimised(self, start: Floats, free: Sequence[int]) -> tuple[Floats, bool]:
        """Return the values that minimize χ², where only some parameters are free, and whether they converged."""
        chosen, x = list(free), start / self._unit
        if not chosen:
            return start, True

        def whole(part: Floats) -> Floats:
            values = x.copy()
            values[chosen] = part
            return np.asarray(values)

        solution = scipy.optimize.least_squares(
            lambda part: self._residuals(whole(part)),
            self._inner_point(x)[chosen],
            jac=lambda part: self._jacobian(whole(part))[:, chosen],
            bounds=((self._lower / self._unit)[chosen], (self._upper / self._unit)[chosen]),
            x_scale="jac",
            ftol=_INSIGNIFICANT / max(sum(self._counts), 1),
            xtol=_TOLERANCE,
            gtol=_TOLERANCE**1.5,
            max_nfev=self._most,
        )
        values: Floats = whole(solution.x) * self._unit
        return values, bool(solution.status > 0)

    def _with_hidden_forces(self) -> tuple[Floats, bool, HiddenForces]:
        """Return the values, whether they converged, and what was found of hidden forces."""
        others = [i for i in range(len(self._start)) if i not in self._forces]
        start, numbers = self._start.copy(), sum(self._counts)
        for i in self._forces:
            start[i] = self._prior(i)[0]
        values, converged = self._minimised(start, others)
        without = float((self._weighted(values) ** 2).sum())
        freedom = max(numbers - len(others), 1)
        self._set_strength(_STRENGTHS[0])
        strength = 0.0
        if without > scipy.stats.chi2.ppf(_REJECTED, freedom):
            for _ in range(_MOST_STRENGTHS):
                earlier, strength = strength, self._strength(values)
                if earlier and abs(strength / earlier - 1) < _SAME_STRENGTH:
                    break
                self._set_strength(strength)
                values, converged = self._minimised(values, range(len(values)))
        unused = () if strength else tuple(self._forces)
        return values, converged, HiddenForces(strength, without, numbers, unused)

    def _prior(self, i: int) -> tuple[float, float]:
        prior = self._given_priors[i]
        assert prior is not None  # of a hidden force
        return prior

    def _set_strength(self, strength: float) -> None:
        """Multiply the standard deviations of hidden forces."""
        self._priors = [
            (p[0], strength * p[1]) if p is not None and i in self._forces else p
            for i, p in enumerate(self._given_priors)
        ]

    def _weighted(self, values: Floats) -> Floats:
        """Return the differences in standard deviations."""
        weighted: Floats = self._evaluation(values).differences / self._deviation
        return weighted

    def _strength(self, values: Floats) -> float:
        """Return the strength with the largest evidence, of the observations linearised at some values.

        Without hidden forces, differences ``r`` in standard deviations have the covariance 1, and with their priors
        ``1 + s² A Aᵀ``. Combinations that the other parameters change are left out.
        """
        jacobian = self._evaluation(values).jacobian / self._deviation[:, None]
        means = np.array([self._prior(i)[0] for i in self._forces])
        deviations = np.array([self._prior(i)[1] for i in self._forces])
        r = self._weighted(values) - jacobian[:, self._forces] @ (values[self._forces] - means)
        changed = np.linalg.qr(np.delete(jacobian, self._forces, axis=1) * np.delete(self._unit, self._forces))[0]
        r, A = (part - changed @ (changed.T @ part) for part in (r, jacobian[:, self._forces] * deviations))
        modes, sizes, _ = np.linalg.svd(A, full_matrices=False)
        squares = (modes.T @ r) ** 2

        def surprise(logarithm: float) -> float:
            variances = 1 + (10.0**logarithm * sizes) ** 2
            return float((squares / variances + np.log(variances)).sum())

        low, high = np.log10(_STRENGTHS)
        coarse = np.linspace(low, high, 81)
        best = coarse[int(np.argmin([surprise(logarithm) for logarithm in coarse]))]
        width = coarse[1] - coarse[0]
        fine = scipy.optimize.minimize_scalar(surprise, bounds=(best - width, best + width), method="bounded")
        return float(np.clip(10.0**fine.x, *_STRENGTHS))

    def _check(self, first: Evaluation) -> None:
        """Raise ``JobError`` if the observations cannot determine the parameters, whatever their values are."""
        where, k = f"{self._evaluations.job.path}: identify.parameters", len(self.parameters)
        known = [p is not None for p in self._priors]
        if len(first.differences) + sum(known) < k:
            raise JobError(
                f"{where}: {k} parameters are more than the {len(first.differences)} observed numbers and"
                f" {sum(known)} priors: seek fewer, or observe more"
            )
        changes = np.abs(first.jacobian * self._unit / self._deviation[:, None]).max(axis=0)
        idle = [
            p.key
            for p, change, has_prior in zip(self.parameters, changes, known, strict=True)
            if not change > max(DEPENDENT * changes.max(), _IDLE) and not has_prior
        ]
        if idle:
            raise JobError(
                f"{where}: nothing that was observed depends on {' and '.join(idle)}: remove it, give it a prior,"
                " or observe something that does"
            )

    def _inner_point(self, x: Floats) -> Floats:
        """Return a point strictly within the bounds, as the method needs it."""
        low, high = self._lower / self._unit, self._upper / self._unit
        margin = np.minimum(1e-6, np.where(np.isfinite(high - low), (high - low) / 10, 1e-6))
        return np.clip(x, low + margin, high - margin)

    def _evaluation(self, values: Floats) -> Evaluation:
        # Rounding errors, which depend on the ranks, must not hide that an evaluation was made before.
        values = np.array([float(f"{value:.{_DIGITS}g}") for value in values])
        key = values.tobytes()
        if key not in self._known:
            self._evaluations.comm.bcast((values, None))
            evaluation = self._evaluations.evaluate(values)
            assert evaluation is not None  # on rank 0
            self._known[key] = evaluation
            chi = np.inf if evaluation.failure else float(((evaluation.differences / self._deviation) ** 2).sum())
            self._history.append(chi)
            self._report(len(self._known), values, chi, evaluation)
        return self._known[key]

    def _residuals(self, x: Floats) -> Floats:
        values = x * self._unit
        evaluation = self._evaluation(values)
        if evaluation.failure:  # the method then takes a smaller step
            return np.full(sum(self._counts) + sum(p is not None for p in self._priors) + len(x), np.inf)
        priors = [(v - p[0]) / p[1] for v, p in zip(values, self._priors, strict=True) if p is not None]
        return np.concatenate([evaluation.differences / self._deviation, priors, _TIE * (x - self._start / self._unit)])

    def _jacobian(self, x: Floats) -> Floats:
        evaluation = self._evaluation(x * self._unit)
        rows = [np.eye(len(x))[i] / p[1] for i, p in enumerate(self._priors) if p is not None]
        whole = np.concatenate([evaluation.jacobian / self._deviation[:, None], np.reshape(rows, (-1, len(x)))])
        return np.concatenate([whole * self._unit, _TIE * np.eye(len(x))])


def _moments(shapes: Sequence[Floats]) -> tuple[Floats, Floats]:
    """Return mean and standard deviation (n, 3) of nodes; all shapes at once may not fit in memory."""
    mean = np.zeros(shapes[0].shape)
    for nodes in shapes:
        mean += nodes / len(shapes)
    squares = np.zeros_like(mean)
    for nodes in shapes:
        squares += (nodes - mean) ** 2
    return mean, np.sqrt(squares / max(len(shapes) - 1, 1))
