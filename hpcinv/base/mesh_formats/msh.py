"""gmsh's MSH format, versions 2 and 4, as text or binary."""

import mmap
import re
from pathlib import Path

from hpcinv.base.reading.door import admitted
from hpcinv.base.reading.mesh_format import Groups, MeshFormat

_HEADERS = (b"$MeshFormat", b"$Comments", b"$NOD")
"""First lines of MSH 2 and 4, the same after a comment, and MSH 1."""
_BEGIN, _END = b"$PhysicalNames", b"$EndPhysicalNames"
_NAME = re.compile(rb'[ \t]*(\d+)[ \t]+-?\d+[ \t]+"(.*)"\s*')


class Msh(MeshFormat):
    suffix = ".msh"
    action = "msh"
    reader = "hpcinv.mesh.readers:read_msh"
    saver = "hpcinv.mesh.io.gmsh_model:save_msh"

    def fault(self, path: Path) -> str:
        """Fault of the first line: gmsh recognizes the format by it.

        It executes other files as scripts, which can start programs.
        """
        with admitted(path).open("rb") as file:
            first = file.readline(256)
        if first.rstrip() in _HEADERS:
            return ""
        return "is not in the MSH format, whose first line is $MeshFormat; a gmsh script must be named .geo"

    def fault_inside(self, path: Path) -> str:
        """Fault of a file without elements, or that is cut off."""
        with admitted(path).open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            if content.find(b"$MeshFormat") < 0:  # version 1
                return ""
            sections = (b"$Nodes", b"$EndNodes", b"$Elements", b"$EndElements")
            missing = [name for name in sections if content.find(name) < 0]
        return f"has no {missing[0].decode()}: it is incomplete, or has no mesh" if missing else ""

    def groups(self, path: Path) -> Groups | None:
        """Groups by their names, which are text also in binary files; unnamed ones are called such as ``surface-3``."""
        with admitted(path).open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            if content[:1] != b"$" or content.find(b"$Elements") < 0:
                return None  # not MSH 2 or 4, or incomplete
            names: dict[bool, set[str]] = {False: set(), True: set()}
            end = 0
            while (begin := content.find(_BEGIN, end)) >= 0 and (end := content.find(_END, begin)) >= 0:
                for line in content[begin:end].splitlines():
                    if match := _NAME.fullmatch(line):
                        names[int(match[1]) < 2].add(match[2].decode(errors="replace"))
        return Groups(frozenset(names[False]), frozenset(names[True] - names[False]), (r"(?:surface|volume)-\d+",))
