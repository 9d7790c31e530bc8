"""Log of a store: one order of claims and notes on which all processes agree.

Entry N is the file ``ledger/log/NNNNNNNN.json``, created once, whole and exclusively (`create`), and never changed. A
process that adds an entry has read all earlier ones, and what it decides follows from them. If another process was
faster, the creation fails, and the process reads the new entry and decides again.
"""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from time import monotonic
from typing import Any

from hpcinv.base.files.atomic import create
from hpcinv.studies.batch.ledger.case_record import OtherVersionError, sealed, unsealed
from hpcinv.studies.batch.ledger.store import as_output_error

_NAME = "entry"


class Log:
    """Log as one process has read it.

    Args:
        lease: seconds for which an incomplete last entry may still be written, on file systems without hard links.
            An entry that stays incomplete says nothing.
    """

    def __init__(self, directory: Path, lease: float) -> None:
        self.directory, self._lease = directory, lease
        self.length = 0
        self._damaged_since: float | None = None

    def new_entries(self) -> Iterator[dict[str, Any]]:
        """Yield the entries since the last call."""
        while (entry := self._read(self.length + 1)) is not None:
            self.length += 1
            self._damaged_since = None
            yield entry

    def add(self, entry: dict[str, Any]) -> bool:
        """Add an entry next to the last one that was read; ``False`` if there is another one already."""
        file = self._file(self.length + 1)
        with as_output_error(file):
            return create(file, sealed(_NAME, entry))

    def _file(self, number: int) -> Path:
        return self.directory / f"{number:08d}.json"

    def _read(self, number: int) -> dict[str, Any] | None:
        file = self._file(number)
        with as_output_error(file):
            try:
                content = file.read_bytes()
            except (FileNotFoundError, NotADirectoryError):
                return None
            with contextlib.suppress(ValueError, OtherVersionError):
                entry = unsealed(_NAME, content)
                if isinstance(entry, dict):
                    return entry
            # Whoever added a later entry has read this one, or has waited.
            return {} if self._file(number + 1).exists() or self._is_overdue() else None

    def _is_overdue(self) -> bool:
        if self._damaged_since is None:
            self._damaged_since = monotonic()
        return monotonic() - self._damaged_since >= self._lease
