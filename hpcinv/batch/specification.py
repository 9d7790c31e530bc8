"""What the files of studies and sweeps have in common: how they are read, and how their values are shown."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from hpcinv.errors import JobError
from hpcinv.job.yaml_reader import read_yaml
from hpcinv.quantity.schema import Spec, job_error


def read_spec[S: Spec](
    kind: type[S], name: str, path: Path, content: Mapping[str, Any] | None = None, *, untrusted: bool
) -> S:
    """A file of a kind that has a ``name``, left out that of the file.

    Args:
        content: what is in the file, if it has been read.

    Raises:
        JobError: with a line for each thing that is wrong in it.
    """
    context = {"directory": path.parent, "untrusted": untrusted}
    try:
        return kind.model_validate({name: path.stem, **(content or read_yaml(path))}, context=context)
    except ValidationError as error:
        raise job_error(path, error, kind) from None


def read_base(path: Path, job: str) -> tuple[Path, Mapping[str, Any]]:
    """Path and content of the job file that a file names, which need not be a complete job.

    Raises:
        JobError: it cannot be read.
    """
    base = path.parent / job
    try:
        return base, read_yaml(base)
    except JobError as error:
        raise JobError([f"{path}: job: {problem}" for problem in error.problems]) from None


def text_of(value: Any) -> str:
    """A value as a label has it."""
    match value:
        case float():
            return f"{value:.6g}"
        case dict():
            return " ".join(map(text_of, value.values()))
        case list() | tuple():
            return f"[{', '.join(map(text_of, value))}]"
    return str(value)
