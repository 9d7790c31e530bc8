"""The header of a partitioned mesh: what is known of it before any of its arrays is read.

A partitioned mesh is a directory ``NAME.bp`` of ADIOS2, with this header in it as ``mesh.json``.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from hpcinv.errors import MeshError

SUFFIX = ".bp"
HEADER = "mesh.json"
_FORMAT = 1


@dataclass(frozen=True)
class Header:
    """Sizes and names of what is in a partitioned mesh.

    Attributes:
        name: of the file that it was made of.
        kind, degree: of the cells.
        nodes, cells, facets: how many there are; facets are those of groups.
        parts: rows of cells at which the parts begin, and the number of cells.
        groups: name, dimension and tag of each physical group.
        thin_groups: names of groups of points and curves.
        data: name, place ("nodes" or "cells") and number of components of each data array.
        checksums: of each array, by its name in the file.
        files: bytes of each file that ADIOS2 has written.
        unit: length unit (m) of the file that it was made of; its own coordinates are in metres.
    """

    name: str
    kind: str
    degree: int
    nodes: int
    cells: int
    facets: int
    parts: tuple[int, ...]
    groups: tuple[tuple[str, int, int], ...]
    thin_groups: tuple[str, ...]
    data: tuple[tuple[str, str, int], ...]
    checksums: Mapping[str, str]
    files: Mapping[str, int]
    unit: float = 1.0

    def write(self, path: Path) -> None:
        """Put it into the partitioned mesh at ``path``."""
        text = json.dumps({"format": _FORMAT} | asdict(self), ensure_ascii=False)
        (path / HEADER).write_text(text + "\n", encoding="utf-8")

    def digest(self) -> str:
        """SHA-256 of the mesh, whichever way its arrays are spread over files."""
        content = asdict(self)
        del content["name"], content["files"], content["unit"]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def read_header(path: Path) -> Header:
    """The header of the partitioned mesh at ``path``.

    Raises:
        MeshError: it is none, it is damaged, or another version has written it.
    """
    try:
        content = json.loads((path / HEADER).read_text(encoding="utf-8"))
        found = content.pop("format")
        if found != _FORMAT:
            raise MeshError(
                f"{path}: has format {found}, but this version of hpcinv reads {_FORMAT}",
                "Partition the mesh anew with 'hpcinv mesh partition'.",
            )
        lists = {key: tuple(tuple(v) if isinstance(v, list) else v for v in content[key]) for key in _LISTS}
        header = Header(**(content | lists))
        # ADIOS2 would wait for ever for what is missing at the end of a file.
        damaged = [name for name, size in header.files.items() if (path / name).stat().st_size != size]
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as exc:
        raise MeshError(
            f"{path}: {HEADER} in it cannot be read ({type(exc).__name__}): it is no partitioned mesh, or not whole",
            "Make one with 'hpcinv mesh partition'.",
        ) from exc
    if damaged:
        raise MeshError(f"{path}: {damaged[0]} in it is not as long as it was", "Copy it again, or make it anew.")
    return header


_LISTS = ("parts", "groups", "thin_groups", "data")
