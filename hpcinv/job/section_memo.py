"""Functions of a job that are evaluated again only when something that they have read differs."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from functools import cache, partial
from types import FunctionType, MappingProxyType
from typing import Any, cast

from pydantic import BaseModel

from hpcinv.job.leaf_changes import LeafRead, Leaves, changed_leaves, unreadable_variants

MOST_TRIES = 20
"""Evaluations of a function with unreadable numbers. Raised, a function that is evaluated anew in each case, since it
depends on something else as well, takes several times as long."""


class SectionMemo:
    """Memory of functions of jobs of one file, which share what they do not differ in.

    While a function is evaluated, the memory notes which sections it reads, directly or through methods of the job, and
    which other results: of functions of this memory, and properties of the job that are texts, whole numbers or flags.
    Its value holds until one of these differs. Sections are immutable, and the functions are pure.

    Where a section, or a result that was read, differs in finite numbers only, the function is evaluated once with
    these unreadable. If that returns the same value, the value does not depend on them, and holds for other finite
    numbers as well.
    """

    def __init__(self) -> None:
        self._job: Any = None
        self._results: dict[Hashable, Any] = {}
        self._functions: dict[Hashable, Callable[[Any], Any]] = {}
        self._order: dict[
            Hashable, int
        ] = {}  # in which they were first evaluated: of two, the second may read the first
        self._reads: dict[Hashable, tuple[set[str], set[Hashable]]] = {}
        self._readers = defaultdict[str, set[Hashable]](set)  # of a section
        self._dependents = defaultdict[Hashable, set[Hashable]](set)  # of another result
        self._independent = defaultdict[Hashable, set[_Change]](set)  # of numbers, as they were last evaluated
        self._dependent = defaultdict[Hashable, set[_Change]](set)
        self._tries = Counter[Hashable]()  # of evaluations without numbers
        self._compound: set[str] = set()  # properties whose values are of other types

    def of[T](self, key: Hashable, function: Callable[[Any], T], job: Any) -> T:
        """Return ``function(job)``, known by a key.

        Args:
            function: pure; its result does not refer to the job.
            job: a job, or what such a function has got instead of one.
        """
        if not isinstance(job, _WatchedJob):
            self._look_at(job)
        elif job.memo is self:
            job.results_read.add(key)
            if key in job.replaced:
                return cast(T, job.replaced[key])
        else:
            self._look_at(job.watched_job)
        if key not in self._results:
            self._evaluate(key, function)
        if isinstance(job, _WatchedJob) and job.memo is not self:
            job.parts_read |= self._all_parts(key)
        return cast(T, self._results[key])

    def each_of[T](self, functions: Sequence[Callable[[Any], T]], job: Any) -> list[T]:
        """Return the value of each function at a job, as `of` with the function as key."""
        if isinstance(job, _WatchedJob):
            return [self.of(function, function, job) for function in functions]
        self._look_at(job)
        results = self._results
        for function in functions:
            if function not in results:
                self._evaluate(function, function)
        return [results[function] for function in functions]

    def property_of(self, name: str, getter: Callable[[Any], Any], job: _WatchedJob) -> Any:
        """Return a property of a job; a text, a whole number, a flag or an empty tuple is a result of its own."""
        if name not in self._compound:
            key = "property", name
            if key not in self._results:
                self._evaluate(key, getter)
            if type(value := self._results[key]) in _PLAIN or value == ():
                job.results_read.add(key)
                return value
            self._compound.add(name)
        return getter(job)

    def _evaluate(self, key: Hashable, function: Callable[[Any], Any]) -> None:
        watched = _watched_kind(self._job.__class__)(self._job, self)
        self._results[key] = function(watched)
        if key not in self._functions:
            self._functions[key], self._order[key] = function, len(self._order)
        self._independent.pop(key, None)
        reads = watched.parts_read, watched.results_read
        if reads != self._reads.get(key):
            self._reads[key] = reads
            for name in watched.parts_read:
                self._readers[name].add(key)
            for other in watched.results_read:
                self._dependents[other].add(key)

    def _all_parts(self, key: Hashable) -> set[str]:
        """Return the sections that a function reads, also through other results."""
        parts, results = self._reads[key]
        return parts.union(*map(self._all_parts, results))

    def _look_at(self, job: Any) -> None:
        """Forget the results that depend on what differs between a job and the one before."""
        if job is self._job:
            return
        before, readers, stale = self._job, self._readers, set[Hashable]()
        for old, new in () if before is None else _parts_of(before, job):
            for name in [name for name, value in new.items() if value is not old[name] and name in readers]:
                stale.update(self._affected(readers[name], (_SECTION, name), old[name], new[name]))
        self._job = job
        if stale:
            self._forget(stale)

    def _forget(self, stale: Iterable[Hashable]) -> None:
        """Forget results, and those that depend on them if they have another value now."""
        results = self._results
        old = {key: results.pop(key) for key in stale if key in results}
        for key in sorted(old.keys() & self._dependents.keys(), key=self._order.__getitem__):
            if key not in self._results:
                try:
                    self._evaluate(key, self._functions[key])
                except (LeafRead, Exception):  # is raised where the value is needed
                    self._results.pop(key, None)
            if key not in results:
                self._forget(self._dependents[key])
            elif not _is_same(old[key], results[key]):
                self._forget(self._affected(self._dependents[key], (_RESULT, key), old[key], results[key]))

    def _affected(self, keys: Iterable[Hashable], place: _Place, old: Any, new: Any) -> Iterable[Hashable]:
        """Return the readers of a section, or of another result, that depend on what differs in it."""
        if (leaves := changed_leaves(old, new)) is None:
            return keys
        return [key for key in keys if leaves and self._depends(key, (place, leaves))]

    def _depends(self, key: Hashable, change: _Change) -> bool:
        """Return whether a result that is known may depend on numbers in a section."""
        if change in self._dependent[key] or key not in self._results:
            return True
        if change not in self._independent[key]:
            self._tries[key] += 1
            if self._tries[key] > MOST_TRIES or not self._is_evaluated_without(key, change):
                self._dependent[key].add(change)
                return True
            self._independent[key].add(change)
        return False

    def _is_evaluated_without(self, key: Hashable, change: _Change) -> bool:
        """Return whether a function has the same value where numbers that it may read are unreadable."""
        (kind, name), leaves = change
        try:
            for watched in (
                self._variants(name, leaves) if kind is _RESULT else self._variants_of_job(str(name), leaves)
            ):
                if self._functions[key](watched) != self._results[key]:
                    return False
        except (LeafRead, Exception):
            return False
        return True

    def _variants(self, key: Hashable, leaves: Leaves) -> Iterator[_WatchedJob]:
        """Yield the job, with unreadable numbers in a result that it is asked for."""
        for result in unreadable_variants(self._results[key], leaves):
            yield _watched_kind(self._job.__class__)(self._job, self, replaced={key: result})

    def _variants_of_job(self, name: str, leaves: Leaves) -> Iterator[_WatchedJob]:
        """Yield the job with unreadable numbers in a section."""
        parts = self._job.__dict__ if name in self._job.__dict__ else self._job.__pydantic_private__
        for part in unreadable_variants(parts[name], leaves):
            job = self._job.model_copy()
            (job.__dict__ if name in job.__dict__ else job.__pydantic_private__)[name] = part
            yield _watched_kind(job.__class__)(job, self, unreadable=name)


type _Place = tuple[str, Hashable]
"""a section by its name, or a result by its key"""
type _Change = tuple[_Place, Leaves]
"""places of numbers in a section or in a result"""
_SECTION, _RESULT = "section", "result"
_NOTHING: Mapping[Hashable, Any] = MappingProxyType({})
_PLAIN = (bool, int, str, type(None))


def _parts_of(*jobs: Any) -> tuple[tuple[dict[str, Any], ...], tuple[dict[str, Any], ...]]:
    """Return the sections of jobs, and their private attributes."""
    return tuple(job.__dict__ for job in jobs), tuple(job.__pydantic_private__ for job in jobs)


class _WatchedJob:
    """A job that notes which of its parts, sections and private attributes, are read, and which results of a memory.

    Its kinds have the properties and methods of a kind of job, with this object as ``self``.

    Args:
        unreadable: the part with unreadable numbers; empty without one.
        replaced: values instead of results of the memory.
    """

    __slots__ = ("memo", "parts_read", "replaced", "results_read", "unreadable", "watched_job")

    def __init__(
        self, job: Any, memo: SectionMemo, unreadable: str = "", replaced: Mapping[Hashable, Any] = _NOTHING
    ) -> None:
        self.watched_job, self.memo, self.unreadable, self.replaced = job, memo, unreadable, replaced
        self.parts_read, self.results_read = set[str](), set[Hashable]()

    def __getattr__(self, name: str) -> Any:
        for parts in (self.watched_job.__dict__, self.watched_job.__pydantic_private__):
            self.parts_read.update(parts)  # an attribute of pydantic may depend on all
        return getattr(self.watched_job, name)

    def model_dump(self, *, include: set[str], **options: Any) -> dict[str, Any]:
        """Return data of some sections."""
        if self.unreadable in include:
            raise LeafRead
        self.parts_read |= include
        data: dict[str, Any] = self.watched_job.model_dump(include=include, **options)
        return data


@cache
def _watched_kind(kind: type[BaseModel]) -> type[_WatchedJob]:
    """Return the kind of watched jobs for a kind of jobs."""
    content: dict[str, Any] = {"__slots__": ()}
    for name, value in vars(kind).items():
        if isinstance(value, FunctionType) and not name.startswith("__"):
            content[name] = value
        elif isinstance(value, property) and value.fget is not None:
            content[name] = property(partial(_read_property, name, value.fget))
    content |= {name: property(partial(_read_section, name)) for name in kind.model_fields}
    content |= {name: property(partial(_read_private, name)) for name in kind.__private_attributes__}
    return type(f"Watched{kind.__name__}", (_WatchedJob,), content)


def _read_section(name: str, job: _WatchedJob) -> Any:
    job.parts_read.add(name)
    return job.watched_job.__dict__[name]


def _read_private(name: str, job: _WatchedJob) -> Any:
    job.parts_read.add(name)
    return job.watched_job.__pydantic_private__[name]


def _read_property(name: str, getter: Callable[[Any], Any], job: _WatchedJob) -> Any:
    return job.memo.property_of(name, getter, job)


def _is_same(one: Any, other: Any) -> bool:
    """Return whether two values are the same object, or equal ones whose equality is exact."""
    return one is other or (type(one) is type(other) and type(one) in _PLAIN and bool(one == other))
