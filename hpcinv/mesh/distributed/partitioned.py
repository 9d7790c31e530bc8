"""Partitioned meshes: written and read by all ranks together; each rank has some rows of every array.

The file is a directory ``NAME.bp`` of ADIOS2 (BP4) that contains a `Header`. Cells are ordered by part, and so are
nodes and facets as far as possible.

============== ================= ======================================================
array          rows              content
============== ================= ======================================================
points         nodes             coordinates in m
node_tags      nodes             tag in the original mesh file
cells          cells             nodes, in the order of DOLFINx
cell_tags      cells             tag
cell_groups    cells             index of the physical group in the header, or -1
facets         facets            nodes
facet_groups   facets            index of the physical group in the header
data-0, …      nodes or cells    the data arrays of the header
============== ================= ======================================================
"""

import dataclasses
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hpcinv.base.files.names import check_directory_of
from hpcinv.base.mesh_formats.partitioned import HEADER, Header, describe_file, read_header
from hpcinv.base.parallel.adios import adios2
from hpcinv.base.parallel.runtime import MPI, agree, on_root
from hpcinv.base.reading.door import trusted
from hpcinv.errors import HpcinvError, MeshError, OutputError
from hpcinv.mesh.cells import FACET_KIND, no_cells
from hpcinv.mesh.distributed.partition import sort_by_tags
from hpcinv.mesh.distributed.rows import Rows, even_range
from hpcinv.mesh.io.length_unit import as_unit
from hpcinv.mesh.source import DataArray, Group, Ints, MeshSource, in_mask

type RowArray = npt.NDArray[Any]


def write_partitioned(path: Path, comm: MPI.Intracomm, source: MeshSource) -> None:
    """Write a mesh whose rows are spread over the ranks as the directory ``path``; collective.

    It is written completely or not at all. A mesh without parts is written as one part.

    Raises:
        OutputError: on every rank, if it cannot be written.
    """
    overlapping = comm.allreduce(source.groups_overlap(2) or source.groups_overlap(3), MPI.LOR)
    arrays = _arrays(source, overlapping)
    rows = {place: Rows.distributed(comm, len(array)) for _, place, array in arrays}
    header = Header(
        name=source.path.name,
        kind=source.kind,
        degree=source.degree,
        nodes=rows["nodes"].total,
        cells=rows["cells"].total,
        facets=rows["facets"].total,
        parts=source.parts or (0, rows["cells"].total),
        groups=tuple((g.name, g.dim, g.tag) for g in source.groups),
        thin_groups=source.thin_groups,
        data=tuple((a.name, a.place, a.values.shape[1]) for a in source.data.values()),
        checksums={name: rows[place].checksum(array) for name, place, array in arrays},
        files={},
        unit=source.unit or 1.0,
        overlapping=overlapping,
    )
    partial = path.with_name(f".{path.stem}.partial{path.suffix}")
    with _published(partial, path, comm, header):
        io = _io(comm)
        with adios2.Stream(io, str(partial), "w") as stream:
            stream.begin_step()
            for name, place, array in arrays:
                if len(array):
                    shape, start = [rows[place].total, *array.shape[1:]], [rows[place].first, *[0] * (array.ndim - 1)]
                    stream.write(name, np.ascontiguousarray(array), shape, start, list(array.shape))
            stream.end_step()


def read_whole(path: Path) -> MeshSource:
    """Read all parts on this process, in the order of the original file; not collective."""
    return sort_by_tags(read_partitioned(path, MPI.COMM_SELF))


def read_partitioned(path: Path, comm: MPI.Intracomm) -> MeshSource:
    """Read the rows of this rank from the mesh at ``path``; collective.

    A rank reads the cells of some parts, or an equal share of the cells if there are more ranks than parts, and equal
    shares of nodes and facets.

    Raises:
        MeshError: on every rank, if the mesh cannot be read or is damaged.
    """
    header = on_root(comm, lambda: read_header(path))
    rank, size = comm.rank, comm.size
    ranges = {
        "nodes": even_range(header.nodes, size, rank),
        "cells": cells_of(header.parts, size, rank),
        "facets": even_range(header.facets, size, rank),
    }
    arrays, error = dict[str, RowArray](), None
    try:
        arrays = _read(path, comm, header, ranges)
    except (RuntimeError, ValueError, OSError) as exc:  # ADIOS2 raises nothing narrower
        reason = (str(exc).strip().splitlines() or [type(exc).__name__])[-1]
        error = MeshError(f"{path}: cannot be read: {reason}", "Can all ranks access the file?")
    agree(comm, error)
    for name, array in arrays.items():
        if Rows.distributed(comm, len(array)).checksum(array) != header.checksums[name]:
            raise MeshError(
                f"{path}: the array '{name}' is damaged: its checksum is wrong",
                "Copy the mesh again, or partition it again.",
            )
    stored = {3: arrays["cell_groups"], 2: arrays["facet_groups"]}

    def members(i: int, dim: int) -> Ints:
        return np.flatnonzero(in_mask(stored[dim], i) if header.overlapping else stored[dim] == i)

    return MeshSource(
        path=path,
        kind=header.kind,
        degree=header.degree,
        points=arrays["points"],
        node_tags=arrays["node_tags"],
        cells=arrays["cells"],
        cell_tags=arrays["cell_tags"],
        facets=arrays["facets"],
        groups=tuple(Group(name, dim, tag, members(i, dim)) for i, (name, dim, tag) in enumerate(header.groups)),
        thin_groups=header.thin_groups,
        data={name: DataArray(name, place, arrays[f"data-{i}"]) for i, (name, place, _) in enumerate(header.data)},
        parts=header.parts,
        unit=as_unit(header.unit),
    )


