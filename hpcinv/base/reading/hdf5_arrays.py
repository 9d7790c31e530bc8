"""HDF5 files from others: arrays that are in the file itself, and faults instead of the library's errors."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hpcinv.base.reading.door import admitted
from hpcinv.base.reading.fault import Fault, shown

MOST_COMPRESSED = 1100
"""largest ratio of compression, in bytes per byte; zlib's is 1032; raised, a damaged size fills more memory"""


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Context with a file."""
    import h5py

    try:
        file = h5py.File(admitted(path), "r")
    except OSError as error:
        raise Fault(f"is not a complete HDF5 file: {shown(str(error))}", "Is the file complete?") from None
    with file:
        try:
            yield file
        except Fault:
            raise
        except (OSError, KeyError, RuntimeError, ValueError, TypeError, AttributeError) as error:
            raise Fault(f"is damaged: {shown(str(error))}", "Is the file complete?") from None


def group_in(parent: Any, name: str) -> Any:
    """Return a group of a group; links to other files are refused."""
    import h5py

    if not isinstance(parent.get(name, getlink=True) if name and name in parent else None, h5py.HardLink):
        raise Fault(f"has no group '{shown(name)}'", "Is the file complete, and of the format of its suffix?")
    if not isinstance(parent[name], h5py.Group):
        raise Fault(f"'{shown(name)}' is not a group", "Is the file complete?")
    return parent[name]


def array_in(parent: Any, name: str) -> Any:
    """Return an array of a group."""
    import h5py

    if not isinstance(parent.get(name, getlink=True) if name in parent else None, h5py.HardLink):
        raise Fault(f"has no array '{shown(name)}'", "Is the file complete, and of the format of its suffix?")
    data = parent[name]
    if not isinstance(data, h5py.Dataset) or data.external or data.is_virtual:
        raise Fault(f"'{shown(name)}' is not an array in the file", "Save the mesh in one file.")
    if data.size is None or data.size * data.dtype.itemsize > MOST_COMPRESSED * Path(data.file.filename).stat().st_size:
        raise Fault(f"array '{shown(name)}' has {data.size} values in so small a file", "Is the file complete?")
    return data[()]
