"""Record of a finished case, and its file: JSON with a digest that detects damage."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, fields
from typing import Any, Self

from hpcinv.base.files.json_data import json_data


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

    def encoded(self) -> bytes:
        """Return the content of its file; numbers that are not finite become null, tuples lists."""
        return _sealed(json.dumps(json_data(asdict(self)), ensure_ascii=False).encode())

    @classmethod
    def decoded(cls, data: bytes) -> Self:
        """Return the record in the content of a file.

        Unknown entries come from a newer version, and are ignored: a version that changes what the
        known ones mean changes the format of the store (`store`).

        Raises:
            ValueError: it is damaged.
            OtherVersionError: it is whole, but lacks entries that are needed.
        """
        content = data[len(_BEFORE) : -len(_AFTER % _digest(b""))]
        if data != _sealed(content):
            raise ValueError("the digest does not match")
        try:
            entry_data = json.loads(content)
        except ValueError as error:
            raise OtherVersionError("it is not JSON") from error
        if not isinstance(entry_data, dict):
            raise OtherVersionError("it is not a mapping")
        entries = fields(cls)
        if missing := [
            f"'{entry.name}'" for entry in entries if entry.default is MISSING and entry.name not in entry_data
        ]:
            raise OtherVersionError(f"it has no {', '.join(missing)}")
        return cls(**{entry.name: entry_data[entry.name] for entry in entries if entry.name in entry_data})


class OtherVersionError(Exception):
    """A record is as it was written, by a version of hpcinv whose records cannot be read here."""


_BEFORE, _AFTER = b'{"record": ', b', "sha256": "%s"}\n'


def _sealed(content: bytes) -> bytes:
    return _BEFORE + content + _AFTER % _digest(content)


def _digest(content: bytes) -> bytes:
    return hashlib.sha256(content).hexdigest().encode()
