"""Meshes that commands are given: their section as in a job."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from hpcinv.errors import OutputError
from hpcinv.files.untrusted import is_asked
from hpcinv.job.sections import LENGTH, MeshSpec
from hpcinv.quantity.schema import job_error
from hpcinv.quantity.suggestions import did_you_mean
from hpcinv.quantity.units import LENGTH_UNITS, parse_quantity

JOBS = (".yaml", ".yml")
"""suffixes of job files"""


def mesh_spec(path: Path, given: Mapping[str, Any]) -> MeshSpec:
    """Return the mesh section for a mesh file or generator, with those entries that are ``given`` and not empty.

    Raises:
        JobError: an entry is wrong.
    """
    try:
        context = {"directory": path.parent, "untrusted": is_asked()}
        entries = {"file": path.name} | {key: value for key, value in given.items() if value}
        return MeshSpec.model_validate(entries, context=context)
    except ValidationError as error:
        raise job_error(path, error, MeshSpec) from None


def length_unit(symbol: str) -> float:
    """Return the size (m) of the unit in ``--unit``; raises ``OutputError`` if it is none of length."""
    if symbol not in LENGTH_UNITS:
        raise OutputError(f"--unit {symbol}: is not a unit of length.{did_you_mean(symbol, LENGTH_UNITS)}")
    return parse_quantity(f"1 {symbol}")[0]


def length(option: str, text: str, *, positive: bool = True) -> float:
    """Return a length in m; ``OutputError`` if it is none, or has no unit."""
    try:
        value, dimension = parse_quantity(text)
    except ValueError as error:
        raise OutputError(f"{option} {text}: {error}") from None
    if dimension != LENGTH:
        raise OutputError(f"{option} {text}: must be a length with a unit, such as '10 mm'")
    if positive and not value > 0:
        raise OutputError(f"{option} {text}: must be above 0")
    return value


def check_one_process(command: str) -> None:
    """Raise ``OutputError`` if a command was started with several ranks."""
    from hpcinv.parallel.ranks import MPI

    if MPI.COMM_WORLD.size > 1:
        raise OutputError(f"'hpcinv {command}' works on one process", "Start it without mpirun, or with 'mpirun -n 1'.")
