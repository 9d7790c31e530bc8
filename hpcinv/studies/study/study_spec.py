"""Study file: refinement series of runs, measured quantities, references, and published numbers."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import (
    BeforeValidator,
    Field,
    GetJsonSchemaHandler,
    ValidationInfo,
    WithJsonSchema,
    field_validator,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import core_schema

from hpcinv.base.files.untrusted import FileBeside
from hpcinv.base.quantity.keys import JobKey, SummaryKey, parse_key
from hpcinv.base.quantity.quantity import AnyQuantity, Quantity
from hpcinv.base.quantity.schema import Faults, FileName, KeyPath, ListOf, Name, Spec, raise_if_any, repeated, shown
from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.studies.batch import axes
from hpcinv.studies.batch.axes import Axis

STATISTICS = ("average", "sd", "minimum", "maximum")
"""statistics of an error over the cases"""
COSTS = dict.fromkeys(("time", "run", "certified", "solver", "programs"), "s")
COSTS |= dict.fromkeys(("factorizations", "newton_iterations", "unknowns", "cells"), "") | {"memory": "B"}
"""costs of every run, with their units"""
SUMMARY = ("mesh", "partition", "solutions", "quantities", "errors", "timings", "certificate", "peak_memory")
"""parts of a summary in which there are numbers to measure"""

MOST = 100_000
"""runs of one study"""

_KINDS = ("finest", "richardson")
LEAST_MESHES = 3
"""meshes from which an order and a limit can be found: two give one of them"""


Title = Annotated[str, Field(pattern=r"^\S(.*\S)?$", max_length=60)]


class Taken(Spec):
    """A value that is taken from the run of an earlier series, such as the accuracy to be reached."""

    series: Title
    """an earlier series; the value is of its run of the same case, and of the same step unless it has only one"""
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
    """number of timed executions of its runs; left out, the study's"""
    base: Title | None = None
    """name of the series whose time is the base of the ratio of times"""

    @property
    def steps(self) -> int:
        return len(next(iter(self.vary.values()), (None,)))

    def _contradictions(self, info: ValidationInfo) -> Faults:
        lengths = {key: len(values) for key, values in self.vary.items()}
        if len(set_of := sorted(set(lengths.values()))) > 1 or set_of == [0]:
            counts = ", ".join(f"{key} {n}" for key, n in lengths.items())
            yield ("vary",), f"needs the same number of values of each key, and at least one, not: {counts}"
        elif self.labels is not None and len(self.labels) != self.steps:
            yield ("labels",), f"must be as many as there are runs, {self.steps}, not {len(self.labels)}"
        parts = {"set": self.set, "vary": self.vary, "take": self.take}
        for i, (name, keys) in enumerate(parts.items()):
            earlier = {key: n for n in list(parts)[:i] for key in parts[n]}
            yield from (((name, key), f"is also in '{earlier[key]}'") for key in keys if key in earlier)


def faults_between(listed: tuple[RefinementSeries, ...]) -> Faults:
    """Yield the contradictions between series that are valid by themselves."""
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
            where: KeyPath = (i, "take", key, "series")
            if taken.series not in earlier:
                yield where, f"there is no earlier series '{taken.series}'.{did_you_mean(taken.series, earlier)}"
            elif earlier[taken.series].steps not in (1, series.steps):
                yield where, f"'{taken.series}' has neither one run nor as many as this one"
        earlier[series.name] = series


def _named_references(data: Any) -> Any:
    """Return references by name; one for all measured quantities is named "all"."""
    return data if isinstance(data, Mapping) and not (len(data) == 1 and {*data} & {*_KINDS}) else {"all": data}


_OF_SERIES = {kind: {"type": "string"} for kind in _KINDS}
_REFERENCE: dict[str, Any] = {
    "anyOf": [
        {"enum": list(_KINDS)},
        {"type": "number"},
        {"type": "string", "pattern": r"^\s*[-+.0-9]"},
        {
            "type": "object",
            "properties": _OF_SERIES,
            "additionalProperties": False,
            "minProperties": 1,
            "maxProperties": 1,
        },
    ]
}
_REFERENCES = {"anyOf": [*_REFERENCE["anyOf"], {"type": "object", "additionalProperties": _REFERENCE}]}


