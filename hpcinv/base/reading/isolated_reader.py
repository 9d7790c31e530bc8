"""Program that reads one file from other people in a process of its own, since libraries crash on damaged files.

``python isolated_reader.py ACTION PATH MEMORY SECONDS`` writes to standard output a line of JSON, then the bytes of
arrays in the order of their names, types and shapes in it. A fault of the file is in the JSON: its text, advice, and
whether a package is missing. VTK's own messages are on standard error.
"""

import contextlib
import gzip
import importlib
import importlib.util
import json
import os
import resource
import shutil
import sys
import tempfile
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any, NamedTuple

_ROOT = Path(__file__).resolve().parents[2]
if "hpcinv" not in sys.modules:  # the package of the parent process, which need not be the one that is installed
    _spec = importlib.util.spec_from_file_location("hpcinv", _ROOT / "__init__.py")
    assert _spec is not None
    sys.modules["hpcinv"] = importlib.util.module_from_spec(_spec)

import numpy as np  # noqa: E402

from hpcinv.base.reading.deck_includes import FUNCTIONS  # noqa: E402
from hpcinv.base.reading.door import Refused, admit, admitted  # noqa: E402
from hpcinv.base.reading.fault import Fault, PackageMissing, shown  # noqa: E402
from hpcinv.base.reading.image_headers import check_regular, format_of  # noqa: E402
from hpcinv.base.reading.suffix import METAIMAGE, NRRD, suffix_of  # noqa: E402

_CHUNK = 1 << 22  # bytes that are unpacked at once; more memory if raised
_LIBRARIES = 1 << 30  # bytes of addresses for libraries that are loaded later; a damaged file may take them, if raised
_LONGEST = 400  # characters of a message; one of a damaged file may contain what is in it


class Limits(NamedTuple):
    """What this process may use: bytes of memory, and seconds of processor time."""

    memory: int
    seconds: int


type _Action = Callable[[Path, Limits], tuple[dict[str, Any], dict[str, Any]]]


def _reader(module: str, function: str) -> _Action:
    """Return an action that calls the function within the limits; its module is imported before."""

    def read(path: Path, limits: Limits) -> tuple[dict[str, Any], dict[str, Any]]:
        call: Callable[[Path], tuple[dict[str, Any], dict[str, Any]]]
        call = getattr(importlib.import_module(f"hpcinv.{module}"), function)
        limit(limits)
        return call(path)

    return read


def _vtu(path: Path, limits: Limits) -> tuple[dict[str, Any], dict[str, Any]]:
    import vtkmodules.vtkIOXML  # noqa: F401  (before the limit of memory)

    from hpcinv.base.reading.vtk_files import read_vtu

    limit(limits)
    return read_vtu(path)


def _vtk(path: Path, limits: Limits) -> tuple[dict[str, Any], dict[str, Any]]:
    import vtkmodules.vtkIOLegacy  # noqa: F401  (before the limit of memory)

    from hpcinv.base.reading.vtk_files import read_vtk

    limit(limits)
    return read_vtk(path)


def _surface(path: Path, limits: Limits) -> tuple[dict[str, Any], dict[str, Any]]:
    from hpcinv.base.reading.surfaces import read_surface

    limit(limits)
    return {}, read_surface(path, limits.memory)


def _image(path: Path, limits: Limits) -> tuple[dict[str, Any], dict[str, Any]]:
    from hpcinv.base.reading.voxels import checked

    limit(limits)
    form = format_of(path)
    if form in METAIMAGE + NRRD:
        from hpcinv.base.reading.voxel_files import read_voxel_file

        grid = read_voxel_file(path, limits.memory)
    elif form == ".nii":
        from hpcinv.base.reading.nifti import read_nifti

        grid = read_nifti(path, limits.memory)
    elif form == ".vti":
        from hpcinv.base.reading.vtk_files import read_vti

        grid = read_vti(_unpacked(path, limits) if suffix_of(path) == ".gz" else path)
    elif suffix_of(path) == ".dcm":
        from hpcinv.base.reading.segmentation import read_segmentation

        grid = read_segmentation(path, limits.memory)
    else:
        raise Fault("cannot be read as an image")
    grid = checked(grid)
    arrays = {name: getattr(grid, name) for name in ("spacing", "origin", "axes", "labels", "counts")}
    return {"names": dict(grid.names)}, {"numbers": grid.numbers.transpose(), **arrays}


