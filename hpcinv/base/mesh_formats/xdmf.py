"""XDMF meshes as written by DOLFINx: a grid of cells, and a grid for each set of mesh tags."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

from hpcinv.base.reading.door import admitted
from hpcinv.base.reading.mesh_format import Groups, MeshFormat

_LARGEST = 8 * 2**20
"""bytes of a file that is searched for names; raised, ``validate`` may take seconds"""
IN_FILE = re.compile(r"(.+?):(/.+)")
"""text of a data item whose values are in an HDF5 file: the file and the data set"""


class Xdmf(MeshFormat):
    suffix = ".xdmf"
    reader = "hpcinv.mesh.io.xdmf:read_xdmf"

    def groups(self, path: Path) -> Groups | None:
        """Patterns of names by grid; the values of tags are in another file."""
        if path.stat().st_size > _LARGEST:
            return None
        grids = mesh_grids(root_of(path))
        if not grids:
            return None  # not a mesh
        return Groups(frozenset(), patterns=tuple(rf"{re.escape(grid.get('Name', 'tags'))}--?\d+" for grid in grids))

    def fault_inside(self, path: Path) -> str:
        """Fault of XML that is not valid, without a mesh, or whose data are missing."""
        if path.stat().st_size > _LARGEST:
            return ""
        try:
            grids = mesh_grids(root_of(path))
        except ValueError as error:
            return f"is not valid XML: {error}"
        missing = [name for name in self.data_files(path) if not (path.parent / name).exists()]
        if missing:
            return f"has data in '{missing[0]}', and there is no such file"
        return "" if grids else "has no grid with a topology and a geometry"

    def data_files(self, path: Path, *, isolated: bool | None = None) -> list[str]:
        """HDF5 files with the values of data items."""
        try:
            items = [(item.text or "").strip() for item in root_of(path).iter("DataItem")]
        except (ValueError, OSError):  # reported by the reader
            return []
        return list(dict.fromkeys(match[1] for item in items if (match := IN_FILE.fullmatch(item))))


def root_of(path: Path) -> ET.Element:
    """Root of the XML; raises ``ValueError`` if it is not valid."""
    try:
        return ET.parse(admitted(path)).getroot()
    except (ET.ParseError, LookupError) as error:  # LookupError: an unknown encoding
        raise ValueError(str(error)) from error


def mesh_grids(root: ET.Element) -> list[ET.Element]:
    """Grids with a topology: the mesh, and its tags."""
    return [grid for grid in root.findall("Domain/Grid") if grid.find("Topology") is not None]
