"""What a study has done so far: one file for each run and repetition, so that nothing is done twice."""

from __future__ import annotations

import contextlib
import itertools
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hpcinv.errors import OutputError
from hpcinv.files.atomic import replace
from hpcinv.files.names import check_output

_MARK, _RUNS = "study.json", "runs"


@dataclass(frozen=True)
class Record:
    """One execution of one run.

    Attributes:
        status: "converged", or what went wrong.
        advice: what to do about that.
        timed: whether its times count: no kernel had to be compiled, and it converged.
        statistics: what ``summary.json`` of a run holds; empty where a run did not get that far.
    """

    status: str
    advice: str
    timed: bool
    statistics: Mapping[str, Any]

    @property
    def converged(self) -> bool:
        return self.status == "converged"


class Store:
    """The directory of a study.

    Raises:
        OutputError: it holds other things than this study, or cannot be written.
    """

    def __init__(self, path: Path, study: str) -> None:
        self.path = path
        check_output(path)
        with self._told():
            if path.is_dir() and any(path.iterdir()) and self._name() != study:
                of = f"the study '{self._name()}'" if self._name() else "files that are not of a study"
                raise OutputError(f"{path}: holds {of}", "Choose another --output.")
            (path / _RUNS).mkdir(parents=True, exist_ok=True)
            for partial in path.glob("**/.*.partial"):  # of a study that was killed
                partial.unlink()
        self.write(_MARK, json.dumps({"study": study}))

    def _name(self) -> str | None:
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
            return str(json.loads((self.path / _MARK).read_text())["study"])
        return None

    def records(self, key: str) -> list[Record]:
        """What was kept of a run, oldest first; a damaged file counts as none."""
        found = []
        for path in sorted((self.path / _RUNS).glob(f"{key}-*.json")):
            try:
                found.append(Record(**json.loads(path.read_text(encoding="utf-8"))))
            except (OSError, ValueError, TypeError):
                path.unlink(missing_ok=True)
        return found

    def keep(self, key: str, record: Record) -> None:
        """Write one more record of a run."""
        names = (f"{_RUNS}/{key}-{number:03d}.json" for number in itertools.count())
        name = next(name for name in names if not (self.path / name).exists())
        self.write(name, json.dumps(asdict(record), ensure_ascii=False))

    def write(self, name: str, content: str | bytes) -> None:
        """Write a file of the study; it appears whole or not at all."""
        data = content.encode() if isinstance(content, str) else content
        path = self.path / name
        with self._told():
            replace(path, data)

    @contextlib.contextmanager
    def _told(self) -> Any:
        try:
            yield
        except OSError as exc:
            raise OutputError(f"{self.path}: cannot be written: {exc.strerror}", "Choose another --output.") from exc
