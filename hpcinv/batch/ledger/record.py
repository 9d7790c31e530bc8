"""What is committed of a case, and its file: JSON with a digest, so that a damaged one is never believed."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class CaseRecord:
    """How a case ended.

    Attributes:
        status: "converged", or the diagnosis.
        advice: what to do about that.
        statistics: what ``summary.json`` of a run holds; empty where the case did not get that far.
        seconds: wall time of the case.
        attempts: how many claims it took.
        start: key of the case whose solution it began with; "" for the unloaded body.
        compiled: whether kernels had to be compiled meanwhile, so that its time says little; told by studies.
    """

    status: str
    advice: str
    statistics: Mapping[str, Any]
    seconds: float
    attempts: int
    start: str = ""
    compiled: bool = False

    @property
    def converged(self) -> bool:
        return self.status == "converged"

    def encoded(self) -> bytes:
        """The content of its file; numbers that are not finite become null, tuples lists."""
        return _sealed(json.dumps(_plain(asdict(self)), ensure_ascii=False).encode())

    @classmethod
    def decoded(cls, data: bytes) -> CaseRecord:
        """The record in the content of a file.

        Raises:
            ValueError: it is not whole.
        """
        content = data[len(_BEFORE) : -len(_AFTER % _digest(b""))]
        if data != _sealed(content):
            raise ValueError("it is not what was written")
        try:
            return cls(**json.loads(content))
        except TypeError as error:
            raise ValueError("it has other entries") from error


_BEFORE, _AFTER = b'{"record": ', b', "sha256": "%s"}\n'


def _sealed(content: bytes) -> bytes:
    return _BEFORE + content + _AFTER % _digest(content)


def _digest(content: bytes) -> bytes:
    return hashlib.sha256(content).hexdigest().encode()


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
