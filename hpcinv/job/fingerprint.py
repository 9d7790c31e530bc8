"""What makes two jobs the same problem, and where they differ."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpcinv.errors import MeshError
from hpcinv.job.mesh_header import SUFFIX, read_header
from hpcinv.quantity.expressions import LET
from hpcinv.quantity.schema import Location, at

if TYPE_CHECKING:
    from hpcinv.job.job import Job

_PHYSICS = {"analysis", "regions", "fibres", "material", "load_cases", "effects", "supports"}
WITH_DEFINITIONS = {LET: True}
"""Context in which a part of a job is written so that its formulas do not depend on other parts."""
_MESH = {"parameters", "unit", "geometry_degree"}  # not its path: a moved file is the same mesh


def file_digest(path: Path) -> str:
    """SHA-256 of a mesh file, and of the HDF5 files that an XDMF file keeps its numbers in.

    Of a partitioned mesh it is that of its header, which has checksums of all that is in it.
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
        advice = "Keep the .h5 file beside the .xdmf file." if path.suffix == ".xdmf" else "Is the file readable?"
        raise MeshError(f"{path}: {missing} cannot be read: {getattr(error, 'strerror', error)}", advice) from None
    return digest.hexdigest()


def fingerprint(job: Job, digest: Callable[[Path], str] = file_digest) -> dict[str, Any]:
    """The physics of a job as JSON data, with open choices filled in and files by their SHA-256 (``digest``)."""
    mesh = job.mesh.model_dump(mode="json", include=_MESH, exclude_none=True) | {
        "sha256": digest(job.resolve(job.mesh.file))
    }
    discretisation = {
        "formulation": "mixed" if job.is_mixed else "displacement",
        "displacement": job.discretisation.displacement,
        "pressure": job.pressure_degree,
        "quadrature": job.discretisation.quadrature,
    }
    physics = job.model_dump(mode="json", include=_PHYSICS, exclude_none=True, context=WITH_DEFINITIONS)
    if job.plugins:
        physics["plugins"] = [digest(job.resolve(plugin)) for plugin in job.plugins]
    return physics | {"directions": list(job.directions), "mesh": mesh, "discretisation": discretisation}


def difference(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """One line such as ``material.c1: 101709.7 -> 99999.0`` for each value that differs between two fingerprints."""
    a, b = dict(_leaves(old, ())), dict(_leaves(new, ()))
    return [
        f"{at(where)}: {a.get(where, 'absent')} -> {b.get(where, 'absent')}"
        for where in {**a, **b}
        if a.get(where, _ABSENT) != b.get(where, _ABSENT)
    ]


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
