"""Check that a file is a mesh in gmsh's MSH format, before gmsh opens it.

gmsh recognizes the format by the first bytes of a file, and executes other files as scripts, which can start programs.
"""

from pathlib import Path

SUFFIX = ".msh"
_HEADERS = (b"$MeshFormat", b"$Comments", b"$NOD")
"""First lines of MSH 2 and 4, the same after a comment, and MSH 1."""


def fault_of(path: Path) -> str:
    """Fault of the first line of a ``.msh`` file; empty text if it is valid.

    Raises:
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        first = file.readline(256)
    if first.rstrip() in _HEADERS:
        return ""
    return "is not in the MSH format, whose first line is $MeshFormat; a gmsh script must be named .geo"
