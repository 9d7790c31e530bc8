"""Messages between a supervisor and the processes of its group, through two files in a directory."""

import pickle
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Self, TextIO

from hpcinv.errors import HpcinvError
from hpcinv.studies.batch.ledger.claims import Claim
from hpcinv.studies.batch.task import Batch, BatchTask

_TASK, _EVENTS = "task", "events"


@dataclass(frozen=True)
class GroupTask:
    """Task of a group; attributes as in `hpcinv.studies.batch.worker.work`."""

    batch: Batch
    begin: float
    lease: float

    def write(self, directory: Path) -> None:
        (directory / _TASK).write_bytes(pickle.dumps(self))
        (directory / _EVENTS).touch()

    @classmethod
    def read(cls, directory: Path) -> Self:
        task: Self = pickle.loads((directory / _TASK).read_bytes())
        return task


@dataclass(frozen=True)
class CaseStarted:
    """Event: a case that the group solves now."""

    title: str
    claim: Claim


@dataclass(frozen=True)
class Ended:
    """Event: the group has ended by itself, with an ``error`` unless no case was left."""

    error: HpcinvError | None


class EventWriter:
    """Writer of the events of a group, in the group."""

    def __init__(self, directory: Path) -> None:
        self._file: TextIO = (directory / _EVENTS).open("a", encoding="ascii")

    def holding(self, task: BatchTask | None) -> None:
        """Write which case the group solves now, ``None`` for none."""
        self._write(None if task is None else CaseStarted(task.title, task.claim))

    def ended(self, error: HpcinvError | None) -> None:
        self._write(Ended(error))

    def _write(self, event: CaseStarted | Ended | None) -> None:
        self._file.write(pickle.dumps(event).hex() + "\n")
        self._file.flush()


class EventReader:
    """Reader of the events of a group, in its supervisor."""

    def __init__(self, directory: Path) -> None:
        self._file = (directory / _EVENTS).open("rb")
        self._rest = b""

    def events(self) -> Iterator[CaseStarted | Ended | None]:
        """Yield the events since the last call; ``None``: no case is solved now."""
        *lines, self._rest = (self._rest + self._file.read()).split(b"\n")
        for line in lines:
            yield pickle.loads(bytes.fromhex(line.decode()))

    def close(self) -> None:
        self._file.close()
