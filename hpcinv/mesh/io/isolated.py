"""Files read in a separate process with limits, because libraries crash on damaged files, or never end."""

import json
import math
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from hpcinv.base.mesh_formats import action_of, check_untrusted
from hpcinv.base.parallel.children import run_child, start_child
from hpcinv.base.parallel.left_for_run import available
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.signals import ended_by_signals
from hpcinv.base.reading.reader_process import ending, fault_found, reader_command
from hpcinv.errors import MeshError, OutputError, SystemPartMissing
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.job.resolved_job import file_digest

_SECONDS = 60  # of processor time for a small file; a damaged one may take as long, if raised
_BYTES_PER_SECOND = 1e6  # that the slowest format takes at least, text; large files are refused if raised
_WAITING = 10  # time on the clock for each second of processor time; on a busy machine, files are refused if lowered

type Arrays = dict[str, npt.NDArray[Any]]

_started: dict[tuple[str, Path], subprocess.Popen[bytes]] = {}
"""processes of `reading_ahead`, by action and file"""


class _Received:
    """Output of the process: a line of JSON, and arrays."""

    def __init__(self) -> None:
        self.head: dict[str, Any] = {}
        self.arrays: Arrays = {}

    def __call__(self, output: IO[bytes]) -> None:
        try:
            self.head = json.loads(output.readline())
        except ValueError:  # it has crashed
            return
        for name, code, shape in self.head["arrays"]:
            array = np.empty(math.prod(shape), np.dtype(code))
            view, place = memoryview(array).cast("B"), 0
            while place < len(view) and (count := output.readinto(view[place:])):  # type: ignore[attr-defined]
                place += count
            if place < len(view):
                self.head = {}
                return
            self.arrays[name] = array.reshape(shape)


def read_isolated(action: str, path: Path, failure: str, advice: str) -> tuple[dict[str, Any], Arrays]:
    """Return what ``hpcinv.base.reading.isolated_reader`` finds in a file.

    Args:
        failure: what the message says of files that the process does not survive, such as "cannot be read as an image".
        advice: for them.

    Raises:
        MeshError: the file cannot be read or contradicts itself.
        SystemPartMissing: a package for this format is not installed.
    """
    received = _Received()
    done = run_isolated(action, path, received)
    if fault := fault_found(received.head, done.returncode, done.stderr, failure, advice):
        text, remedy, is_missing = fault
        if is_missing:
            raise SystemPartMissing(text, remedy)
        raise MeshError(f"{path}: {text}", remedy)
    return received.head, received.arrays


@contextmanager
def reading_ahead(mesh: MeshSpec, path: Path) -> Iterator[None]:
    """Context in which a process already reads the file of a mesh, while this one imports what will ask for it."""
    action = "image" if mesh.is_image else "surface" if mesh.is_surface else action_of(path)
    if action and action != "msh":  # which is read through a link
        with suppress(OSError, MeshError):  # `run_isolated` meets it again
            _started[action, path.absolute()] = start_child(_command(action, path)[0])
    try:
        yield
    finally:
        while _started:  # nobody has asked for it
            with _started.popitem()[1] as child:
                child.kill()


def run_isolated(action: str, path: Path, receive: _Received | None = None) -> subprocess.CompletedProcess[bytes]:
    """Run the program on a file, with captured errors, within limits of memory, time and temporary files."""
    command, seconds = _command(action, path)
    with ended_by_signals():
        started = _started.pop((action, path.absolute()), None)
        return run_child(command, receive=receive, seconds=_WAITING * seconds, started=started)


def _command(action: str, path: Path) -> tuple[list[str], int]:
    """Return the command that runs the program on a file, and its limit of processor time (s)."""
    check_untrusted(path)
    memory, seconds = available(MPI.COMM_SELF), _SECONDS
    try:
        seconds += int(path.stat().st_size / _BYTES_PER_SECOND)
    except (OSError, ValueError) as error:
        raise MeshError(f"{path}: {getattr(error, 'strerror', error)}", "Is the file readable?") from None
    return reader_command(action, path, int(memory), seconds), seconds


def check_msh(path: Path, called: Path) -> None:
    """Raise ``MeshError``, which names ``called``, for an MSH file on which gmsh crashes."""

    def check() -> None:
        if (code := run_isolated("msh", path).returncode) < 0:
            raise MeshError(f"{called}: gmsh cannot read it: {ending(code)}", "Is the file complete?")

    _check_once("msh", called, check)


def check_cad(path: Path) -> None:
    """Raise ``MeshError`` for a CAD file that gmsh cannot import."""
    _check_once("cad", path, lambda: cad_contents(path))


def cad_contents(path: Path) -> dict[str, Any]:
    """Return ``solids`` (names) and ``faces`` (names, centres and areas) of a CAD file; errors as in `check_cad`."""
    return read_isolated("cad", path, "cannot be read as CAD", "Export it again, as STEP.")[0]


def _check_once(action: str, path: Path, check: Callable[[], object]) -> None:
    """Check a file that gmsh will read, which takes as long as reading it, unless a record says that it passed.

    Records are in the cache, by the content of the file and the version of gmsh.
    """
    records, name = _records(), f"{action}_{file_digest(path)}_{version('gmsh')}"
    if records is not None and records.find(name) is not None:
        return
    check()
    if records is not None:
        records.keep(name, b"gmsh reads it")


def _records() -> Any:
    """Return the module that keeps records, ``None`` if it refuses its directory: reading a mesh needs none."""
    try:
        from hpcinv.base.parallel import code_cache
    except OutputError:
        return None
    return code_cache
