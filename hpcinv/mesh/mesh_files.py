"""Mesh files of a body at other coordinates, with the topology, tags, groups and data of its source."""

import dataclasses
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType

import numpy as np

from hpcinv.base.files.atomic import take_permissions
from hpcinv.base.mesh_formats import FORMATS
from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.base.reading.mesh_format import loaded
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.errors import OutputError
from hpcinv.mesh.body import Body, reorder_to_source, source_node_values, values_on_cells
from hpcinv.mesh.distributed.rows import Rows
from hpcinv.mesh.kind_source import source_of
from hpcinv.mesh.source import DataArray, Floats, MeshSource
from hpcinv.on_demand import on_demand


def _load_and_save(saver: str, path: Path, source: MeshSource, points: Floats) -> None:
    loaded(saver)(path, source, points)


SAVERS: dict[str, Callable[[Path, MeshSource, Floats], None]] = {
    suffix: partial(_load_and_save, kind.saver) for suffix, kind in FORMATS.items() if kind.saver
}


def write_mesh(
    path: Path, body: Body, coordinates: Floats, more: Mapping[str, DataArray] = MappingProxyType({})
) -> None:
    """Write the body at ``coordinates`` (m) of its local geometry nodes, in the format of the suffix; collective.

    Node order, node and cell tags, physical groups and data arrays are as in the source, where ``more`` has no array of
    the same name; the file is written completely or not at all. A ``.bp`` is written by all ranks, in metres. Other
    formats are written by rank 0, in the length unit of the source's file, and not from a partitioned mesh. Of a shell
    they have the midsurface, with thickness and director as data (`surface_source`).

    Args:
        more: further data arrays at the local geometry nodes or in the local cells, by name; of a shell those on both
            faces, or in the first layer, are written.

    Raises:
        OutputError: on every rank, if it cannot be written; an `UnstorableMesh` if its format cannot hold the mesh.
    """
    points, comm = reorder_to_source(body, coordinates), body.mesh.comm
    arrays = {name: _in_source_order(body, array) for name, array in more.items()}
    source = body.source
    if FORMATS[suffix_of(path)].is_partitioned:
        whole = dataclasses.replace(source, data={**source.data, **arrays}, points=points)
        on_demand("file of a partitioned mesh")(path, comm, whole)
    else:
        assert not source.is_partitioned
        on_root(comm, lambda: save_body(path, source, points, arrays))


def _in_source_order(body: Body, array: DataArray) -> DataArray:
    """Return local values at the nodes or in the cells of this rank's source; collective."""
    if array.place == "nodes":
        return dataclasses.replace(array, values=reorder_to_source(body, array.values))
    topology = body.mesh.topology
    owned = topology.index_map(3).size_local
    rows = Rows.distributed(body.mesh.comm, len(body.source.cells))
    values = rows.deliver(array.values[:owned], np.asarray(topology.original_cell_index)[:owned])
    return dataclasses.replace(array, values=values)


def left_out(path: Path, body: Body, coordinates: Floats) -> float:
    """Return the largest distance (m) between the body and a file that `write_mesh` makes of it; collective.

    It is more than zero where the file has fewer nodes than the body: straight cells of the source whose displacement
    has a higher degree, or elements of 20 nodes. The thickness of a shell is not compared.
    """
    source = body.source
    has_20 = has_20_nodes(path, source)
    if source.midsurface or (body.degree == source.degree and not has_20):
        return 0.0
    saved = source_node_values(body, coordinates)
    if has_20:
        saved = on_demand("nodes of cells of 20 nodes")(source.kind, body.source_geometry.dofmaps[0], saved)
    distances = np.linalg.norm(values_on_cells(body, saved) - coordinates, axis=1)
    return float(body.mesh.comm.allreduce(float(distances.max(initial=0.0)), op=MPI.MAX))


def has_20_nodes(path: Path, source: MeshSource) -> bool:
    """Return whether a file has hexahedra of 20 nodes instead of 27."""
    saves_27 = FORMATS[suffix_of(path)].saves_27_nodes
    is_left_out = saves_27 == "never" or (saves_27 == "if read" and source.nodes_per_cell != 27)
    return is_left_out and (source.kind, source.degree) == ("hexahedron", 2)


def save_body(
    path: Path, source: MeshSource, points: Floats, more: Mapping[str, DataArray] = MappingProxyType({})
) -> None:
    """Write a whole body at ``points`` (n, 3) m with more data, of a shell its midsurface; as `save`."""
    save(path, *source_of(source.body_kind).saved(source, points, more))


def save(path: Path, source: MeshSource, points: Floats) -> None:
    """Write a whole mesh at ``points`` (n, 3) m in the format of the suffix, completely or not at all.

    The coordinates in the file are in ``source.unit``, which the file states.

    Raises:
        OutputError: it cannot be written; an `UnstorableMesh` if its format cannot hold the mesh.
    """
    unfinished = path.with_name(f".{path.stem}.partial{path.suffix}")
    try:
        SAVERS[suffix_of(path)](unfinished, source, points / (source.unit or 1.0))
        take_permissions(unfinished, path)
        unfinished.replace(path)
    except OSError as exc:
        unfinished.unlink(missing_ok=True)
        raise OutputError(f"{path}: cannot be written: {exc}", "Does the directory exist, and is there space?") from exc
    except Exception as exc:  # gmsh and VTK raise nothing narrower
        unfinished.unlink(missing_ok=True)
        raise UnstorableMesh(f"{path}: cannot be written: {exc}", "Choose other formats by output.mesh.") from exc


class UnstorableMesh(OutputError):
    """A format cannot hold a mesh, such as the names of its regions; other files can still be written."""
