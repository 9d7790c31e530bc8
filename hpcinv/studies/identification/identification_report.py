"""Report of an identification: estimate, residuals and identifiability as text, as data, and as sections of a job."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import yaml

from hpcinv.base.quantity.keys import parse_key
from hpcinv.base.quantity.units import Dimension
from hpcinv.job.job import Job
from hpcinv.job.sensitivities import TIES, Parameter
from hpcinv.output.run_directory import as_yaml
from hpcinv.studies.fitting.candidate import quantity, short
from hpcinv.studies.fitting.fit_report import commented, rounded
from hpcinv.studies.fitting.linearised import Combination, correlations
from hpcinv.studies.identification.parameter_estimate import HiddenForces, ParameterEstimate
from hpcinv.studies.identification.posterior import Posterior

_VAGUE = 1.0  # relative standard deviation of a combination from which on it is called not determined
_ROUGH = 0.3  # share of accepted samples of the posterior below which they are too few
_UNLIKELY = 1e-3  # probability of χ² below which the model does not describe the data
_SMALL = 0.05  # share of a parameter in a combination, relative to the largest, that is left out


def value_text(parameter: Parameter, value: float, digits: int = 5) -> str:
    """Return a value (SI) of a parameter with its unit."""
    return short(value, parameter.dimension or Dimension(), digits)


def describe(estimate: ParameterEstimate) -> list[str]:
    """Return the report as lines."""
    lines = ["estimate:"]
    for p, value, sd, bound in zip(
        estimate.parameters, estimate.values, estimate.deviations, estimate.bound_flags, strict=True
    ):
        if sd is None:
            spread = "not determined by itself (below)"
        else:
            spread = f"± {value_text(p, sd, 2)}" + (f" ({sd / abs(value):.2g} of it)" if value else "")
        lines.append(f"  {p.key} = {value_text(p, value)} {spread}{', at its bound' if bound else ''}")
    if correlation := _correlation(estimate):
        lines.append(f"  {correlation}")
    probability = estimate.probability
    chance = "" if probability is None else f"; as large by chance: {probability:.2g}"
    lines.append(f"chi-square: {estimate.chi_squared:.4g}, {estimate.freedom} degrees of freedom{chance}")
    if estimate.hidden is not None:
        lines.append(f"hidden forces: {_hidden_text(estimate.hidden)}")
    lines.append("residuals, in standard deviations:")
    lines += [
        f"  {residual.name}: {len(residual.values)} numbers, root mean square {residual.rms:.3g},"
        f" largest {residual.largest:.3g}"
        for residual in estimate.residuals
    ]
    if estimate.sampled is not None:
        lines += _posterior_lines(estimate.parameters, estimate.sampled)
    lines.append("identifiability by the observations alone:")
    lines += [f"  {text}" for text in identifiability(estimate)]
    return lines


def _posterior_lines(parameters: Sequence[Parameter], sampled: Posterior) -> list[str]:
    lines = [
        f"posterior, {len(sampled.samples)} samples, {sampled.evaluations} exact evaluations,"
        f" {100 * sampled.acceptance:.0f} % of the surrogate's proposals accepted,"
        f" as good as {sampled.effective_size:.0f} independent samples:"
    ]
    for p, (low, _, median, _, high) in zip(parameters, sampled.quantiles.T, strict=True):
        texts = [value_text(p, float(value), 4) for value in (median, low, high)]
        lines.append(f"  {p.key}: median {texts[0]}, 95 % from {texts[1]} to {texts[2]}")
    lines += [
        f"  shape{f' {name!r}' if name else ''}: standard deviation up to {sd:.2g} m"
        for name, sd in sampled.shape_deviations.items()
    ]
    return lines


def _hidden_text(hidden: HiddenForces) -> str:
    without = f"chi-square without them is {hidden.without:.4g} of {hidden.numbers} numbers"
    if hidden.strength == 0.0:
        return f"none is needed, {without}"
    return f"found with {hidden.strength:.2g} of their priors' standard deviations, {without}"


def _correlation(estimate: ParameterEstimate) -> str:
    """Return the correlations as text, empty if not all parameters are determined."""
    if len(estimate.values) == 1 or None in estimate.deviations:
        return ""
    return f"correlation: {correlations([p.key for p in estimate.parameters], estimate.correlation)}"


def identifiability(estimate: ParameterEstimate) -> list[str]:
    """Return what the observations determine, and what they leave free, one line for each combination."""
    return [_combination_text(estimate, combination) for combination in estimate.combinations]


def _combination_text(estimate: ParameterEstimate, combination: Combination) -> str:
    powers = combination.vector / combination.vector[np.argmax(np.abs(combination.vector))]
    involved = [
        (p.key, float(power)) for p, power in zip(estimate.parameters, powers, strict=True) if abs(power) > _SMALL
    ]
    if not combination.deviation < _VAGUE:
        together = " and ".join(f"{key} by {_factor(power)}" for key, power in involved)
        if np.isfinite(combination.deviation):
            effect = f"changes the data by {1 / combination.deviation:.2g} standard deviations per 100 %"
        else:
            effect = "changes nothing that was observed"
        advice = "know one of them otherwise" if len(involved) > 1 else "know it otherwise"
        return f"not determined: to multiply {together} {effect} ({advice}, give a prior, or observe more)"
    product = " · ".join(key if abs(power - 1) < 5e-3 else f"{key}^{power:.2g}" for key, power in involved)
    spread = combination.deviation * float(np.abs(combination.vector).max() ** -1)
    return f"determined: {product} to {100 * spread:.2g} %"


def _factor(power: float) -> str:
    return "f" if abs(power - 1) < 5e-3 else f"f^{power:.2g}"


def warnings(estimate: ParameterEstimate) -> list[str]:
    """Return what a user should know before the estimate is used."""
    texts = []
    if not estimate.converged:
        texts.append("the evaluations ended before χ² was least: raise identify.maximum_evaluations")
    free = [p.key for p, sd in zip(estimate.parameters, estimate.deviations, strict=True) if sd is None]
    if free:
        texts.append(f"the observations do not determine {' and '.join(free)}: the values are one choice of many")
    texts += [
        f"{p.key} is at its bound: its standard deviation is from linear least squares without bounds"
        for p, bound in zip(estimate.parameters, estimate.bound_flags, strict=True)
        if bound
    ]
    if estimate.sampled is not None and estimate.sampled.acceptance < _ROUGH:
        texts.append(
            f"only {100 * estimate.sampled.acceptance:.0f} % of the surrogate's proposals were accepted;"
            " raise --posterior"
        )
    probability = estimate.probability
    if probability is not None and probability < _UNLIKELY:
        texts.append(
            "the observations differ from the model by more than their standard deviations:"
            " check these and the model; the parameters' deviations are too small"
        )
    return texts


def as_data(estimate: ParameterEstimate) -> dict[str, Any]:
    """Return all figures, in SI, as plain data."""
    return {
        "parameters": [
            {
                "key": p.key,
                "value": float(value),
                "unit": p.dimension.unit if p.dimension else "",
                **{kind: p.tied_keys.get(kind, []) for kind in TIES},
                "standard_deviation": sd,
                "at_bound": bound,
                "prior": prior and {"mean": prior[0], "sd": prior[1]},
            }
            for p, value, sd, bound, prior in zip(
                estimate.parameters,
                estimate.values,
                estimate.deviations,
                estimate.bound_flags,
                estimate.priors,
                strict=True,
            )
        ],
        "covariance": estimate.covariance,
        "correlation": estimate.correlation,
        "chi_squared": estimate.chi_squared,
        "posterior": estimate.sampled and estimate.sampled.as_data(),
        "hidden_forces": estimate.hidden and asdict(estimate.hidden),
        "degrees_of_freedom": estimate.freedom,
        "probability": estimate.probability,
        "observations": [
            {
                "name": entry.name,
                "numbers": len(entry.values),
                "sd": entry.deviation,
                "rms": entry.rms,
                "largest": entry.largest,
            }
            for entry in estimate.residuals
        ],
        "combinations": [
            {"relative": entry.vector, "sd": entry.deviation if np.isfinite(entry.deviation) else None}
            for entry in estimate.combinations
        ],
        "identifiability": identifiability(estimate),
        "warnings": warnings(estimate),
        "converged": estimate.converged,
        "chi_squared_by_evaluation": estimate.history,
    }


def changes(estimate: ParameterEstimate) -> dict[str, float | str]:
    """Return the values by key, with the digits that a job needs."""
    return {
        number.key: quantity(number.ratio * float(v), number.dimension or Dimension())
        for p, v in zip(estimate.parameters, estimate.values, strict=True)
        for number in (p, *p.ties)
    }


def sensitivities(estimate: ParameterEstimate) -> dict[str, Any]:
    """Return the section of standard deviations, ``None`` for parameters that are not determined."""
    section: dict[str, Any] = {}
    for p, sd in zip(estimate.parameters, estimate.deviations, strict=True):
        text = None if sd is None else rounded(sd, p.dimension or Dimension())
        section[p.key] = {"sd": text, **p.tied_keys} if p.ties else text
    return section


def derivatives(estimate: ParameterEstimate) -> dict[str, Any]:
    """Return the section of the run at the estimate: without standard deviations, which would not be independent."""
    return {p.key: {"sd": None, **p.tied_keys} if p.ties else None for p in estimate.parameters}


def sections(job: Job, estimate: ParameterEstimate) -> str:
    """Return those sections of the job at the estimate that it changes, and ``sensitivities``, as YAML.

    Args:
        job: with the values of the estimate.
    """
    assert job.identify is not None
    names = dict.fromkeys(str(parse_key(key)[0]) for key in job.identify.keys)
    body: dict[str, Any] = {name: job.data[name] for name in names}
    body["sensitivities"] = sensitivities(estimate)
    return commented(
        yaml.safe_load(as_yaml(body)), "found by 'hpcinv identify'", _correlation(estimate), warnings(estimate)
    )
