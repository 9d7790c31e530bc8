"""Report of an identification: estimate, residuals and identifiability as text, as data, and as sections of a job."""

from typing import Any

import numpy as np
import yaml

from hpcinv.fitting.candidate import quantity, short
from hpcinv.fitting.fit_report import commented, rounded
from hpcinv.fitting.linearised import Combination, correlations
from hpcinv.identification.gauss_newton import ParameterEstimate
from hpcinv.job.identification import Identification
from hpcinv.job.job import Job
from hpcinv.job.sensitivities import Parameter
from hpcinv.output.run_directory import as_yaml
from hpcinv.quantity.keys import parse_key
from hpcinv.quantity.units import Dimension

_VAGUE = 1.0  # relative standard deviation of a combination from which on it is called not determined
_UNLIKELY = 1e-3  # probability of χ² below which the model does not describe the data
_SMALL = 0.05  # share of a parameter in a combination, relative to the largest, that is left out


def value_text(parameter: Parameter, value: float, digits: int = 5) -> str:
    """Return a value (SI) of a parameter with its unit."""
    return short(value, parameter.dimension or Dimension(), digits)


def describe(found: ParameterEstimate) -> list[str]:
    """Return the report as lines."""
    lines = ["estimate:"]
    for p, value, sd, bound in zip(found.parameters, found.values, found.deviations, found.at_bound, strict=True):
        if sd is None:
            spread = "not determined by itself (below)"
        else:
            spread = f"± {value_text(p, sd, 2)}" + (f" ({sd / abs(value):.2g} of it)" if value else "")
        lines.append(f"  {p.key} = {value_text(p, value)} {spread}{', at its bound' if bound else ''}")
    if correlation := _correlation(found):
        lines.append(f"  {correlation}")
    probability = found.probability
    chance = "" if probability is None else f"; as large by chance: {probability:.2g}"
    lines.append(f"chi-square: {found.chi_squared:.4g}, {found.freedom} degrees of freedom{chance}")
    lines.append("residuals, in standard deviations:")
    lines += [
        f"  {one.name}: {len(one.values)} numbers, root mean square {one.rms:.3g}, largest {one.largest:.3g}"
        for one in found.residuals
    ]
    lines.append("identifiability by the observations alone:")
    lines += [f"  {text}" for text in identifiability(found)]
    return lines


def _correlation(found: ParameterEstimate) -> str:
    """Return the correlations as text, empty if not all parameters are determined."""
    if len(found.values) == 1 or None in found.deviations:
        return ""
    return f"correlation: {correlations([p.key for p in found.parameters], found.correlation)}"


def identifiability(found: ParameterEstimate) -> list[str]:
    """Return what the observations determine, and what they leave free, one line for each combination."""
    return [_in_words(found, one) for one in found.combinations]


def _in_words(found: ParameterEstimate, one: Combination) -> str:
    powers = one.vector / one.vector[np.argmax(np.abs(one.vector))]
    involved = [(p.key, float(power)) for p, power in zip(found.parameters, powers, strict=True) if abs(power) > _SMALL]
    if not one.deviation < _VAGUE:
        together = " and ".join(f"{key} by {_factor(power)}" for key, power in involved)
        if np.isfinite(one.deviation):
            effect = f"changes the data by {1 / one.deviation:.2g} standard deviations per 100 %"
        else:
            effect = "changes nothing that was observed"
        advice = "know one of them otherwise" if len(involved) > 1 else "know it otherwise"
        return f"not determined: to multiply {together} {effect} ({advice}, give a prior, or observe more)"
    product = " · ".join(key if abs(power - 1) < 5e-3 else f"{key}^{power:.2g}" for key, power in involved)
    spread = one.deviation * float(np.abs(one.vector).max() ** -1)
    return f"determined: {product} to {100 * spread:.2g} %"


def _factor(power: float) -> str:
    return "f" if abs(power - 1) < 5e-3 else f"f^{power:.2g}"


def warnings(found: ParameterEstimate) -> list[str]:
    """Return what a user should know before the estimate is used."""
    texts = []
    if not found.converged:
        texts.append("the evaluations ended before χ² was least: raise identify.maximum_evaluations")
    free = [p.key for p, sd in zip(found.parameters, found.deviations, strict=True) if sd is None]
    if free:
        texts.append(f"the observations do not determine {' and '.join(free)}: the values are one choice of many")
    texts += [
        f"{p.key} is at its bound: its standard deviation is that of linear least squares without bounds"
        for p, bound in zip(found.parameters, found.at_bound, strict=True)
        if bound
    ]
    probability = found.probability
    if probability is not None and probability < _UNLIKELY:
        texts.append(
            "the observations differ from the model by more than their standard deviations: these, or the model, are"
            " wrong, and those of the parameters are too small"
        )
    return texts


def as_data(found: ParameterEstimate) -> dict[str, Any]:
    """Return all figures, in SI, as plain data."""
    return {
        "parameters": [
            {
                "key": p.key,
                "value": float(value),
                "unit": p.dimension.unit if p.dimension else "",
                "standard_deviation": sd,
                "at_bound": bound,
                "prior": prior and {"mean": prior[0], "sd": prior[1]},
            }
            for p, value, sd, bound, prior in zip(
                found.parameters, found.values, found.deviations, found.at_bound, found.priors, strict=True
            )
        ],
        "covariance": found.covariance,
        "correlation": found.correlation,
        "chi_squared": found.chi_squared,
        "degrees_of_freedom": found.freedom,
        "probability": found.probability,
        "observations": [
            {"name": one.name, "numbers": len(one.values), "sd": one.deviation, "rms": one.rms, "largest": one.largest}
            for one in found.residuals
        ],
        "combinations": [
            {"relative": one.vector, "sd": one.deviation if np.isfinite(one.deviation) else None}
            for one in found.combinations
        ],
        "identifiability": identifiability(found),
        "warnings": warnings(found),
        "converged": found.converged,
        "chi_squared_by_evaluation": found.history,
    }


def changes(found: ParameterEstimate, section: Identification) -> dict[str, float | str]:
    """Return the values by key, with the digits that a job needs."""
    return {
        key: quantity(float(v), p.dimension or Dimension())
        for p, v in zip(found.parameters, found.values, strict=True)
        for key in section.keys_of(p.key)
    }


def sensitivities(found: ParameterEstimate) -> dict[str, Any]:
    """Return the section of standard deviations, ``None`` for parameters that are not determined."""
    section: dict[str, Any] = {}
    for p, sd in zip(found.parameters, found.deviations, strict=True):
        text = None if sd is None else rounded(sd, p.dimension or Dimension())
        section[p.key] = {"sd": text, "also": [tie.key for tie in p.ties]} if p.ties else text
    return section


def sections(job: Job, found: ParameterEstimate) -> str:
    """Return those sections of the job at the estimate that it changes, and ``sensitivities``, as YAML.

    Args:
        job: with the values of the estimate.
    """
    assert job.identify is not None
    names = dict.fromkeys(str(parse_key(key)[0]) for key in job.identify.keys)
    body: dict[str, Any] = {name: job.data[name] for name in names}
    body["sensitivities"] = sensitivities(found)
    return commented(yaml.safe_load(as_yaml(body)), "found by 'hpcinv identify'", _correlation(found), warnings(found))
