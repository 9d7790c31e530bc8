"""Claims and states of cases, and the numbers of deaths after which a case is given up."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from hpcinv.studies.batch.ledger.history import Mark

DEADLY = 5
"""Number of processes that died with a case after which the case has failed.

A process can also die with its allocation, so one or two deaths do not mean that the case is the cause.
"""

LOST = 25
"""Number of processes that died together with their supervisor after which the case has failed.

A supervisor survives a crash of its case, so this is most likely a kill of the whole allocation.
"""

KILLED = "ended by SIGKILL"
"""End of a process that was killed, perhaps since another process has used up the memory."""

CRASHES = 2
"""Number of crashes, noted by a supervisor, after which the case has failed."""


@dataclass(frozen=True)
class Claim:
    """The right to work on a case.

    Attributes:
        round, attempt: number of the round, and of the claim in it, both from 1.
        died: number of earlier attempts that ended with their process.
        lost: number of further attempts that ended together with their supervisor.
        crashes: for each earlier attempt that crashed its process, how the process ended.
        run: directory of checkpoints and results, also of earlier attempts; it need not exist.
    """

    key: str
    round: int
    attempt: int
    died: int
    run: Path
    crashes: tuple[str, ...] = ()
    lost: int = 0

    @property
    def mark(self) -> Mark:
        return self.key, self.round, self.attempt


@dataclass(frozen=True)
class CaseState:
    """State of a case.

    Attributes:
        holder: the process that works on it, for display.
        died: number of attempts at an open case that ended with their process.
        living: whether it is certain that the holder is alive.
        waits: whether the holder works on other cases first.
    """

    name: Literal["open", "running", "finished"]
    holder: str = ""
    died: int = 0
    living: bool = False
    waits: bool = False
