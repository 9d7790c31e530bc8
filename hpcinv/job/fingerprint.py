"""Fingerprint of the physics of a job, differences of fingerprints, and the content key of a run."""

import hashlib
import json
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from hpcinv.errors import CheckpointError, MeshError
from hpcinv.job.job import Job
from hpcinv.job.mesh_header import SUFFIX, read_header
from hpcinv.quantity.expressions import LET
from hpcinv.quantity.schema import Location, at

_PHYSICS = {"analysis", "regions", "fibres", "material", "load_cases", "effects", "supports"}
WITH_DEFINITIONS = {LET: True}
"""Serialization context in which formulas include the definitions that they use."""
_SETTINGS = {"solver", "method", "fixed_point", "certificate", "quantities"}
_OPTIONAL = {"accuracy", "sensitivities"}
_MESH = {
    "parameters",
    "unit",
    "geometry_degree",
    "labels",
    "neighbours",
    "size",
    "grade",
    "orientation",
}  # not the path


def file_digest(path: Path) -> str:
    """SHA-256 of a mesh file, including the HDF5 files of an XDMF file.

    For a partitioned mesh it is the hash of the header, which contains checksums of all arrays.
    """
    if path.suffix == SUFFIX:
        return read_header(path).digest()
    digest = hashlib.sha256()
    try:
        content = path.read_bytes()
        digest.update(content)
        if path.suffix == ".xdmf":
            for name in sorted(set(re.findall(rb">\s*([^<>:]+\.h5):", content))):
                digest.update((path.parent / os.fsdecode(name)).read_bytes())
    except (OSError, ValueError) as error:
        missing = getattr(error, "filename", None) or path
        advice = "Keep the .h5 file next to the .xdmf file." if path.suffix == ".xdmf" else "Is the file readable?"
        raise MeshError(f"{path}: {missing} cannot be read: {getattr(error, 'strerror', error)}", advice) from None
    return digest.hexdigest()


def fingerprint(job: Job, digest: Callable[[Path], str] = file_digest) -> dict[str, Any]:
    """The physics of a job as JSON data, with automatic choices resolved and files by their SHA-256 (``digest``)."""
    mesh = job.mesh.model_dump(mode="json", include=_MESH, exclude_none=True) | {
        "sha256": [digest(job.resolve(file)) for file in job.mesh.files]
        if job.mesh.surfaces
        else digest(job.resolve(job.mesh.file))
    }
    discretisation: dict[str, Any] = {
        "formulation": "mixed" if job.is_mixed else "displacement",
        "displacement": job.discretisation.displacement,
        "pressure": job.pressure_degree,
        "quadrature": job.discretisation.quadrature,
    }
    if job.is_mixed and (layerings := job.layerings):  # each layer has its own pressures
        discretisation["layers"] = [one.as_data() for one in layerings]
    physics = job.model_dump(mode="json", include=_PHYSICS, exclude_none=True, context=WITH_DEFINITIONS)
    if job.states:
        physics |= job.model_dump(mode="json", include={"states"}, exclude_none=True, context=WITH_DEFINITIONS)
    if job.plugins:
        physics["plugins"] = [digest(job.resolve(plugin)) for plugin in job.plugins]
    effects = [*job.effects, *(effect for state in job.states for effect in state.effects)]
    if files := [job.resolve(file) for effect in effects for file in effect.files]:
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
    if (expected := job.expected_shape) is not None:
        content["expected_shape"] = expected.model_dump(mode="json", exclude={"file"}) | {
            "sha256": digest(job.resolve(expected.file))
        }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:20]


def difference(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """One line such as ``material.c1: 101709.7 -> 99999.0`` for each difference between two fingerprints."""
    a, b = dict(_leaves(old, ())), dict(_leaves(new, ()))
    return [
        f"{at(where)}: {a.get(where, 'absent')} -> {b.get(where, 'absent')}"
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


def _leaves(data: Any, where: Location) -> Iterator[tuple[Location, Any]]:
    if isinstance(data, Mapping):
        for key, value in data.items():
            yield from _leaves(value, (*where, key))
    elif isinstance(data, Sequence) and not isinstance(data, str):
        for i, value in enumerate(data):
            yield from _leaves(value, (*where, i))
    else:
        yield where, data
