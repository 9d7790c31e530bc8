"""Names of files of triangulated surfaces in jobs."""

from pathlib import Path

from pydantic import ValidationInfo

from hpcinv.base.files.names import is_file
from hpcinv.base.files.untrusted import applies
from hpcinv.base.quantity.schema import shown
from hpcinv.base.reading.door import REFUSED
from hpcinv.base.reading.suffix import suffix_of

FORMATS = (".stl", ".ply", ".obj", ".vtp")


def checked_surface_file(file: str, info: ValidationInfo) -> str:
    """Return the name of a file of triangles.

    Raises:
        ValueError: there is no such file, or its surface cannot be read.
    """
    path = (info.context or {}).get("directory", Path()) / file
    if suffix_of(path) not in FORMATS:
        raise ValueError(f"{shown(file)} is not a readable surface; valid suffixes are {', '.join(FORMATS)}")
    if applies(info):
        raise ValueError(f"{shown(file)} is read by VTK in this process, and is {REFUSED}")
    if not is_file(path):
        raise ValueError(f"there is no file '{path}'. Paths start from the directory of the job file")
    return file
