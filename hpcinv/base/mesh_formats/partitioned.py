"""Partitioned meshes: a directory ``NAME.bp`` of ADIOS2, with a header, ``mesh.json``; each rank reads a part of it."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from hpcinv.base.reading.door import REFUSED, trusted
from hpcinv.base.reading.mesh_format import Groups, MeshFormat
from hpcinv.errors import MeshError

SUFFIX = ".bp"
HEADER = "mesh.json"
_FORMAT = 2
_REMEDY = "Copy the mesh again, or partition it again."


@dataclass(frozen=True)
class Header:
    """Sizes and names of the parts of a partitioned mesh.

    Attributes:
        name: name of the original mesh file.
        nodes, cells, facets: their numbers; only facets of groups count.
        parts: rows of cells at which the parts begin, followed by the number of cells.
        thin_groups: names of groups of points and curves.
        data: name, place ("nodes" or "cells") and number of components of each data array.
        checksums: of each array, by its name in the file.
        files: size in bytes and SHA-256 of each file written by ADIOS2; the hash is empty for files with the arrays,
            which have checksums.
        unit: length unit (m) of the original mesh file; the partitioned mesh itself is in metres.
        overlapping: whether a cell or facet is in several groups; the arrays of groups are masks then.
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
    data: tuple[tuple[str, Literal["nodes", "cells"], int], ...]
    checksums: Mapping[str, str]
    files: Mapping[str, tuple[int, str]]
    unit: float = 1.0
    overlapping: bool = False

    def write(self, path: Path) -> None:
        content = {"format": _FORMAT} | self._content()
        text = json.dumps(content | {"sha256": _digest(content)}, ensure_ascii=False)
        (path / HEADER).write_text(text + "\n", encoding="utf-8")

    def digest(self) -> str:
        """SHA-256 of the mesh, independent of the distribution of its arrays over files."""
        content = self._content()
        del content["name"], content["files"], content["unit"]
        return _digest(content)

    def _content(self) -> dict[str, Any]:
        content = asdict(self)
        if not self.overlapping:  # so that earlier versions read the mesh
            del content["overlapping"]
        return content


def _digest(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def describe_file(path: Path) -> tuple[int, str]:
    """Size in bytes of a file of a partitioned mesh, and its SHA-256, or empty text for files with the arrays."""
    is_data = path.name.startswith("data.")
    return path.stat().st_size, "" if is_data else hashlib.sha256(path.read_bytes()).hexdigest()


def read_header(path: Path) -> Header:
    """Read the header of the partitioned mesh at ``path``.

    Raises:
        MeshError: it is not a partitioned mesh, is damaged, or was written by another version.
    """
    try:
        content = json.loads(trusted(path / HEADER).read_text(encoding="utf-8"))
        version = content.pop("format")
        if version != _FORMAT:
            raise MeshError(
                f"{path}: has format {version}, but this version of hpcinv reads {_FORMAT}",
                "Partition the mesh again with 'hpcinv mesh partition'.",
            )
        if content.pop("sha256") != _digest({"format": version} | content):
            raise MeshError(f"{path}: {HEADER} in it is damaged: its checksum is wrong", _REMEDY)
        lists = {key: tuple(tuple(v) if isinstance(v, list) else v for v in content[key]) for key in _LISTS}
        header = Header(**(content | lists))
        # ADIOS2 would wait forever at a truncated file, and crash on wrong offsets.
        damaged = [name for name, known in header.files.items() if describe_file(path / name) != tuple(known)]
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as exc:
        raise MeshError(
            f"{path}: {HEADER} in it cannot be read ({type(exc).__name__}): not a partitioned mesh, or incomplete",
            "Make one with 'hpcinv mesh partition'.",
        ) from exc
    if damaged:
        raise MeshError(f"{path}: {damaged[0]} in it is damaged: its size or checksum is wrong", _REMEDY)
    return header


_LISTS = ("parts", "groups", "thin_groups", "data")


class Partitioned(MeshFormat):
    suffix = SUFFIX
    reader = "hpcinv.mesh.distributed.partitioned:read_whole"
    is_partitioned = True
    head = HEADER

    def groups(self, path: Path) -> Groups:
        header = read_header(path)
        return Groups(frozenset(name for name, _, _ in header.groups), frozenset(header.thin_groups))

    def untrusted(self) -> str:
        return (
            f"can make ADIOS2 load libraries, and is {REFUSED}; ask for one file (.msh, .vtu),"
            " as 'hpcinv mesh gather' makes it"
        )
