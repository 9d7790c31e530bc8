"""Fingerprint of the physics of a job, differences of fingerprints, and the content key of a run."""

import glob
import hashlib
import json
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from hpcinv.errors import CheckpointError, MeshError
from hpcinv.formats import FORMATS
from hpcinv.formats.partitioned_header import read_header
from hpcinv.job.job import Job
from hpcinv.quantity.expressions import LET
from hpcinv.quantity.plugins import inputs_of
from hpcinv.quantity.schema import KeyPath, dotted_key
from hpcinv.reading.suffix import suffix_of

_PHYSICS = {"analysis", "regions", "fibres", "material", "load_cases", "effects", "supports"}
WITH_DEFINITIONS = {LET: True}
"""Serialization context in which formulas include the definitions that they use."""
_SETTINGS = {"solver", "method", "fixed_point", "certificate", "quantities"}
_OPTIONAL = {"accuracy", "cavities", "sensitivities"}
_MESH = {
    "parameters",
    "unit",
    "geometry_degree",
    "shell",
    "labels",
    "array_labels",
    "neighbours",
    "size",
    "grade",
    "glue",
    "orientation",
}  # not the path

_HEADERS = (".mhd", ".mha", ".nrrd", ".nhdr")
"""suffixes of images whose header may name other files for the voxels"""
_LONGEST_HEADER = 2**20
"""bytes that are searched for such names; a name that comes later would not count"""


def file_digest(path: Path) -> str:
    """SHA-256 of a file, including the files in which it says that its data are: XDMF files, and headers of images.

    For a partitioned mesh it is the hash of the header, which contains checksums of all arrays.
    """
    mesh_format = FORMATS.get(suffix_of(path))
    if mesh_format and mesh_format.is_partitioned:
        return read_header(path).digest()
    digest = hashlib.sha256()
    try:
        content = path.read_bytes()
        digest.update(content)
        for name in sorted(mesh_format.data_files(path)) if mesh_format else ():
            digest.update((path.parent / name).read_bytes())
        if suffix_of(path) in _HEADERS:
            for file in _voxel_files(path, content[:_LONGEST_HEADER]):
                digest.update(file.name.encode())
                with file.open("rb") as voxels:
                    digest.update(hashlib.file_digest(voxels, "sha256").digest())
    except (OSError, ValueError) as error:
        missing = getattr(error, "filename", None) or path
        advice = "Keep the .h5 file next to the .xdmf file." if mesh_format else "Is the file readable?"
        raise MeshError(f"{path}: {missing} cannot be read: {getattr(error, 'strerror', error)}", advice) from None
    return digest.hexdigest()


def _voxel_files(path: Path, header: bytes) -> list[Path]:
    """Return the files next to the header of an image that hold its voxels: one, a list, or a numbered series."""
    named = re.search(rb"^\s*(?:ElementDataFile\s*=|data ?file:)[ \t]*([^\r\n]*)", header, re.IGNORECASE | re.MULTILINE)
    if named is None or named[1].strip().upper() == b"LOCAL":
        return []
    words = named[1].split()
    if words and words[0].upper() == b"LIST":
        names = [line.strip() for line in header[named.end() :].splitlines()]
        return [file for name in names if name and (file := path.parent / os.fsdecode(name)).is_file()]
    if (file := path.parent / os.fsdecode(named[1].strip())).is_file():
        return [file]
    if words and b"%" in words[0]:  # a series such as slice%03d.raw 1 99 1
        pattern = re.sub("%[0-9]*d", "*", glob.escape(os.fsdecode(words[0])))
        return sorted(file for file in path.parent.glob(pattern) if file.is_file())
    return []


