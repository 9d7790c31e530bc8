"""Formats of mesh files: one file each, registered by subclassing `MeshFormat`; formats of other programs plug in.

They are the modules in the folder of `hpcinv.formats`, if there is one.
"""

from importlib.util import find_spec
from pathlib import Path

from hpcinv.base.files.untrusted import image_fault
from hpcinv.base.quantity.schema import import_modules
from hpcinv.base.reading.door import REFUSED, is_asked, path_fault
from hpcinv.base.reading.fault import Fault
from hpcinv.base.reading.mesh_format import MeshFormat
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.errors import MeshError

_FOLDER = "hpcinv.formats"
import_modules(__name__, __path__)
if _plugged_in := find_spec(_FOLDER):
    import_modules(_FOLDER, _plugged_in.submodule_search_locations or ())

_KINDS = sorted(MeshFormat.__subclasses__(), key=lambda kind: kind.__module__.rpartition(".")[2])
FORMATS = {suffix: kind() for kind in _KINDS for suffix in (kind.suffix, *kind.other_suffixes)}
"""formats by suffix"""
SAVED = tuple(sorted(suffix[1:] for suffix, kind in FORMATS.items() if kind.saver or kind.is_partitioned))
"""names of the formats that are written"""
MESHES = tuple(suffix for suffix, kind in sorted(FORMATS.items()) if kind.saver)
"""suffixes of formats that one process writes"""


def action_of(path: Path) -> str:
    """Return the action of ``hpcinv.base.reading.isolated_reader`` that reads a mesh file; empty if it has none."""
    return FORMATS[suffix_of(path)].action if suffix_of(path) in FORMATS else ""


def mesh_fault(directory: Path, file: str) -> str:
    """Fault of the mesh of an untrusted job in ``directory``; empty text if there is none."""
    path = directory / file
    if suffix_of(path) in (".py", ".geo"):
        return f"is a program that a run executes, and is {REFUSED}; ask for its mesh (.msh, .vtu)"
    mesh_format = FORMATS.get(suffix_of(path))
    if mesh_format and (fault := mesh_format.untrusted()):
        return fault
    if (fault := path_fault(directory, file)) or not path.is_file():
        return fault
    try:
        files = mesh_format.data_files(path, isolated=True) if mesh_format else []
    except Fault as damage:
        return f"{damage.text}, and is {REFUSED}; convert it to .msh or .vtu"
    for data in files:
        if fault := path_fault(path.parent, data):
            return f"has data in '{data}', which {fault}"
    return image_fault(path)


def check_untrusted(path: Path) -> None:
    """Raise ``MeshError`` if a file must not be read because of ``--untrusted``."""
    if is_asked() and (fault := mesh_fault(path.resolve().parent, path.resolve().name)):
        raise MeshError(f"{path}: {fault}")


__all__ = ["FORMATS", "MESHES", "SAVED", "MeshFormat", "action_of", "check_untrusted", "mesh_fault"]
