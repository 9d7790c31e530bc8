"""Reading of study and sweep files, with a summary of the faults of their cases, and labels of values."""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from hpcinv.base.quantity.keys import assigned
from hpcinv.base.quantity.schema import Spec, job_error, name_from
from hpcinv.errors import JobError
from hpcinv.job.yaml_reader import read_yaml

_VALUE = re.compile(r", (?:not|but) .*", re.DOTALL)


def read_spec[S: Spec](
    kind: type[S], name: str, path: Path, content: Mapping[str, Any] | None = None, *, untrusted: bool
) -> S:
    """Read a file of a kind; where its key ``name`` is left out, it is the name of the file.

    Raises:
        JobError: with a line for each fault.
    """
    context = {"directory": path.parent, "untrusted": untrusted}
    try:
        return kind.model_validate({name: name_from(path), **(content or read_yaml(path))}, context=context)
    except ValidationError as error:
        raise job_error(path, error, kind) from None


def read_base(path: Path, job: str) -> tuple[Path, Mapping[str, Any]]:
    """Return path and content of the job file that a file names, which need not be a complete job.

    Raises:
        JobError: it cannot be read.
    """
    base = path.parent / job
    try:
        return base, read_yaml(base)
    except JobError as error:
        raise JobError(*(f"{path}: job: {problem}" for problem in error.problems)) from None


def changed_data(data: Mapping[str, Any], settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of a job file with other values; raises ``JobError`` if they cannot be set."""
    try:
        return assigned(data, settings)
    except ValueError as error:
        raise JobError(str(error)) from None


class SpecificationFaults:
    """Faults of the cases of a file, each listed once, with the number of cases that have it."""

    def __init__(self, path: Path, noun: str) -> None:
        self.path, self.noun = path, noun
        self._found: dict[str, tuple[str, str, int]] = {}

    @contextmanager
    def collected(self, title: str, base: Path) -> Iterator[None]:
        """Context in which a ``JobError`` of the job file ``base`` is a fault of a case."""
        try:
            yield
        except JobError as error:
            self.add(error, title, base)

    def add(self, error: JobError, title: str, base: Path) -> None:
        """Add the faults of the job file ``base`` that a case has."""
        for problem in error.problems:
            text = problem.removeprefix(f"{base}: ")
            like = _VALUE.sub("", text)  # sampled values differ from case to case
            first, fault, others = self._found.get(like, (title, text, -1))
            self._found[like] = first, fault, others + 1

    def raise_if_any(self) -> None:
        """Raise a ``JobError`` with a line for each fault."""
        if self._found:
            raise JobError(*(self._line(*fault) for fault in self._found.values()))

    def _line(self, title: str, text: str, others: int) -> str:
        also = f" (and {others} more {self.noun}{'s' if others > 1 else ''})" if others else ""
        return f"{self.path}: {title}{also}: {text}"


def texts_of(parameters: Mapping[str, Any]) -> list[str]:
    """Return each parameter as text of a label, by the last part of its key."""
    return [f"{key.rpartition('.')[2]} {text_of(value)}" for key, value in parameters.items()]


def text_of(value: Any) -> str:
    """Return a value as text of a label."""
    match value:
        case float():
            return f"{value:.6g}"
        case dict():
            return " ".join(map(text_of, value.values()))
        case list() | tuple():
            return f"[{', '.join(map(text_of, value))}]"
    return str(value)