def fingerprint(job: Job, digest: Callable[[Path], str] = file_digest) -> dict[str, Any]:
    """The physics of a job as JSON data, with automatic choices resolved and files by their SHA-256 (``digest``)."""
    mesh = job.mesh.model_dump(mode="json", include=_MESH, exclude_none=True) | {
        "sha256": {name: [digest(job.resolve(file)) for file in files] for name, files in job.mesh.surfaces.items()}
        or digest(job.resolve(job.mesh.file)),
        "unit": job.mesh.metres,  # of an image by default mm
    }
    if faces := job.mesh.faces:
        mesh["faces"] = {name: [digest(job.resolve(file)) for file in files] for name, files in faces.items()}
    discretisation: dict[str, Any] = {
        "formulation": "mixed" if job.is_mixed else "displacement",
        "displacement": job.discretisation.displacement,
        "pressure": job.pressure_degree,
        "quadrature": job.discretisation.quadrature,
    }
    if job.is_mixed and (layerings := job.layerings):  # each layer has its own pressures
        discretisation["layers"] = [layering.as_data() for layering in layerings]
    if job.discretisation.displacement > 1 and any(solve.mesh is not None for solve in job.plan):
        # Later solves are on the recovered body. Earlier versions moved the nodes of its given cells only.
        discretisation["recovered_geometry"] = job.discretisation.displacement
    physics = job.model_dump(mode="json", include=_PHYSICS, exclude_none=True, context=WITH_DEFINITIONS)
    if job.states:
        physics |= job.model_dump(mode="json", include={"states"}, exclude_none=True, context=WITH_DEFINITIONS)
    if job.controlled_cavities:
        physics |= job.model_dump(mode="json", include={"cavities"}, exclude_none=True)
    if job.plugins:
        plugins = [job.resolve(plugin) for plugin in job.plugins]
        physics["plugins"] = [digest(path) for path in plugins]
        if any(inputs := [inputs_of(path) for path in plugins]):
            physics["inputs_of_plugins"] = inputs
    effects = [*job.effects, *(effect for state in job.states for effect in state.effects)]
    if files := [job.resolve(file) for file in (*job.files, *(file for effect in effects for file in effect.files))]:
        physics["files"] = [digest(file) for file in files]
    return physics | {"directions": list(job.directions), "mesh": mesh, "discretisation": discretisation}


def content_key(job: Job, digest: Callable[[Path], str] = file_digest, **circumstances: Any) -> str:
    """Hash (20 hex digits) of the physics, mesh, spaces, solver, certificate and requested results of a job.

    Names, paths, output, checkpoints, and the units of values have no influence.

    Args:
        digest: SHA-256 of a file; callers with many jobs on the same files can cache it.
        circumstances: further data that distinguish runs, as JSON data, such as ``ranks``.
    """
    content = (
        fingerprint(job, digest)
        | job.model_dump(mode="json", include=_SETTINGS, context=WITH_DEFINITIONS)
        | circumstances
    )
    content |= {name: part for name, part in job.model_dump(mode="json", include=_OPTIONAL).items() if part}
    if job.solver.start_shape is not None:
        content["start_shape"] = digest(job.resolve(job.solver.start_shape))
    if job.mesh.surface_error is not None:
        content["surface_error"] = job.mesh.surface_error.model_dump(mode="json")
    if (expected := job.expected_shape) is not None:
        content["expected_shape"] = expected.model_dump(mode="json", exclude={"file"}) | {
            "sha256": digest(job.resolve(expected.file)),
            "unit": expected.metres,
        }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:20]


def difference(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """One line such as ``material.c1: 101709.7 -> 99999.0`` for each difference between two fingerprints."""
    a, b = dict(_leaves(old, ())), dict(_leaves(new, ()))
    return [
        f"{dotted_key(where)}: {a.get(where, 'absent')} -> {b.get(where, 'absent')}"
        for where in {**a, **b}
        if a.get(where, _ABSENT) != b.get(where, _ABSENT)
    ]


def check_same_problem(path: Path, old: Mapping[str, Any], new: Mapping[str, Any]) -> None:
    """Raise ``CheckpointError`` with the differences, if what is in ``path`` has another fingerprint than a job."""
    if changes := difference(old, new):
        raise CheckpointError(
            "\n".join([f"{path}: belongs to another problem:", *(f"  {line}" for line in changes)]),
            "A resume may change solver, output and checkpoint settings, but not the physics; use 'run' for that.",
        )


_ABSENT = object()


def _leaves(data: Any, where: KeyPath) -> Iterator[tuple[KeyPath, Any]]:
    if isinstance(data, Mapping):
        for key, value in data.items():
            yield from _leaves(value, (*where, key))
    elif isinstance(data, Sequence) and not isinstance(data, str):
        for i, value in enumerate(data):
            yield from _leaves(value, (*where, i))
    else:
        yield where, data
