"""Refinement series of a study: runs that differ in one thing."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from hpcinv.quantity.keys import JobKey, SummaryKey
from hpcinv.quantity.schema import ListOf, Location, Spec, raise_if_any
from hpcinv.quantity.suggestions import did_you_mean

Title = Annotated[str, Field(pattern=r"^\S(.*\S)?$", max_length=60)]


class Taken(Spec):
    """A value that is taken from the run of an earlier series, such as the accuracy to be reached."""

    series: Title
    """an earlier series; the value is that of its run of the same case, and of the same step unless it has only one"""
    key: SummaryKey
    """key of the value in the summary of that run, such as errors.round_trip.relative"""
    at_least: float
    """lower bound of the value; the job is checked with it beforehand"""


class RefinementSeries(Spec):
    """Runs that differ in one thing, and one line of the diagrams."""

    name: Title
    """name in tables and diagrams"""
    set: Mapping[JobKey, Any] = {}
    """values that all its runs have, by their keys in the job, such as {discretisation.displacement: 3}"""
    vary: Mapping[JobKey, ListOf[Any]] = {}
    """values that change from run to run, from coarse to fine; several keys change together. Left out, it is one run"""
    labels: ListOf[str] | None = None
    """names of the runs in diagrams; left out, the values that vary"""
    take: Mapping[JobKey, Taken] = {}
    """values that come from the summary of an earlier series' run"""
    repeat: Annotated[int, Field(ge=1)] | None = None
    """number of timed executions of its runs; left out, that of the study"""
    base: Title | None = None
    """name of the series whose time is the base of the ratio of times"""

    @property
    def steps(self) -> int:
        return len(next(iter(self.vary.values()), (None,)))

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        problems: list[tuple[Location, str]] = []
        lengths = {key: len(values) for key, values in self.vary.items()}
        if len(set_of := sorted(set(lengths.values()))) > 1 or set_of == [0]:
            counts = ", ".join(f"{key} {n}" for key, n in lengths.items())
            problems.append(
                (("vary",), f"needs the same number of values of each key, and at least one, not: {counts}")
            )
        elif self.labels is not None and len(self.labels) != self.steps:
            problems.append((("labels",), f"must be as many as there are runs, {self.steps}, not {len(self.labels)}"))
        parts = {"set": self.set, "vary": self.vary, "take": self.take}
        for i, (name, keys) in enumerate(parts.items()):
            earlier = {key: n for n in list(parts)[:i] for key in parts[n]}
            problems += [((name, key), f"is also in '{earlier[key]}'") for key in keys if key in earlier]
        raise_if_any(problems)
        return self


def faults_between(listed: tuple[RefinementSeries, ...]) -> Iterator[tuple[Location, str]]:
    """Yield the contradictions between series, each of which is valid."""
    if not listed:
        raise ValueError("must hold at least one series")
    earlier: dict[str, RefinementSeries] = {}
    names = [series.name for series in listed]
    for i, series in enumerate(listed):
        if series.name in earlier:
            yield (i, "name"), f"'{series.name}' is the name of an earlier series"
        if series.base is not None and series.base not in names:
            yield (i, "base"), f"there is no series '{series.base}'.{did_you_mean(series.base, names)}"
        elif series.base is not None and listed[names.index(series.base)].steps not in (1, series.steps):
            yield (i, "base"), f"series '{series.base}' has neither one run nor as many as this one"
        for key, taken in series.take.items():
            where: Location = (i, "take", key, "series")
            if taken.series not in earlier:
                yield where, f"there is no earlier series '{taken.series}'.{did_you_mean(taken.series, earlier)}"
            elif earlier[taken.series].steps not in (1, series.steps):
                yield where, f"'{taken.series}' has neither one run nor as many as this one"
        earlier[series.name] = series
