"""Axes of a sweep or study: values that are combined, taken in parallel, sampled, or branches."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, PlainValidator, ValidationInfo, model_validator

from hpcinv.base.files.untrusted import FileBeside, applies
from hpcinv.base.quantity.keys import JobKey, parse_key
from hpcinv.base.quantity.schema import Faults, ListOf, Name, Problems, Spec
from hpcinv.base.reading.door import path_fault
from hpcinv.studies.batch.sampling import Distribution, SamplingMethod, read_distribution

LISTS = ("grid", "zip")
SAMPLES: tuple[SamplingMethod, ...] = ("random", "latin_hypercube", "sobol")
KINDS = (*LISTS, *SAMPLES, "branches")

type Sample = Mapping[JobKey, Annotated[Distribution, PlainValidator(read_distribution)]]


def _are_titles(columns: object) -> bool:
    return isinstance(columns, Mapping) and all(isinstance(title, str) for title in columns.values())


class Branch(Spec):
    """One of several alternatives, with its values and its axes."""

    set: Mapping[JobKey, Any] = {}
    """values that all its cases have"""
    axes: ListOf[Axis] = ()
    """axes of this branch alone"""

    def _contradictions(self, info: ValidationInfo) -> Faults:
        yield from ((("axes", *place), text) for place, text in faults_between(self.axes))
        for i, axis in enumerate(self.axes):
            yield from ((("axes", i), f"{key} is also in 'set'") for key in axis.keys if key in self.set)

    @property
    def keys(self) -> frozenset[str]:
        """All keys that have a value in the branch, and the names of branches in it."""
        return frozenset(self.set).union(*(axis.keys for axis in self.axes))

    @property
    def count(self) -> int:
        return number_of(self.axes)


class Axis(Spec):
    """Values of one or several keys, of one kind: grid, zip, sample, or branches."""

    grid: Mapping[JobKey, ListOf[Any]] | None = None
    """values by key: each combination is a point, the last key changing fastest"""
    zip: Mapping[JobKey, ListOf[Any]] | None = None
    """values by key: the first of each are a point, the second are, …"""
    random: Sample | None = None
    """distributions by key; their values are drawn independently of each other"""
    latin_hypercube: Sample | None = None
    """distributions by key: each is divided into as many parts as there are points, with one point in each part"""
    sobol: Sample | None = None
    """distributions by key, covered evenly by a scrambled Sobol sequence"""
    count: Annotated[int, Field(ge=1)] | None = None
    """number of points of a sample; of a Sobol sequence best a power of two"""
    seed: Annotated[int, Field(ge=0)] = 0
    """the same seed gives the same sample, on any machine"""
    branches: Mapping[str, Branch] | None = None
    """alternatives by label"""
    name: Name = "branch"
    """column of the branches' labels in the table"""
    table: FileBeside | None = None
    """path from the file to a table (.csv, .txt, .xlsx): a row is a point, a column a key such as material.c1 [kPa]"""
    columns: Mapping[JobKey, str] | None = None
    """titles of the table's columns by key, if they are not keys; other columns are not used"""

    @model_validator(mode="before")
    @classmethod
    def _read_table(cls, data: Any, info: ValidationInfo) -> Any:
        """Replace a table by the lists of values or the branches in it."""
        if not isinstance(data, Mapping) or not isinstance(data.get("table"), str):
            return data
        from hpcinv.studies.batch.axis_table import axis_of

        own = {key: value for key, value in data.items() if key not in ("table", "columns")}
        if others := [key for key in own if key != "name"]:
            raise Problems(((others[0],), "is not valid with a table"))
        directory = (info.context or {}).get("directory", Path())
        if applies(info) and (fault := path_fault(directory, data["table"])):
            raise Problems((("table",), f"'{data['table']}' {fault}"))
        columns = data.get("columns")
        if columns is not None and not _are_titles(columns):
            raise Problems((("columns",), "must be titles of columns by key, such as {material.c1: C1}"))
        try:
            content = axis_of(directory / data["table"], own.get("name", "branch"), columns)
        except ValueError as error:
            raise Problems((("table",), f"{data['table']}: {error}")) from None
        if "name" in own and "branches" not in content:
            raise Problems((("name",), f"{data['table']} has no column '{own['name']}'"))
        return content

    @property
    def kind(self) -> str:
        return next(kind for kind in KINDS if getattr(self, kind) is not None)

    @property
    def sample(self) -> Sample:
        """The distributions of a sample by key; nothing for the other kinds."""
        sample: Sample = getattr(self, self.kind) if self.kind in SAMPLES else {}
        return sample

    @property
    def sampling(self) -> SamplingMethod:
        """Method of a sample."""
        return next(method for method in SAMPLES if self.kind == method)

    @property
    def keys(self) -> frozenset[str]:
        """All keys that have a value on the axis, and the names of branches."""
        if self.branches is not None:
            return frozenset([self.name]).union(*(branch.keys for branch in self.branches.values()))
        return frozenset(getattr(self, self.kind))

    @property
    def points(self) -> int:
        match self.kind:
            case "branches":
                return sum(branch.count for branch in (self.branches or {}).values())
            case "grid":
                return math.prod(len(values) for values in (self.grid or {}).values())
            case "zip":
                return len(next(iter((self.zip or {}).values())))
        return self.count or 0

    def _contradictions(self, info: ValidationInfo) -> Faults:
        given = [kind for kind in KINDS if getattr(self, kind) is not None]
        if len(given) != 1:
            kinds = " and ".join(given) or "none of them"
            yield (), f"must be one of {', '.join(KINDS)}, table, not {kinds}"
            return
        [kind] = given
        yield from self._faults_of_content(kind, getattr(self, kind))
        yield from self._faults_of_sample(kind)

    def _faults_of_content(self, kind: str, content: Mapping[str, Any]) -> Faults:
        if not content:
            yield (kind,), "must have at least one entry"
        if kind in LISTS:
            yield from (((kind, key), "must have at least one value") for key, values in content.items() if not values)
        if kind == "zip" and len(lengths := {len(values) for values in content.values()}) > 1:
            yield ("zip",), f"needs the same number of values of each key, not {sorted(lengths)}"
        for label, branch in content.items() if kind == "branches" else ():
            if self.name in branch.keys:
                yield ("branches", label), f"'{self.name}' is also the name of these branches; give them another 'name'"

    def _faults_of_sample(self, kind: str) -> Faults:
        """Yield keys that a kind of axis lacks, or that belong to another kind."""
        if kind in SAMPLES and self.count is None:
            yield ("count",), f"is needed: the number of points of '{kind}'"
        idle = ({"name"} if kind != "branches" else set()) | ({"count", "seed"} if kind not in SAMPLES else set())
        for key in sorted(idle & self.model_fields_set):
            use = "branches" if key == "name" else "a sample (random, latin_hypercube, sobol)"
            yield (key,), f"is valid only with {use}"


def faults_between(axes: Iterable[Axis]) -> Faults:
    """Yield the keys and names that occur on more than one of the axes, which are combined with each other."""
    taken: set[str] = set()
    for i, axis in enumerate(axes):
        for key in sorted(axis.keys & taken):
            yield (i,), f"{key} is also on an earlier axis"
        taken |= axis.keys


def number_of(axes: Iterable[Axis]) -> int:
    """Return the number of combinations of the points of axes."""
    return math.prod(axis.points for axis in axes)


Branch.model_rebuild()


def sections_first(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings in the order in which they must be set: whole sections before values in them."""
    return dict(sorted(settings.items(), key=lambda setting: len(parse_key(setting[0]))))
