"""Sobol indices of the quantities of a finished sweep, and what they cost before it is run."""

import math
import statistics
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hpcinv.errors import JobError
from hpcinv.mesh.source import Floats
from hpcinv.studies.batch.axes import SAMPLES, Axis
from hpcinv.studies.batch.ledger.case_record import CaseRecord
from hpcinv.studies.batch.sampling import Distribution
from hpcinv.studies.batch.time_forecast import duration_text
from hpcinv.studies.sweep.cases import Case
from hpcinv.studies.sweep.chaos import GOOD, Bounded, Indices, Regression, cases_needed, mean, sobol_indices, terms
from hpcinv.studies.sweep.sweep_plan import SweepPlan
from hpcinv.studies.sweep.table import SweepTable

_CONSTANT = 1e-12  # standard deviation, relative to the largest value, that is rounding
_DEGREES_SHOWN = 6
_LISTED = 8  # numbers of failed cases in a line


@dataclass(frozen=True)
class ConvergedSample:
    """The one sample of a sweep, and its cases that have converged.

    Attributes:
        cases: that have converged, in order.
        failed: number of each case that has failed, and how.
    """

    plan: SweepPlan
    axis: Axis
    cases: tuple[Case, ...]
    failed: Mapping[int, str]

    @property
    def distributions(self) -> Mapping[str, Distribution]:
        """Distributions by key, whose order is the indices'."""
        return self.axis.sample

    @property
    def normal(self) -> list[bool]:
        return [distribution.kind == "normal" for distribution in self.distributions.values()]

    @cached_property
    def points(self) -> Floats:
        """Standardised parameters of the cases, (cases, parameters)."""
        rows = [[d.standard(case.parameters[key]) for key, d in self.distributions.items()] for case in self.cases]
        return np.array(rows).reshape(len(rows), len(self.distributions))


def sample_axis(plan: SweepPlan) -> Axis:
    """Return the one axis of a sweep that has more than one point, a sample.

    Raises:
        JobError: other axes have more than one point, too, or there is no sample.
    """
    axes = plan.sweep.axes
    samples = [i for i, axis in enumerate(axes) if axis.kind in SAMPLES]
    remedy = "; put all uncertain parameters on one sample (random, latin_hypercube, sobol)"
    problems = [
        f"{plan.path}: axes[{i}]: {'has' if axis.kind == 'branches' else 'is a'} {axis.kind}, whose points have no"
        " probability; give it one point in another sweep with the same store"
        for i, axis in enumerate(axes)
        if axis.kind not in SAMPLES and (axis.points > 1 or axis.kind == "branches")
    ]
    if not samples:
        problems.append(f"{plan.path}: axes: no axis is a sample, which says how probable values are{remedy}")
    elif len(samples) > 1:
        which = " and ".join(f"axes[{i}]" for i in samples)
        problems.append(f"{plan.path}: {which} are samples that are combined with each other{remedy}")
    if problems:
        raise JobError(*problems)
    return axes[samples[0]]


def finished_sample(plan: SweepPlan, records: Mapping[str, CaseRecord]) -> ConvergedSample:
    """Return the sample of a finished sweep.

    Raises:
        JobError: cases are open, or too few have converged for a surrogate of degree 1.
    """
    axis = sample_axis(plan)
    if left := sum(case.key not in records for case in plan.cases):
        raise JobError(
            f"{plan.path}: {left} of {len(plan.cases)} cases are not finished;"
            " finish them by 'sweep run', or take the first N with '--first N'"
        )
    converged = tuple(case for case in plan.cases if records[case.key].converged)
    failed = {case.number: records[case.key].status for case in plan.cases if not records[case.key].converged}
    needed = cases_needed(len(axis.sample), 1)
    if len(converged) < needed:
        raise JobError(
            f"{plan.path}: {len(converged)} cases have converged, but a surrogate of degree 1 in"
            f" {len(axis.sample)} parameters needs {needed}; raise the 'count' of the sample"
        )
    return ConvergedSample(plan, axis, converged, failed)


@dataclass(frozen=True)
class QuantityIndices:
    """Indices of one quantity of interest (SI).

    Attributes:
        cases: that have a value.
        indices: ``None`` if all values are the same.
    """

    name: str
    unit: str
    cases: int
    mean: Bounded
    indices: Indices | None