def cells_of(parts: tuple[int, ...], size: int, rank: int) -> tuple[int, int]:
    """Range of the cells that one of ``size`` ranks reads: some whole parts, or an equal share."""
    if size > len(parts) - 1:
        return even_range(parts[-1], size, rank)
    first, last = even_range(len(parts) - 1, size, rank)
    return parts[first], parts[last]


def _read(
    path: Path, comm: MPI.Intracomm, header: Header, ranges: Mapping[str, tuple[int, int]]
) -> dict[str, RowArray]:
    """Rows of this rank of every array; arrays without rows are not in the file."""
    arrays = {}
    with adios2.Stream(_io(comm), str(trusted(path)), "rra") as stream:
        for name, place, none in _arrays(_blank(path, header), header.overlapping):
            (start, stop), arrays[name] = ranges[place], none
            if start < stop:
                begin, count = [start, *[0] * (none.ndim - 1)], [stop - start, *none.shape[1:]]
                arrays[name] = np.asarray(stream.read(name, begin, count)).reshape(count)
    return arrays


def _blank(path: Path, header: Header) -> MeshSource:
    """Mesh of the header without rows: its arrays have the right types and widths."""
    none: Ints = np.zeros(0, dtype=np.int64)
    cells, facets = (no_cells(kind, header.degree) for kind in (header.kind, FACET_KIND[header.kind]))
    data = {name: DataArray(name, place, np.zeros((0, components))) for name, place, components in header.data}
    groups = tuple(Group(name, dim, tag, none) for name, dim, tag in header.groups)
    return MeshSource(path, header.kind, header.degree, np.zeros((0, 3)), none, cells, none, facets, groups, data=data)


def _arrays(source: MeshSource, overlapping: bool) -> list[tuple[str, str, RowArray]]:
    """Name in the file, kind of rows (nodes, cells or facets) and rows of this rank for each array.

    Args:
        overlapping: whether groups are stored as masks, since a cell or facet is in several of them.
    """
    groups_of = source.masks if overlapping else source.labels
    return [
        ("points", "nodes", source.points),
        ("node_tags", "nodes", source.node_tags),
        ("cells", "cells", source.cells),
        ("cell_tags", "cells", source.cell_tags),
        ("cell_groups", "cells", groups_of(3)),
        ("facets", "facets", source.facets),
        ("facet_groups", "facets", groups_of(2)),
        *((f"data-{i}", array.place, array.values) for i, array in enumerate(source.data.values())),
    ]


def _io(comm: MPI.Intracomm) -> Any:
    io = adios2.Adios(comm).declare_io("mesh")
    io.set_engine("BP4")
    io.set_parameter("Profile", "Off")
    return io


@contextmanager
def _published(partial: Path, path: Path, comm: MPI.Intracomm, header: Header) -> Iterator[None]:
    """Context in which all ranks write ``partial``; it is then renamed to ``path``, or removed after an error."""
    unwritable = f"{path}: cannot be written", "Does the directory exist, and is there space?"

    def prepare() -> None:
        shutil.rmtree(partial, ignore_errors=True)
        if path.exists() and not (path / HEADER).is_file():
            raise OutputError(f"{path}: already exists, and is not a partitioned mesh", "Choose another name.")
        check_directory_of(path)

    on_root(comm, prepare)
    error: HpcinvError | None = None
    try:
        yield
    except (RuntimeError, ValueError, OSError) as exc:
        error = OutputError(f"{unwritable[0]}: {str(exc).strip().splitlines()[-1]}", unwritable[1])
    try:
        agree(comm, error)  # also a barrier: all ranks have written
    except HpcinvError:
        on_root(comm, lambda: shutil.rmtree(partial, ignore_errors=True))
        raise

    def publish() -> None:
        try:
            files = {file.name: describe_file(file) for file in partial.iterdir()}
            dataclasses.replace(header, files=files).write(partial)
            if path.exists():
                shutil.rmtree(path)
            partial.rename(path)
        except OSError as exc:
            shutil.rmtree(partial, ignore_errors=True)
            raise OutputError(f"{unwritable[0]}: {exc.strerror or exc}", unwritable[1]) from exc

    on_root(comm, publish)
