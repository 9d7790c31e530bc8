"""Input files of Abaqus and CalculiX: node sets, element sets and surfaces are regions."""

import re
from pathlib import Path

from hpcinv.formats.mesh_format import Groups, MeshFormat
from hpcinv.reading.fault import Fault
from hpcinv.reading.included_files import included_by, lines_of

_NAMED = re.compile(
    r"^\s*\*\s*(?:NODE|ELEMENT|NSET|ELSET|SURFACE)\b[^\n]*?\b(?:NSET|ELSET|NAME)\s*=\s*\"?([^,\"\n]+)", re.I | re.M
)
_SEVERAL = re.compile(r"^\s*\*\s*INSTANCE\b", re.I | re.M)
_CONDITIONS = (
    r".+-(P[1-6]|EDNOR[1-4]|nodes|surface)",
    r"held-[rxyz]+(=.+)?",
    r"(loaded|turned|pressed|edge-loaded)(-\d+)?",
)
"""faces of the elements of a set, by a line of ``*DLOAD``, and what lines on single nodes and elements hold or load"""
_LARGEST = 200 * 2**20
"""bytes of a file that is searched for names; raised, ``validate`` may take seconds"""


class Inp(MeshFormat):
    suffix = ".inp"
    action = "inp"
    reader = "hpcinv.mesh.io.inp:read_inp"
    saver = "hpcinv.mesh.io.inp:save_inp"
    saves_27_nodes = "if read"

    def groups(self, path: Path) -> Groups | None:
        """Groups by the names of sets and surfaces; unknown in an assembly, whose sets belong to instances."""
        if path.stat().st_size > _LARGEST:
            return None
        try:
            text = "\n".join(line.text for line in lines_of(path, _LARGEST))
        except Fault:  # reported by the reader
            return None
        if _SEVERAL.search(text):
            return None
        return Groups(frozenset(name.strip() for name in _NAMED.findall(text)), patterns=_CONDITIONS)

    def data_files(self, path: Path) -> list[str]:
        """Files that it includes."""
        return included_by(path)