class Reference(Spec):
    """Reference of a quantity: a number, the finest run, or Richardson's extrapolation."""

    kind: Literal["closed form", "finest", "richardson"]
    value: float | None = None
    series: Title | None = None

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        return _REFERENCE

    @model_validator(mode="before")
    @classmethod
    def _read(cls, data: Any) -> Any:
        if isinstance(data, Reference):
            return data
        if isinstance(data, str) and data in _KINDS:
            return {"kind": data}
        if isinstance(data, Mapping):
            if len(data) == 1 and (kind := next(iter(data))) in _KINDS:
                return {"kind": kind, "series": data[kind]}
        elif not isinstance(data, str) or data[:1].isdigit() or data[:1] in "+-.(":
            return {"kind": "closed form", "value": Quantity(None).parse(data)}
        raise ValueError(
            f"must be a value (closed form), finest, richardson, or one of these of a series, such as "
            f"{{richardson: NAME}}, not {shown(data)}"
        )


class Beside(Spec):
    """Published numbers, printed next to the study's."""

    source: str
    """where they were published"""
    values: Mapping[SummaryKey, Mapping[str, AnyQuantity]] = {}
    """by measured quantity: values by their origin, such as {tip: {Abaqus: 132.71 mm}}"""
    statistics: Mapping[SummaryKey, Mapping[str, Mapping[str, float]]] = {}
    """by measured quantity and series: statistics over the cases, such as {average: 4.5e-12, failed: 7}"""


class Study(Spec):
    """Study: refinement series of runs of one job, their measured quantities and costs."""

    study: FileName = "study"
    """up to 100 letters, digits, dots, _, - (no dot or - first), naming the results; left out, the name of the file"""
    job: FileBeside
    """path from the study file to the job of all runs"""
    set: Mapping[JobKey, Any] = {}
    """values of all runs, unless a series or a case sets them"""
    series: ListOf[RefinementSeries]
    """refinement series: runs that differ in one thing, each series a line in the diagrams"""
    cases: ListOf[Axis] = ()
    """axes of parameters that every series runs over, for statistics: each combination of their points is a case"""
    measure: ListOf[SummaryKey]
    """quantities of interest of the job by name, and keys of its summary such as errors.round_trip.max"""
    reference: Annotated[
        Mapping[SummaryKey, Reference], BeforeValidator(_named_references), WithJsonSchema(_REFERENCES)
    ] = {"all": Reference.model_validate("finest")}
    """reference value: one for all measured quantities, or by name, with 'all' for the rest"""
    costs: Mapping[Name, SummaryKey] = {}
    """further costs by keys of the summary, such as {iterations: "solutions[].iterations"}"""
    time: Literal["run", "certified", "solver"] = "run"
    """seconds, without making programs: of the run without its certificate, of all, or of Newton's method alone"""
    repeat: Annotated[int, Field(ge=1)] = 3
    """number of timed executions of each run; the median counts"""
    limit: Annotated[float, Quantity("s", above=0.0)] | None = None
    """wall time that a run may take, such as 10 min; one that takes longer has failed. Left out, there is none"""
    beside: Beside | None = None
    """published numbers"""

    def reference_of(self, measured: str) -> Reference:
        return self.reference[measured if measured in self.reference else "all"]

    def series_called(self, name: str) -> RefinementSeries:
        return next(series for series in self.series if series.name == name)

    @field_validator("series")
    @classmethod
    def _are_consistent(cls, listed: tuple[RefinementSeries, ...]) -> tuple[RefinementSeries, ...]:
        raise_if_any(faults_between(listed))
        return listed

    @field_validator("cases")
    @classmethod
    def _are_axes(cls, cases: tuple[Axis, ...]) -> tuple[Axis, ...]:
        raise_if_any(axes.faults_between(cases))
        return cases

    @field_validator("measure")
    @classmethod
    def _is_not_empty(cls, measure: tuple[str, ...]) -> tuple[str, ...]:
        if not measure:
            raise ValueError("must name at least one quantity of interest")
        raise_if_any(((i,), f"'{measure[i]}' is duplicated") for i in repeated(measure))
        return measure

    @field_validator("costs")
    @classmethod
    def _have_unique_names(cls, costs: Mapping[str, str]) -> Mapping[str, str]:
        taken = {*COSTS, *STATISTICS, "ratio", "failed"}
        raise_if_any(((name,), "is the name of another column") for name in costs if name in taken)
        return costs

    def _faults_of_references(self, names: Sequence[str]) -> Faults:
        """Yield the faults of references, for the names of the series."""
        for key, reference in self.reference.items():
            if reference.series is not None and reference.series not in names:
                text = f"there is no series '{reference.series}'.{did_you_mean(reference.series, names)}"
                yield ("reference", key), text
            elif fault := _missing_extrapolation(reference, self.series):
                yield ("reference", key), fault
        yield from self._not_measured(("reference",), [key for key in self.reference if key != "all"])
        missing = [] if "all" in self.reference else [key for key in self.measure if key not in self.reference]
        yield from ((("reference",), f"is needed for '{key}' too") for key in missing)

    def _contradictions(self, info: ValidationInfo) -> Faults:
        steps = sum(series.steps for series in self.series)
        if (runs := steps * axes.number_of(self.cases)) > MOST:
            yield ("cases",), f"make {runs:,} runs, but a study can have no more than {MOST:,}; split it"
        names = [series.name for series in self.series]
        yield from self._faults_of_references(names)
        if self.beside is not None:
            yield from self._unknown_names(self.beside, names)

    def _unknown_names(self, published: Beside, names: Sequence[str]) -> Faults:
        columns = {*STATISTICS, *COSTS, *self.costs, "ratio", "failed"}
        yield from self._not_measured(("beside", "values"), published.values)
        yield from self._not_measured(("beside", "statistics"), published.statistics)
        for key, named in published.statistics.items():
            for name, statistics in named.items():
                where: KeyPath = ("beside", "statistics", key, name)
                if name not in names:
                    yield where, f"there is no such series.{did_you_mean(name, names)}"
                unknown = (column for column in statistics if column not in columns)
                yield from (((*where, c), f"is not a statistic.{did_you_mean(c, columns)}") for c in unknown)

    def _not_measured(self, place: KeyPath, keys: Iterable[str]) -> Faults:
        unknown = (key for key in keys if key not in self.measure)
        yield from (((*place, key), f"is not measured.{did_you_mean(key, self.measure)}") for key in unknown)


