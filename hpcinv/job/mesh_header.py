"""The header of a partitioned mesh: what is known of it before any of its arrays is read.

A partitioned mesh is a directory ``NAME.bp`` of ADIOS2, with this header in it as ``mesh.json``.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hpcinv.errors import MeshError

SUFFIX = ".bp"
HEADER = "mesh.json"
_FORMAT = 2


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
        files: bytes of each file that ADIOS2 has written, and the SHA-256 of those that say where data are; of the
            others, whose arrays have checksums, it is empty.
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
    files: Mapping[str, tuple[int, str]]
    unit: float = 1.0

    def write(self, path: Path) -> None:
        """Put it into the partitioned mesh at ``path``."""
        content = {"format": _FORMAT} | asdict(self)
        text = json.dumps(content | {"sha256": _digest(content)}, ensure_ascii=False)
        (path / HEADER).write_text(text + "\n", encoding="utf-8")

    def digest(self) -> str:
        """SHA-256 of the mesh, whichever way its arrays are spread over files."""
        content = asdict(self)
        del content["name"], content["files"], content["unit"]
        return _digest(content)


def _digest(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def describe_file(path: Path) -> tuple[int, str]:
    """Bytes of a file of a partitioned mesh, and its SHA-256 unless it holds the arrays."""
    is_data = path.name.startswith("data.")
    return path.stat().st_size, "" if is_data else hashlib.sha256(path.read_bytes()).hexdigest()


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
        if content.pop("sha256") != _digest({"format": found} | content):
            raise MeshError(f"{path}: {HEADER} in it is not what was written", "Copy it again, or make it anew.")
        lists = {key: tuple(tuple(v) if isinstance(v, list) else v for v in content[key]) for key in _LISTS}
        header = Header(**(content | lists))
        # ADIOS2 would wait for ever for what is missing at the end of a file, and crash on wrong offsets.
        damaged = [name for name, known in header.files.items() if describe_file(path / name) != tuple(known)]
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as exc:
        raise MeshError(
            f"{path}: {HEADER} in it cannot be read ({type(exc).__name__}): it is no partitioned mesh, or not whole",
            "Make one with 'hpcinv mesh partition'.",
        ) from exc
    if damaged:
        raise MeshError(f"{path}: {damaged[0]} in it is not what was written", "Copy it again, or make it anew.")
    return header


_LISTS = ("parts", "groups", "thin_groups", "data")