ACTIONS: dict[str, _Action] = {
    "msh": _reader("base.reading.gmsh_mesh", "read_msh"),
    "vtu": _vtu,
    "cad": _reader("base.reading.cad_files", "read_cad"),
    "inp": _reader("base.reading.inp_files", "read_inp"),
    "inp-shells": _reader("base.reading.inp_files", "read_inp_shells"),
    "feb": _reader("base.reading.feb_files", "read_feb"),
    "bdf": _reader("base.reading.bdf_files", "read_bdf"),
    "cdb": _reader("base.reading.cdb_files", "read_cdb"),
    "vtk": _vtk,
    "image": _image,
    "surface": _surface,
    **{action: _reader("base.reading.deck_includes", function.__name__) for action, function in FUNCTIONS.items()},
}


def action_of(name: str) -> _Action:
    """Return an action: one of this program, or ``read_NAME`` in the module NAME of ``hpcinv.formats``."""
    return ACTIONS[name] if name in ACTIONS else _reader(f"formats.{name}", f"read_{name}")


def _unpacked(path: Path, limits: Limits) -> Path:
    """Unpack a file for VTK, into one that ends with this process; there must be memory and room for it."""
    file = tempfile.TemporaryFile()  # noqa: SIM115  (it stays open)
    written, most = 0, min(limits.memory, shutil.disk_usage(tempfile.gettempdir()).free)
    try:
        with gzip.open(admitted(path)) as packed:
            while part := packed.read(_CHUNK):
                written += len(part)
                if written > most:
                    text = f"is more than the {most / 1e9:.1f} GB of memory that are available"
                    raise Fault(text, "Crop the image or resample it.")
                file.write(part)
        file.flush()
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise Fault(f"cannot be read as an image: {error}", "Is the file complete?") from None
    _open_files.append(file)
    unpacked = Path(f"/proc/self/fd/{file.fileno()}")
    admit(unpacked)
    return unpacked


_open_files: list[IO[bytes]] = []


def limit(limits: Limits) -> None:
    """Limit memory, processor time and files of this process, in case of wrong sizes in a file."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    sys.dont_write_bytecode = True  # within the limit of files, Python 3.12 leaves a part, which no later run can read
    taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    for kind, most in (
        (resource.RLIMIT_AS, taken + _LIBRARIES + limits.memory),
        (resource.RLIMIT_CPU, limits.seconds),
        (resource.RLIMIT_FSIZE, limits.memory),
    ):
        _, hard = resource.getrlimit(kind)
        resource.setrlimit(kind, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def _content(action: str, path: Path, limits: Limits) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return what an action finds in a file; or what is wrong with it, as ``fault``."""
    try:
        check_regular(path)
        return action_of(action)(path, limits)
    except Refused as refused:
        name = "" if refused.path == path else f"names '{shown(str(refused.path))}', which "
        fault = [f"{name}{refused.text}", "", False]
    except Fault as found:
        fault = [shown(found.text, _LONGEST), found.advice, isinstance(found, PackageMissing)]
    except ModuleNotFoundError as error:
        fault = [f"cannot be read: {error}", "Install it by: pip install 'hpcinv[vtk]'", True]
    except OverflowError:
        fault = ["has a number of a node or element beyond 64 bits", "Is the file complete?", False]
    except MemoryError:
        text = f"reading it takes more than the {limits.memory / 1e9:.1f} GB of memory that are available"
        fault = [text, "Is the file damaged?", False]
    except Exception as error:  # libraries raise whatever damaged values cause
        text = getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
        fault = [f"cannot be read: {shown(text, _LONGEST)}", "Is the file complete?", False]
    return {"fault": fault}, {}


def main(action: str, name: str, memory: str, seconds: str) -> None:
    """Read a file, and write what is in it."""
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # libraries print there
    warnings.simplefilter("ignore")
    head, arrays = _content(action, Path(name), Limits(int(memory), int(seconds)))
    with contextlib.suppress(BrokenPipeError), output:
        arrays = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
        shapes = [(name, array.dtype.str, array.shape) for name, array in arrays.items()]
        output.write(json.dumps(head | {"arrays": shapes}).encode() + b"\n")
        for array in arrays.values():
            if array.size:
                output.write(array.data.cast("B"))


if __name__ == "__main__":
    main(*sys.argv[1:])