def quantity_indices(
    sample: ConvergedSample, records: Mapping[str, CaseRecord], confidence: float
) -> tuple[list[QuantityIndices], list[str]]:
    """Return the indices of each quantity of interest, and lines on quantities without them.

    Raises:
        JobError: the points of the sample determine no surrogate.
    """
    sweep_table = SweepTable(sample.plan, records.items())
    names, table, known_units = sweep_table.quantities(), sweep_table.columns(), sweep_table.units()
    place = {number: row for row, number in enumerate(table["number"])}
    rows = [place[case.number] for case in sample.cases]
    indices, left_out = [], []
    whole = regression_of(sample)
    for name in names:
        values = np.array([[math.nan if table[name][row] is None else float(table[name][row])] for row in rows])
        known = np.isfinite(values[:, 0])
        try:
            regression = whole if known.all() else Regression(sample.points[known], sample.normal)
        except ValueError as error:
            left_out.append(f"{name}: {known.sum()} of {len(rows)} converged cases have a value; {error}")
            continue
        indices.append(_indices_of_quantity(name, known_units.get(name, ""), regression, values[known], confidence))
    return indices, left_out


def _indices_of_quantity(
    name: str, unit: str, regression: Regression, values: Floats, confidence: float
) -> QuantityIndices:
    if np.std(values) <= _CONSTANT * np.max(np.abs(values)):
        value = float(np.mean(values))
        return QuantityIndices(name, unit, len(values), Bounded(value, value, value), None)
    surrogate = regression.fit(values)
    indices = sobol_indices(regression, surrogate, values, confidence)
    return QuantityIndices(name, unit, len(values), mean(regression, surrogate, confidence), indices)


def regression_of(sample: ConvergedSample) -> Regression:
    """Return the least squares at the points of a sample; raises ``JobError`` if they determine no surrogate."""
    try:
        return Regression(sample.points, sample.normal)
    except ValueError as error:
        raise JobError(f"{sample.plan.path}: {error}") from None


def describe_sample(sample: ConvergedSample, records: Mapping[str, CaseRecord]) -> Iterator[str]:
    """Yield lines on the cases that are used, and on those that are left out."""
    plan = sample.plan
    names = ", ".join(f"{key} ({d.kind})" for key, d in sample.distributions.items())
    yield f"{plan.sweep.sweep}: {len(sample.cases)} of {len(plan.cases)} cases, {sample.axis.kind} sample of {names}"
    numbers_by_status: dict[str, list[int]] = {}
    for number, status in sample.failed.items():
        numbers_by_status.setdefault(status, []).append(number)
    for status, numbers in numbers_by_status.items():
        more = ", …" if len(numbers) > _LISTED else ""
        yield f"left out: {len(numbers)} failed: {status}: case {', '.join(map(str, numbers[:_LISTED]))}{more}"
    if numbers_by_status:
        yield "  what follows continues the polynomials to the parameters of failed cases"
    if doubtful := sum(records[case.key].verdict == "fail" for case in sample.cases):
        yield f"included: {doubtful} whose certificate fails"


def describe(quantity: QuantityIndices, keys: Sequence[str], confidence: float) -> Iterator[str]:
    """Yield the lines on one quantity."""
    unit = f" {quantity.unit}" if quantity.unit else ""
    indices = quantity.indices
    if indices is None:
        yield f"{quantity.name}: constant, {quantity.mean.value:.6g}{unit} in all {quantity.cases} cases"
        return
    yield f"{quantity.name}: {accuracy(indices)}"
    if not indices.decided:
        yield f"  {advice(indices, len(keys))}"
        return
    yield (
        f"  mean {quantity.mean.value:.6g} [{quantity.mean.low:.6g}, {quantity.mean.high:.6g}]{unit},"
        f" standard deviation {indices.sd.value:.4g} [{indices.sd.low:.4g}, {indices.sd.high:.4g}]{unit}"
    )
    if indices.has_long_tail:
        yield f"  the values have a long tail (excess kurtosis {indices.kurtosis:.2g}): the intervals may be too narrow"
    yield from table_of(indices, keys, confidence)