def refines(varied: Iterable[str]) -> bool:
    """Return whether keys that vary along a series change nothing but the mesh."""
    keys = list(varied)
    mesh_keys = ("mesh.parameters", "expected_shape")
    whole = ("mesh", "mesh.file", "mesh.cad", "mesh.image", "mesh.surface", "mesh.surfaces", "mesh.lumen", "mesh.size")
    return bool(keys) and all(key in whole or key.startswith(mesh_keys) for key in keys)


def _missing_extrapolation(reference: Reference, listed: Iterable[RefinementSeries]) -> str:
    """Return why no run of the series can be extrapolated from; empty if one has three meshes."""
    series = [entry for entry in listed if reference.series in (None, entry.name)]
    if reference.kind != "richardson" or any(refines(entry.vary) and entry.steps >= LEAST_MESHES for entry in series):
        return ""
    remedy = "take finest or a value instead, or another series: {richardson: NAME}"
    if not any(refines(entry.vary) for entry in series):
        return f"richardson needs a series along which nothing but the mesh varies; {remedy}"
    return f"richardson needs a series with {LEAST_MESHES} meshes; {remedy}"


def measured_key(measured: str, quantities: Mapping[str, bool]) -> str:
    """Return the key in the summary of a measured quantity.

    Args:
        measured: the name of a quantity of interest, ``NAME[i]`` for a component, or a key of the summary.
        quantities: the job's quantities by name, and whether they are vectors.

    Raises:
        ValueError: there is no such quantity, or it is a vector.
    """
    parts = parse_key(measured)
    name = str(parts[0])
    if name not in quantities:
        if name in SUMMARY and len(parts) > 1:
            return measured
        known = did_you_mean(name, [*quantities, *SUMMARY])
        raise ValueError(f"the job has no quantity of interest '{name}', nor is it a key of the summary.{known}")
    if quantities[name] and (len(parts) != 2 or not isinstance(parts[1], int) or parts[1] > 2):
        raise ValueError(f"'{name}' is a vector: measure {name}[0], {name}[1] or {name}[2], or take a formula for it")
    if not quantities[name] and len(parts) > 1:
        raise ValueError(f"'{name}' is one number, without parts")
    return f"quantities.{measured}"
