"""Whether a file is a mesh in gmsh's MSH format, which has to be known before gmsh sees it.

gmsh decides by the first bytes of a file what it is, and executes what it does not know as a script, whose commands can
start programs. It takes no other header after white space.
"""

from __future__ import annotations

from pathlib import Path

SUFFIX = ".msh"
_HEADERS = (b"$MeshFormat", b"$Comments", b"$NOD")
"""First lines of MSH 2 and 4, of the same with a comment first, and of MSH 1."""


def fault_of(path: Path) -> str:
    """What is wrong with the first line of a ``.msh`` file; empty if nothing is.

    Raises:
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        first = file.readline(256)
    if first.rstrip() in _HEADERS:
        return ""
    return "is no mesh in the MSH format, whose first line is $MeshFormat; a gmsh script must be named .geo"
