"""Log of a run, ``run.log`` in its directory: all messages with their times, on rank 0."""

import shlex
import sys
import time
from pathlib import Path
from typing import TextIO

NAME = "run.log"
_STAMP = "%Y-%m-%d %H:%M:%S"


class RunLog:
    """Lines with their times; lines before the file is open are kept and written then.

    If the file cannot be written, the log ends but the run continues; ``fault`` is the reason.

    Args:
        written: whether this process writes a log; otherwise lines are dropped.
    """

    def __init__(self, *, written: bool) -> None:
        self.fault = ""
        self._file: TextIO | None = None
        self._waiting: list[str] | None = [] if written else None

    def open(self, directory: Path) -> None:
        """Open the log of a directory, after the lines of earlier runs there."""
        self.close()
        try:
            self._file = (directory / NAME).open("a", encoding="utf-8")
        except OSError as error:
            self._fail(error)
            return
        waiting, self._waiting = self._waiting or [], []
        command = shlex.join(["python", "-m", "hpcinv", *sys.argv[1:]]) if sys.argv[1:] else "hpcinv, from Python"
        self._append("".join([f"{time.strftime(_STAMP)} {command}\n", *waiting]))

    def write(self, text: str) -> None:
        stamp = time.strftime(_STAMP)
        lines = "".join(f"{stamp}   {line}\n" for line in text.splitlines())
        if self._file is not None:
            self._append(lines)
        elif self._waiting is not None:
            self._waiting.append(lines)

    def close(self) -> None:
        if self._file is not None:
            try:
                self._file.close()
            except OSError as error:
                self._fail(error)
            self._file = None

    def _append(self, text: str) -> None:
        assert self._file is not None
        try:
            self._file.write(text)
            self._file.flush()
        except OSError as error:
            self._fail(error)

    def _fail(self, error: OSError) -> None:
        self.fault = f"{NAME} cannot be written: {error.strerror or error}"
        self._file = self._waiting = None
