"""Plan of a study: every run with its job, all checked before any of them begins."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hpcinv.base.reading.door import is_asked
from hpcinv.errors import JobError
from hpcinv.job.job import Job, parse
from hpcinv.studies.batch.axes import sections_first
from hpcinv.studies.batch.points import CombinedPoints
from hpcinv.studies.batch.specification import (
    SpecificationFaults,
    changed_data,
    read_base,
    read_spec,
    text_of,
    texts_of,
)
from hpcinv.studies.study.study_spec import Study, measured_key


@dataclass(frozen=True)
class RunPlace:
    """Position of a run in its study.

    Attributes:
        label: name of the run within its series.
        varied: values of the series at this step, by key.
    """

    series: str
    step: int
    case: int
    label: str
    varied: Mapping[str, Any]
    parameters: Mapping[str, Any]

    @property
    def title(self) -> str:
        return ", ".join(part for part in (self.series, self.label, *texts_of(self.parameters)) if part)


@dataclass(frozen=True)
class Run:
    """One job of a study; values that it takes from earlier runs are ``at_least`` in ``job``."""

    place: RunPlace
    job: Job


@dataclass(frozen=True)
class StudyPlan:
    """A study and its runs, ordered by case, then by series, then by step."""

    path: Path
    study: Study
    runs: tuple[Run, ...]

    @property
    def results(self) -> Path:
        """Directory of the results, unless another one is given."""
        return Path("results") / self.study.study

    @property
    def cases(self) -> int:
        return self.runs[-1].place.case + 1

    @property
    def measured(self) -> dict[str, str]:
        """Keys of the summary by measured quantity."""
        return {name: measured_key(name, _quantities(self.runs[0].job)) for name in self.study.measure}


def load_study(path: Path) -> StudyPlan:
    """Read a study and check all of its runs.

    Raises:
        JobError: with a line for each fault, of the form ``file: series, value: key: fault``.
    """
    untrusted = is_asked()
    study = read_spec(Study, "study", path, untrusted=untrusted)
    base, data = read_base(path, study.job)
    faults = SpecificationFaults(path, "run")
    runs = tuple(_runs(study, base, data, faults, untrusted))
    faults.raise_if_any()
    return StudyPlan(path, study, runs)


def _runs(
    study: Study, base: Path, data: Mapping[str, Any], faults: SpecificationFaults, untrusted: bool
) -> Iterator[Run]:
    """Yield every valid run; faults of the others are added to ``faults``."""
    for case, (parameters, case_settings) in enumerate(CombinedPoints(study.cases)):
        for series in study.series:
            for step in range(series.steps):
                varied = {key: values[step] for key, values in series.vary.items()}
                label = series.labels[step] if series.labels is not None else _label(varied)
                place = RunPlace(series.name, step, case, label, varied, parameters)
                least = {key: taken.at_least for key, taken in series.take.items()}
                with faults.collected(place.title, base):
                    settings = _merged(study.set, (series.set, case_settings, varied, least))
                    job = parse(changed_data(data, settings), base, untrusted=untrusted)
                    if problems := [*_unmeasurable(study, job)]:
                        raise JobError(*problems)
                    yield Run(place, job)


def _merged(defaults: Mapping[str, Any], layers: tuple[Mapping[str, Any], ...]) -> dict[str, Any]:
    """Return all settings of a run, whole sections before values in them."""
    merged: dict[str, Any] = {}
    for layer in layers:
        for key in layer:
            if key in merged:
                raise JobError(f"{key} is set by both the series and the cases")
        merged |= layer
    return sections_first({**defaults, **merged})


def _unmeasurable(study: Study, job: Job) -> Iterator[str]:
    """Yield lines on the entries of ``measure`` that a job does not have."""
    for i, name in enumerate(study.measure):
        try:
            key = measured_key(name, _quantities(job))
        except ValueError as error:
            yield f"measure[{i}]: {error}"
            continue
        if key.startswith("errors.round_trip") and job.analysis != "round_trip":
            yield f"measure[{i}]: {key} needs 'analysis: round_trip' in the job"
        if key.startswith("errors.expected_shape") and job.expected_shape is None:
            yield f"measure[{i}]: {key} needs an 'expected_shape' in the job"


def _quantities(job: Job) -> dict[str, bool]:
    return {quantity.name: quantity.is_vector for quantity in job.quantities}


def _label(varied: Mapping[str, Any]) -> str:
    return ", ".join(dict.fromkeys(text_of(value) for value in varied.values()))
