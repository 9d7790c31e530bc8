"""What is in a job's mesh, image and surface files, for ``hpcinv validate``: without DOLFINx, NumPy and VTK here.

Files are read as for a run, by ``hpcinv.base.reading.isolated_reader`` in a process of its own. A fault is certain: a
run would stop at it. A larger file is left to the run.
"""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from hpcinv.base import reading
from hpcinv.base.mesh_formats import FORMATS, action_of
from hpcinv.base.reading.mesh_format import OF_NODES, Groups
from hpcinv.base.reading.reader_process import fault_found
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.job.mesh_file import IMAGES, SURFACES, MeshFile

LARGEST = 20 * 10**6
"""bytes of a file that is read; raised, ``validate`` may take more than a second or two"""
_SECONDS = 10
"""of processor time for a file, after which it is left to the run"""
_MEMORY = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
"""bytes for a file: a run does not have more"""
_PROGRAM = Path(reading.__file__).with_name("isolated_reader.py")
_SETS = ("cells", "faces", "facets", "skin", "nodes")
_SURFACES = ("faces:", "facets:", "skin:")
_REGION = "region:"
_COMPLETE = {kind.action for kind in FORMATS.values() if kind.elements}
"""actions whose sets are all regions of a mesh"""


@dataclass(frozen=True)
class Contents:
    """Contents of a file.

    Attributes:
        fault: what is wrong with it, which follows its name; empty if nothing was found.
        groups: names of its regions; ``None`` if they are not known.
        is_read: false if it is too large, or a package is missing.
    """

    fault: str = ""
    groups: Groups | None = None
    is_read: bool = True


def contents_of(spec: MeshFile, file: str, path: Path) -> Contents:
    """Return what is in a file that a mesh section names, as far as the file has a reader."""
    try:
        if path.is_file() and path.stat().st_size > LARGEST:
            return Contents(is_read=False)
        action = _action(spec, file)
        if action == "msh" or not action:  # gmsh reports nothing that the text does not show
            mesh_format = FORMATS.get(suffix_of(file))
            return Contents(mesh_format.fault_inside(path) if mesh_format else "")
        return _read(action, path)
    except OSError as error:
        return Contents(f"cannot be read: {error.strerror}")


def _action(spec: MeshFile, file: str) -> str:
    """Return the action that reads a file; empty if none does."""
    suffix, is_mesh = suffix_of(file), action_of(Path(file)) and not spec.is_surface
    if suffix in IMAGES:
        return "image"
    if suffix in SURFACES and not (is_mesh and file == spec.file):
        return "surface"
    return spec.kind.actions.get(suffix) or action_of(Path(file))


def _read(action: str, path: Path) -> Contents:
    command = [sys.executable, "-P", str(_PROGRAM), action, str(path.absolute()), str(_MEMORY), str(_SECONDS)]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, stdin=subprocess.DEVNULL, env=environment, check=False)
    try:
        head = json.loads(done.stdout.partition(b"\n")[0])
    except ValueError:
        head = {}
    if done.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        return Contents(is_read=False)
    fault = fault_found(head, done.returncode, done.stderr, "cannot be read", "Is the file complete?")
    if fault:
        text, advice, is_missing = fault
        return Contents(is_read=False) if is_missing else Contents(f"{text.rstrip('.')}. {advice}")
    if action in ("vtu", "vtk"):
        return _grid({name: code for name, code, _ in head["arrays"]})
    return Contents(groups=_groups([name for name, _, _ in head["arrays"]]) if action in _COMPLETE else None)


def _grid(codes: Mapping[str, str]) -> Contents:
    """Return the contents of a grid of VTK, by the codes of the types of its arrays."""
    fault = "" if "types" in codes else "has no unstructured grid with cells"
    sets = [name.removeprefix(f"cells:{_REGION}") for name in codes if name.startswith(f"cells:{_REGION}")]
    whole = [name.partition(":")[2] for name, code in codes.items() if code[1] in "iu" and ":" in name]
    kept = tuple(name for name in whole if name not in ("node_tag", "cell_tag") and not name.startswith(_REGION))
    return Contents(fault, Groups(frozenset(sets), arrays=kept))


def _groups(arrays: Sequence[str]) -> Groups:
    """Return the regions of a mesh by the names of its arrays."""
    sets = [name for place, separator, name in (key.partition(":") for key in arrays) if separator and place in _SETS]
    surfaces = {key.partition(":")[2] for key in arrays if key.startswith(_SURFACES)}
    return Groups(frozenset([*sets, *(f"{name}{OF_NODES}" for name in surfaces if f"nodes:{name}" in arrays)]))