def accuracy(indices: Indices) -> str:
    """Return a line on the surrogate, which begins with "not decided" where it is not good enough."""
    error = math.sqrt(max(1 - indices.q2, 0.0))
    return (
        f"{'' if indices.decided else 'not decided: '}degree {indices.degree} ({indices.terms} terms), leave-one-out"
        f" error {error:.2g} of the standard deviation (Q² {indices.q2:.6g})"
    )


def advice(indices: Indices, parameters: int) -> str:
    """Return what to do about a surrogate that is not good enough."""
    needed = cases_needed(parameters, indices.degree + 1)
    return (
        f"its indices are not reliable below Q² {GOOD}; more cases help unless the quantity jumps"
        f" (degree {indices.degree + 1} needs {needed})"
    )


def table_of(indices: Indices, keys: Sequence[str], confidence: float) -> Iterator[str]:
    """Yield a table of the indices of each parameter."""
    width = max(len("interactions"), *map(len, keys))
    yield f"  {'':{width}}  {'first order':22}  total ({100 * confidence:g} % intervals)"
    for key, first, total in zip(keys, indices.first, indices.total, strict=True):
        yield f"  {key:{width}}  {_shown(first):22}  {_shown(total)}"
    yield f"  {'interactions':{width}}  {indices.interactions:.3f}"


def _shown(index: Bounded) -> str:
    return f"{index.value:.3f} [{index.low:.3f}, {index.high:.3f}]"


def as_data(quantities: Sequence[QuantityIndices], sample: ConvergedSample, confidence: float) -> dict[str, Any]:
    """Return all figures, in SI, as plain data."""
    return {
        "sweep": sample.plan.sweep.sweep,
        "confidence": confidence,
        "parameters": {key: asdict(d) | {"dimension": None} for key, d in sample.distributions.items()},
        "cases": len(sample.cases),
        "failed": {str(number): status for number, status in sample.failed.items()},
        "quantities": {
            q.name: {"unit": q.unit, "cases": q.cases, "mean": q.mean._asdict()} | data_of(q.indices, sample)
            for q in quantities
        },
    }


def data_of(indices: Indices | None, sample: ConvergedSample) -> dict[str, Any]:
    """Return the figures of indices as plain data."""
    if indices is None:
        return {"constant": True}
    parameters = zip(sample.distributions, indices.first, indices.total, strict=True)
    return {
        "constant": False,
        "decided": indices.decided,
        "degree": indices.degree,
        "terms": indices.terms,
        "q2": indices.q2,
        "long_tail": indices.has_long_tail,
        "standard_deviation": indices.sd._asdict(),
        "indices": {key: {"first": first._asdict(), "total": total._asdict()} for key, first, total in parameters},
    }


def costs(plan: SweepPlan, records: Mapping[str, CaseRecord]) -> Iterator[str]:
    """Yield lines on the cases that surrogates of each degree need, and the solves that are left for them.

    Raises:
        JobError: the sweep is not one sample.
    """
    axis = sample_axis(plan)
    number, planned = len(axis.sample), len(plan.cases)
    seconds = [record.seconds for record in records.values()]
    converged = sum(record.converged for record in records.values())
    each = f", {duration_text(statistics.median(seconds))} each" if seconds else ""
    sample = f"{axis.kind} sample of {number} parameters"
    yield f"{plan.sweep.sweep}: {sample}; {planned} cases, {len(seconds)} finished{each}"
    yield f"{'degree':>6}  {'terms':>7}  {'cases':>7}  {'solves left':>11}  time"
    for degree in range(1, _DEGREES_SHOWN + 1):
        needed = cases_needed(number, degree)
        kept = 0 if axis.kind == "latin_hypercube" and needed > planned else converged
        left = max(0, needed - kept)
        time = duration_text(left * statistics.median(seconds)) if seconds else "not known"
        yield f"{degree:6}  {terms(number, degree):7,}  {needed:7,}  {left:11,}  {time}"
    yield "cases are the least that a degree is fitted to, one after the other on one group of ranks"
    if not seconds:
        yield "time is known when cases are finished; run some by 'sweep run --first 8' (results are kept)"
    match axis.kind:
        case "latin_hypercube":
            yield "a Latin hypercube of more cases is another one, all of whose cases are new"
        case "sobol":
            yield "a Sobol sample is best with a power of two as 'count'; a larger one keeps the finished cases"
        case _:
            yield "a random sample with a larger 'count' keeps the finished cases"
