"""Functions of a job that are evaluated again only when a section that they have read is another one."""

from collections import defaultdict
from collections.abc import Callable, Hashable, Mapping, Sequence
from functools import cache, partial
from types import FunctionType
from typing import Any, cast

from pydantic import BaseModel


class SectionMemo:
    """Memory of functions of jobs of one file, which share the sections in which they do not differ.

    While a function is evaluated, the memory notes which sections it reads, directly or through properties of the job.
    Its result holds until one of these is another object: a section is immutable, and the functions are pure.
    """

    def __init__(self) -> None:
        self._job: Any = None
        self._parts: dict[str, Any] = {}
        self._results: dict[Hashable, Any] = {}
        self._reads: dict[Hashable, set[str]] = {}
        self._readers = defaultdict[str, set[Hashable]](set)

    def of[T](self, key: Hashable, function: Callable[[Any], T], job: Any) -> T:
        """Return ``function(job)``, known by a key.

        Args:
            function: pure; its result does not refer to the job.
            job: a job, or what such a function has got instead of one.
        """
        own = job.watched_job if isinstance(job, _WatchedJob) else job
        self._look_at(own)
        if key not in self._results:
            self._evaluate(key, function, own)
        if own is not job:
            job.parts_read |= self._reads[key]
        return cast(T, self._results[key])

    def each_of[T](self, functions: Sequence[Callable[[Any], T]], job: Any) -> list[T]:
        """Return the value of each function at a job."""
        self._look_at(job)
        results = self._results
        for function in functions:
            if function not in results:
                self._evaluate(function, function, job)
        return [results[function] for function in functions]

    def _evaluate(self, key: Hashable, function: Callable[[Any], Any], job: Any) -> None:
        watched = _watched_kind(job.__class__)(job, self._parts)
        self._results[key] = function(watched)
        if watched.parts_read != self._reads.get(key):
            self._reads[key] = watched.parts_read
            for name in watched.parts_read:
                self._readers[name].add(key)

    def _look_at(self, job: Any) -> None:
        """Forget the results that depend on parts in which a job differs from the one before."""
        if job is self._job:
            return
        parts, before = {**job.__dict__, **job.__pydantic_private__}, self._parts
        for name, keys in self._readers.items():
            if parts[name] is not before[name] and not _is_same(parts[name], before[name]):
                for key in keys:
                    self._results.pop(key, None)
        self._job, self._parts = job, parts


class _WatchedJob:
    """A job that notes which of its parts, sections and private attributes, are read.

    Its kinds have the properties and methods of a kind of job, with this object as ``self``.
    """

    def __init__(self, job: Any, parts: Mapping[str, Any]) -> None:
        self.watched_job, self.parts_read, self.parts = job, set[str](), parts

    def __getattr__(self, name: str) -> Any:
        self.parts_read.update(self.parts)  # an attribute of pydantic may depend on all
        return getattr(self.watched_job, name)

    def model_dump(self, *, include: set[str], **options: Any) -> dict[str, Any]:
        """Return data of some sections."""
        self.parts_read |= include
        data: dict[str, Any] = self.watched_job.model_dump(include=include, **options)
        return data


@cache
def _watched_kind(kind: type[BaseModel]) -> type[_WatchedJob]:
    """Return the kind of watched jobs for a kind of jobs."""
    names = (*kind.model_fields, *kind.__private_attributes__)
    parts = {name: property(partial(_read, name)) for name in names}
    own = {n: v for n, v in vars(kind).items() if isinstance(v, property | FunctionType) and not n.startswith("__")}
    return type(f"Watched{kind.__name__}", (_WatchedJob,), {**own, **parts})


def _read(name: str, job: _WatchedJob) -> Any:
    job.parts_read.add(name)
    return job.parts[name]


def _is_same(one: Any, other: Any) -> bool:
    """Return whether two parts are the same object, or consist of the same objects."""
    if isinstance(one, tuple) and isinstance(other, tuple) and len(one) == len(other):
        return all(a is b for a, b in zip(one, other, strict=True))
    return one is other
