"""Files that gmsh reads while it runs a generator: CAD models, meshes, and further scripts."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hpcinv.base.files.inputs import note_input
from hpcinv.base.reading.door import admitted
from hpcinv.base.reading.suffix import suffix_of

_READERS = (("open",), ("merge",), ("model", "occ", "importShapes"), ("parser", "parse"))
"""gmsh's functions whose first argument is a file that they read"""
_NAMED = re.compile(r'\b(?:Merge|MergeWithBoundingBox|Include|ShapeFromFile)\b\s*\(?\s*"([^"\n]+)"')
_COMMENT = re.compile(r"//[^\n]*|/\*.*?\*/", re.DOTALL)
_SCRIPTS = (".geo", ".geo_unrolled", ".pro")


@contextmanager
def noted_files(gmsh: Any) -> Iterator[None]:
    """Context in which gmsh's functions note the files that they read (`hpcinv.base.files.inputs.note_input`)."""
    originals: list[tuple[Any, str, Callable[..., Any]]] = []
    try:
        for *path, name in _READERS:
            owner = gmsh
            for part in path:
                owner = getattr(owner, part)
            function = getattr(owner, name)
            originals.append((owner, name, function))
            setattr(owner, name, _noting(function))
        yield
    finally:
        for owner, name, function in originals:
            setattr(owner, name, function)


def _noting(function: Callable[..., Any]) -> Callable[..., Any]:
    def noting(*arguments: Any, **named: Any) -> Any:
        file = arguments[0] if arguments else named.get("fileName")
        if isinstance(file, str):
            note_script(Path(file).absolute())
        return function(*arguments, **named)

    return noting


def note_script(path: Path) -> None:
    """Note a file and, if it is a script of gmsh, the files that it names; names that it computes are not seen."""
    pending, known = [path], set[Path]()
    while pending:
        file = pending.pop()
        if file in known or not file.is_file():
            continue
        known.add(file)
        note_input(file)
        if suffix_of(file) in _SCRIPTS:
            text = _COMMENT.sub("", admitted(file).read_text(encoding="utf-8", errors="replace"))
            pending += [file.parent / name for name in _NAMED.findall(text)]
