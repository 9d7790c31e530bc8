"""Files of a summary: ``summary.json``, and ``summary.h5`` with the same content."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hpcinv.files.atomic import output_errors, replace
from hpcinv.parallel.runtime import on_root

if TYPE_CHECKING:
    import h5py
    from mpi4py.MPI import Intracomm


def write_summary(
    directory: Path, statistics: Mapping[str, Any], comm: Intracomm, *, formats: Sequence[str] = ("json", "h5")
) -> None:
    """Write a summary on rank 0, as a file in each format, which appears whole or not at all; collective.

    Raises:
        OutputError: on every rank, if it cannot be written.
    """

    def on_rank_0() -> None:
        for form in formats:
            path = directory / f"summary.{form}"
            with output_errors(path, "Is the directory there, and space?"):
                replace(path, CONTENTS[form](statistics))

    on_root(comm, on_rank_0)


def _as_json(statistics: Mapping[str, Any]) -> bytes:
    return (json.dumps(statistics, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def _as_hdf5(statistics: Mapping[str, Any]) -> bytes:
    import h5py  # on rank 0 alone

    # In memory, since on a full disk h5py raises no OSError and leaves a file that cannot be closed.
    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        _fill(file, statistics)
    return content.getvalue()


CONTENTS: Mapping[str, Callable[[Mapping[str, Any]], bytes]] = {"json": _as_json, "h5": _as_hdf5}


def _fill(group: h5py.Group, content: Mapping[str, Any]) -> None:
    """Write a mapping to an HDF5 group.

    Mappings become groups, single values attributes (``None`` an empty one), lists of numbers datasets. Lists of
    mappings become a table where these have the same numbers, else groups 0, 1, …; any other list is JSON text.
    """
    import h5py

    for key, value in content.items():
        name = key.replace("/", "|")  # HDF5 reads it as a path
        if isinstance(value, Mapping):
            _fill(group.create_group(name), value)
        elif value is None:
            group.attrs[name] = h5py.Empty("f8")
        elif not isinstance(value, list):
            group.attrs[name] = value
        elif value and all(isinstance(v, Mapping) for v in value):
            table = _table(value)
            if table is None:
                _fill(group.create_group(name), {str(i): v for i, v in enumerate(value)})
            else:
                group[name] = table
        elif all(_is_number(v) for v in value):
            group[name] = np.array(value)
        else:
            group.attrs[name] = json.dumps(value, ensure_ascii=False)


def _table(rows: Sequence[Mapping[str, Any]]) -> np.ndarray | None:
    """Return rows with the same numbers and flags as a structured array; ``None`` if that is not possible."""
    columns = rows[0].keys()
    if any(row.keys() != columns or not all(_is_number(v) or v is None for v in row.values()) for row in rows):
        return None
    kinds = {c: "?" if all(isinstance(row[c], bool) for row in rows) else "f8" for c in columns}
    blank = {c: np.nan if kind == "f8" else False for c, kind in kinds.items()}
    return np.array(
        [tuple(blank[c] if row[c] is None else row[c] for c in columns) for row in rows], dtype=list(kinds.items())
    )


def _is_number(value: object) -> bool:
    return isinstance(value, bool | int | float)
