"""Record of a finished case as JSON text, and the digest that detects damage of such a text."""

import contextlib
import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import Any, Self

from hpcinv.base.files.json_data import json_data
from hpcinv.errors import OutputError


@dataclass(frozen=True)
class CaseRecord:
    """End of a case.

    Attributes:
        status: "converged", or the diagnosis.
        statistics: content of the run's ``summary.json``; empty if the case failed before there was one.
        seconds: wall time of the case.
        start: key of the case whose solution, or power series, was the initial guess; "" for the unloaded body.
        compiled: whether kernels were compiled, so that its time does not count; set by studies.
        by_series: whether the initial guess was the value of a power series.
        remark: whether a power series for other cases was made of it, or why not; empty if none was wanted.
    """

    status: str
    advice: str
    statistics: Mapping[str, Any]
    seconds: float
    attempts: int
    start: str = ""
    compiled: bool = False
    by_series: bool = False
    remark: str = ""

    @property
    def converged(self) -> bool:
        return self.status == "converged"

    @property
    def diagnosis(self) -> str:
        """The status without the numbers of the case, which is the same for all cases that failed alike."""
        diagnosis: str = self.statistics.get("status", self.status)
        return diagnosis

    @property
    def verdict(self) -> str:
        """Verdict of the certificate; empty without one."""
        verdict: str = self.statistics.get("certificate", {}).get("verdict", "")
        return verdict

    @property
    def inputs(self) -> Mapping[str, str]:
        """Digests of the files that the generator of its mesh read, by their paths from its directory."""
        return (self.statistics.get("mesh") or {}).get("inputs") or {}

    @property
    def estimate(self) -> Mapping[str, Any]:
        """Error estimate of the certificate; empty without one."""
        return self.statistics.get("certificate", {}).get("estimate") or {}

    def brief(self) -> Self:
        """Return the record with the numbers that tables show, without the iterations of its solves."""
        statistics: dict[str, Any] = {key: self.statistics[key] for key in _BRIEF if key in self.statistics}
        if solutions := self.statistics.get("solutions"):
            statistics["solutions"] = [{key: solution.get(key, 0) for key in _COUNTS} for solution in solutions]
        if certificate := self.statistics.get("certificate"):
            statistics["certificate"] = {key: certificate.get(key) for key in ("verdict", "estimate")}
        return replace(self, status=self.diagnosis, statistics=statistics)

    def as_json(self) -> dict[str, Any]:
        """Return it as JSON data; numbers that are not finite become null, tuples lists."""
        return {entry.name: json_data(getattr(self, entry.name)) for entry in fields(self)}

    def encoded(self) -> bytes:
        """Return it as a line of text with a digest."""
        return sealed("record", self.as_json())

    @classmethod
    def decoded(cls, data: bytes) -> Self:
        """Return the record in a line of text.

        Unknown entries come from a newer version, and are ignored: a version that changes what the
        known ones mean changes the format of the store (`store`).

        Raises:
            ValueError: it is damaged.
            OtherVersionError: it is whole, but lacks entries that are needed.
        """
        return cls.from_json(unsealed("record", data))

    @classmethod
    def from_json(cls, entry_data: Any) -> Self:
        """Return the record in JSON data; raises ``OtherVersionError`` as `decoded`."""
        if not isinstance(entry_data, dict):
            raise OtherVersionError("it is not a mapping")
        if missing := [f"'{name}'" for name in _NEEDED if name not in entry_data]:
            raise OtherVersionError(f"it has no {', '.join(missing)}")
        if not entry_data.keys() <= _ENTRIES:
            entry_data = {name: entry_data[name] for name in entry_data.keys() & _ENTRIES}
        record = cls.__new__(cls)
        vars(record).update(entry_data)  # the constructor of a frozen class takes three times as long
        return record


class OtherVersionError(Exception):
    """A record is as it was written, by a version of hpcinv whose records cannot be read here."""


@contextlib.contextmanager
def refusing_other_versions(file: Path) -> Iterator[None]:
    """Turn an ``OtherVersionError`` into an ``OutputError``: the case must not be solved again in its place."""
    try:
        yield
    except OtherVersionError as error:
        raise OutputError(
            f"{file}: another version of hpcinv wrote it: {error}",
            "Use that version, or choose another 'store'; nothing was changed.",
        ) from None


_ENTRIES = frozenset(entry.name for entry in fields(CaseRecord))
_NEEDED = tuple(entry.name for entry in fields(CaseRecord) if entry.default is MISSING)
_BRIEF = ("machine", "mesh", "quantities", "sensitivities", "peak_memory")
_COUNTS = ("factorizations", "newton_iterations")
_AFTER = b', "sha256": "%s"}\n'


def sealed(name: str, data: Any) -> bytes:
    """Return JSON data as a line of text, under a name and with a digest."""
    return _sealed(name, json.dumps(data, ensure_ascii=False).encode())


def unsealed(name: str, line: bytes) -> Any:
    """Return the data in a line of `sealed`.

    Raises:
        ValueError: the line is damaged.
        OtherVersionError: it is as it was written, but is not JSON.
    """
    if not is_sealed(name, line):
        raise ValueError("the digest does not match")
    try:
        return json.loads(_content(name, line))
    except ValueError as error:
        raise OtherVersionError("it is not JSON") from error


def _sealed(name: str, content: bytes) -> bytes:
    return _before(name) + content + _AFTER % _digest(content)


def is_sealed(name: str, line: bytes) -> bool:
    """Return whether a line is as `sealed` returned it."""
    before = _before(name)
    if len(line) < len(before) + _AFTER_LENGTH or not line.startswith(before):
        return False
    return line.endswith(_AFTER % _digest(_content(name, line)))


def _content(name: str, line: bytes) -> bytes:
    return line[len(_before(name)) : -_AFTER_LENGTH]


@cache
def _before(name: str) -> bytes:
    return b'{"%s": ' % name.encode()


def _digest(content: bytes) -> bytes:
    return hashlib.sha256(content).hexdigest().encode()


_AFTER_LENGTH = len(_AFTER % _digest(b""))
