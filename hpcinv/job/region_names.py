"""Names of the regions of a mesh file, as far as they can be read without the mesh libraries.

``hpcinv validate`` uses them to report unknown regions of a job. It reports only what is certain: groups of generators
are unknown before these run, and unnamed groups in MSH files have names such as ``surface-3``.
"""

import contextlib
import mmap
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from xml.parsers import expat

from hpcinv.errors import MeshError
from hpcinv.job.mesh_header import SUFFIX, read_header
from hpcinv.quantity.schema import KeyPath
from hpcinv.quantity.suggestions import did_you_mean

_BOUNDARY = "boundary"
_VTU = "region:"
_LARGEST_XML = 8 * 2**20
_NAMED = re.compile(rb"\$PhysicalNames\r?\n(.*?)\$EndPhysicalNames", re.DOTALL)
_NAME = re.compile(rb'^\s*(\d+)\s+-?\d+\s+"(.*)"\s*$', re.MULTILINE)


@dataclass(frozen=True)
class Groups:
    """Names of the groups of surfaces and volumes of a mesh, and of points and curves; patterns of further names."""

    names: frozenset[str]
    thin: frozenset[str] = frozenset()
    patterns: tuple[str, ...] = ()


def unknown_regions(
    path: Path, defined: Iterable[str], named: Iterable[tuple[KeyPath, str]]
) -> Iterator[tuple[KeyPath, str]]:
    """Places in a job with the name of an unknown region, and messages.

    Args:
        named: all references of the job to regions, with their places.
    """
    try:
        state = path.stat()
        groups = _groups(path, state.st_mtime_ns, state.st_size)
    except (OSError, ValueError, MeshError):  # reported where the mesh is read
        return
    if groups is None:
        return
    known = {*defined, _BOUNDARY, *groups.names}
    for where, name in named:
        if name in known or any(re.fullmatch(pattern, name) for pattern in groups.patterns):
            continue
        hint = did_you_mean(name, known)
        if name in groups.thin:
            hint = " It is a physical group of points or curves, and regions are surfaces or volumes."
        yield where, f"there is no region '{name}' in {path.name}, nor in 'regions'.{hint}"


@lru_cache(maxsize=16)  # all cases of a sweep use one mesh
def _groups(path: Path, _changed: int, _size: int) -> Groups | None:
    """Groups of a mesh file, None if they cannot be known."""
    match path.suffix:
        case ".msh":
            return _msh_groups(path)
        case ".vtu":
            return _vtu_groups(path)
        case ".xdmf":
            return _xdmf_groups(path)
        case suffix if suffix == SUFFIX:
            header = read_header(path)
            return Groups(frozenset(name for name, _, _ in header.groups), frozenset(header.thin_groups))
    return None


def _msh_groups(path: Path) -> Groups | None:
    """Groups of an MSH file; names are text also in binary files."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        if content[:1] != b"$" or content.find(b"$Elements") < 0:
            return None  # not MSH 2 or 4, or incomplete
        names: dict[bool, set[str]] = {False: set(), True: set()}
        for section in _NAMED.finditer(content):
            for dim, name in _NAME.findall(section[1]):
                names[int(dim) < 2].add(name.decode(errors="replace"))
    return Groups(frozenset(names[False]), frozenset(names[True] - names[False]), (r"(?:surface|volume)-\d+",))


class _HeaderEnd(Exception):
    pass


def _vtu_groups(path: Path) -> Groups | None:
    """Groups by the names of cell arrays, which are declared before any appended data."""
    if path.stat().st_size > 100 * _LARGEST_XML:
        return None
    names, is_whole = set[str](), [False]

    def begins(tag: str, attributes: dict[str, str]) -> None:
        if tag == "AppendedData":  # what follows may not be XML
            is_whole[0] = True
            raise _HeaderEnd
        if tag == "DataArray" and attributes.get("Name", "").startswith(_VTU):
            names.add(attributes["Name"].removeprefix(_VTU))

    def ends(tag: str) -> None:
        is_whole[0] = is_whole[0] or tag == "VTKFile"

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = begins, ends
    with contextlib.suppress(_HeaderEnd, expat.ExpatError), path.open("rb") as file:
        parser.ParseFile(file)
    return Groups(frozenset(names)) if is_whole[0] else None


def _xdmf_groups(path: Path) -> Groups | None:
    """Patterns of names by grid; the values of tags are in another file."""
    if path.stat().st_size > _LARGEST_XML:
        return None
    try:
        elements = ET.parse(path).getroot().findall("Domain/Grid")
    except (ET.ParseError, ValueError, LookupError):
        return None
    grids = [grid for grid in elements if grid.find("Topology") is not None]
    if not grids:
        return None  # not a mesh
    return Groups(frozenset(), patterns=tuple(rf"{re.escape(grid.get('Name', 'tags'))}--?\d+" for grid in grids))
