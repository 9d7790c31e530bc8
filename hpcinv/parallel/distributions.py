"""Installed distributions, from listings of directories: `importlib.metadata` parses the metadata of each of them."""

import os
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path


def metadata_directories() -> Iterator[Path]:
    """Yield the metadata of distributions in the directories of ``sys.path``, files or directories."""
    for place in dict.fromkeys(sys.path):
        with suppress(OSError), os.scandir(place or ".") as entries:
            yield from (Path(entry) for entry in entries if entry.name.endswith((".dist-info", ".egg-info")))


def installed_names() -> set[str]:
    """Return the names of these distributions, in lower case with ``_`` for other separators."""
    names = (path.name.rpartition(".")[0].partition("-")[0] for path in metadata_directories())
    return {name.lower().replace(".", "_") for name in names}


def may_have_entry_points(group: str) -> bool:
    """Return whether a distribution may have entry points of a group; archives on the path are not opened."""
    header = f"[{group}]"
    if any(map(os.path.isfile, sys.path)):
        return True
    for path in metadata_directories():
        with suppress(OSError):
            if header in (path / "entry_points.txt").read_text(errors="replace"):
                return True
    return False
