"""Meshes that commands are given: their section as in a job."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from hpcinv.base.quantity.schema import job_error
from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.base.quantity.units import LENGTH_UNITS, parse_quantity, parse_unit
from hpcinv.base.reading.door import is_asked
from hpcinv.errors import MeshError, OutputError
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.job.vocabulary import LENGTH

JOBS = (".yaml", ".yml")
"""suffixes of job files"""
CELLS = 8000
"""cells of a body whose size of cells is not given; if it is raised, meshes are finer and take longer"""
CELL = 0.03
"""volume of a tetrahedron, relative to the cube of its size"""


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


def image_spec(path: Path, unit: str | None) -> MeshSpec:
    """Return the mesh section that makes a region of each label of an image, with cells that are few enough to look at.

    Raises:
        MeshError: the image cannot be read, or has no labels.
        JobError: its labels cannot be regions.
    """
    from hpcinv.geometry.imaging.image_files import read_voxels

    grid = read_voxels(path)
    names = {number: re.sub(r"[^\w-]", "-", name) for name, number in grid.names.items()}
    numbers = [number for number in grid.labels.tolist() if number]
    if not numbers:
        raise MeshError(f"{path}: has no labels", "Label the voxels of the body with numbers other than 0.")
    labels = {names.get(number, f"label-{number}"): number for number in numbers}
    voxel = float(grid.spacing.prod())
    counts = dict(zip(grid.labels.tolist(), grid.counts.tolist(), strict=True))
    volume = sum(counts[number] for number in numbers) * voxel
    size = f"{(volume / (CELL * CELLS)) ** (1 / 3):.3g} {unit or 'mm'}"
    entries = {"image": path.name, "labels": labels, "size": size} | ({"unit": unit} if unit else {})
    try:
        return MeshSpec.model_validate(entries, context={"directory": path.parent, "untrusted": is_asked()})
    except ValidationError as error:
        raise job_error(path, error, MeshSpec) from None


def length_unit(symbol: str) -> float:
    """Return the size (m) of the unit in ``--unit``; raises ``OutputError`` if it is none of length."""
    if symbol not in LENGTH_UNITS:
        raise OutputError(f"--unit {symbol}: is not a unit of length.{did_you_mean(symbol, LENGTH_UNITS)}")
    return parse_quantity(f"1 {symbol}")[0]


def force_unit(symbol: str) -> float:
    """Return the size (N) of the unit in ``--force-unit``; raises ``OutputError`` if it is none of force."""
    try:
        size, dimension = parse_unit(symbol)
    except ValueError as error:
        raise OutputError(f"--force-unit {symbol}: {error}") from None
    if dimension != parse_unit("N")[1]:
        raise OutputError(f"--force-unit {symbol}: is not a unit of force, such as N, mN or kN")
    return float(size)


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
    from hpcinv.base.parallel.ranks import MPI

    if MPI.COMM_WORLD.size > 1:
        raise OutputError(f"'hpcinv {command}' works on one process", "Start it without mpirun, or with 'mpirun -n 1'.")
