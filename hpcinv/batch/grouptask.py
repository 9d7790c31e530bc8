"""What a supervisor and the processes of its group tell each other, by two files in a directory of their own."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from hpcinv.batch.ledger.ledger import Claim
from hpcinv.errors import HpcinvError

if TYPE_CHECKING:
    from hpcinv.batch.task import Batch, BatchTask

_TASK, _EVENTS = "task", "events"


@dataclass(frozen=True)
class GroupTask:
    """What a group does; see `hpcinv.batch.worker.work`."""

    batch: Batch
    begin: float
    lease: float

    def write(self, directory: Path) -> None:
        (directory / _TASK).write_bytes(pickle.dumps(self))
        (directory / _EVENTS).touch()

    @classmethod
    def read(cls, directory: Path) -> GroupTask:
        task: GroupTask = pickle.loads((directory / _TASK).read_bytes())
        return task


@dataclass(frozen=True)
class Held:
    """A case that is worked on."""

    title: str
    claim: Claim


@dataclass(frozen=True)
class Ended:
    """That a group has come to an end by itself; ``error``: why, unless no case was left."""

    error: HpcinvError | None


class Speaker:
    """The side of the group: what it tells, it tells at once."""

    def __init__(self, directory: Path) -> None:
        self._file: TextIO = (directory / _EVENTS).open("a", encoding="ascii")

    def holding(self, task: BatchTask | None) -> None:
        """Which case is worked on."""
        self._tell(None if task is None else Held(task.title, task.claim))

    def ended(self, error: HpcinvError | None) -> None:
        self._tell(Ended(error))

    def _tell(self, event: Held | Ended | None) -> None:
        self._file.write(pickle.dumps(event).hex() + "\n")
        self._file.flush()


class Listener:
    """The side of the supervisor."""

    def __init__(self, directory: Path) -> None:
        self._file = (directory / _EVENTS).open("rb")
        self._rest = b""

    def events(self) -> Iterator[Held | Ended | None]:
        """What was told since the last call: a case that is worked on, that none is, or the end."""
        *lines, self._rest = (self._rest + self._file.read()).split(b"\n")
        for line in lines:
            yield pickle.loads(bytes.fromhex(line.decode()))

    def close(self) -> None:
        self._file.close()
