"""What an input file says with the files that it includes, as data of JSON.

Each function follows the includes. With ``--untrusted``, `hpcinv.formats.readers.followed_includes` calls it in a child
process.
"""

from pathlib import Path
from typing import Any

from hpcinv.base.reading.abaqus_keywords import keywords
from hpcinv.base.reading.fault import Fault
from hpcinv.base.reading.included_files import included_by, lines_of

LONGEST_TEXT = 200_000_000
"""Largest deck (bytes) whose text is kept; raised, a damaged or hostile file can fill more memory."""
_LARGEST = 200 * 2**20
"""bytes of a file that is searched for names; raised, ``validate`` may take seconds"""
_NAMED = ("NODE", "ELEMENT", "NSET", "ELSET", "SURFACE")
"""keywords that name sets and surfaces"""

type Answer = tuple[dict[str, Any], dict[str, Any]]


def inp_files(path: Path) -> Answer:
    """Return the names of the files that an ``.inp`` includes, as ``files``, and whether that is all: ``is_whole``."""
    files, is_whole = included_by(path)
    return {"files": files, "is_whole": is_whole}, {}


def bdf_files(path: Path) -> Answer:
    """Return the same as `inp_files` of a ``.bdf``."""
    from hpcinv.base.reading.bdf_files import lines_of

    files, is_whole = included_by(path, lines_of)
    return {"files": files, "is_whole": is_whole}, {}


def inp_names(path: Path) -> Answer:
    """Return the names of sets and surfaces, as ``names``.

    They are ``None`` if the file cannot be read, is large, or is an assembly, whose sets belong to instances.
    """
    if path.stat().st_size > _LARGEST:
        return {"names": None}, {}
    try:
        found = list(keywords(line for line in lines_of(path, _LARGEST) if line.text.startswith("*")))
    except Fault:  # reported by the reader
        return {"names": None}, {}
    if any(keyword.name == "INSTANCE" for keyword in found):
        return {"names": None}, {}
    options = [keyword.options for keyword in found if keyword.name in _NAMED]
    return {"names": [named[key] for named in options for key in ("NSET", "ELSET", "NAME") if key in named]}, {}


def inp_text(path: Path) -> Answer:
    """Return the lines that are neither empty nor comments, as ``text``; raises ``Fault``."""
    return {"text": "\n".join(line.text for line in lines_of(path, LONGEST_TEXT))}, {}


FUNCTIONS = {"inp-files": inp_files, "bdf-files": bdf_files, "inp-names": inp_names, "inp-text": inp_text}
"""the functions by the actions of ``isolated_reader``"""
