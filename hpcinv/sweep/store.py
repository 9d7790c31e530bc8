"""The directory that sweeps share: ``store.json``, ``ledger/``, ``holders/``, and ``cases/`` with what runs leave."""

from __future__ import annotations

import json
from pathlib import Path

from hpcinv.errors import OutputError
from hpcinv.filenames import check_output
from hpcinv.sweep.exclusive import make_directory, publish, told

_FORMAT = "hpcinv store 1"


def open_store(path: Path) -> None:
    """Make a store, or check that it is one; any number of processes may do so at once.

    Raises:
        OutputError: it cannot be written, holds other things, or has another format.
    """
    mark = path / "store.json"
    check_output(path)
    with told(path):
        path.mkdir(parents=True, exist_ok=True)
        if not mark.exists():
            others = [entry.name for entry in path.iterdir() if not entry.name.startswith(".")]
            if others and mark.name not in others:
                raise OutputError(f"{path}: holds files that are not of a store", "Choose another 'store'.")
            publish(mark, json.dumps({"format": _FORMAT}).encode())
        try:
            found = json.loads(mark.read_bytes())["format"]
        except (ValueError, KeyError, TypeError):
            found = "not told"
        if found != _FORMAT:
            raise OutputError(f"{mark}: the format is {found}, not {_FORMAT}", "Choose another 'store'.")
        for directory in (records_in(path), heartbeats_in(path)):
            make_directory(directory)


def records_in(store: Path) -> Path:
    return store / "ledger"


def heartbeats_in(store: Path) -> Path:
    return store / "holders"


def runs_in(store: Path) -> Path:
    return store / "cases"
