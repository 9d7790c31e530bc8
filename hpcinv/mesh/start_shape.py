"""Nodes of a body in a shape that is roughly known, from a mesh file with the same cells."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from hpcinv.base.files.names import exists
from hpcinv.base.parallel.runtime import on_root
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.errors import MeshError
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.mesh.body import Body, local_node_values, read_mesh_file
from hpcinv.mesh.kind_source import source_of
from hpcinv.mesh.readers import FILES
from hpcinv.mesh.refine.degree import change_degree
from hpcinv.mesh.source import Floats, MeshSource


def start_nodes(spec: MeshSpec, path: Path, body: Body) -> Floats:
    """Return the local geometry nodes (n, 3) of a body in m, in the shape of a mesh file; collective.

    The file of a shell has its surface. The thickness is the given body's, along the normals of that surface.

    Raises:
        MeshError: on all ranks, if the file is not a mesh with the cells of the body.
    """
    points = np.empty((0, 3))

    def read_on_root() -> None:
        nonlocal points
        points = _points(spec, path, body.source)

    on_root(body.mesh.comm, read_on_root)
    return local_node_values(body, points)


def _points(spec: MeshSpec, path: Path, given: MeshSource) -> Floats:
    """Return the nodes (n, 3) of a source in the shape of a file, in m."""
    if suffix_of(path) not in FILES:
        raise MeshError(f"{path}: solver.start_shape must be a mesh file ({', '.join(FILES)})", "Give its shape file.")
    if not exists(path):
        raise MeshError(f"{path}: no such file", "solver.start_shape is relative to the job file.")
    try:
        shape = read_mesh_file(spec.model_copy(update={"array_labels": None}), path)
    except OSError as exc:
        raise MeshError(f"{path}: {exc.strerror or exc}", "Is the file readable?") from exc
    shape = shape.drop_unused_nodes()
    if spec.geometry_degree is not None:
        shape = change_degree(shape, spec.geometry_degree)
    if not _has_same_cells(shape, given.in_file):
        raise MeshError(
            f"{path}: the cells of solver.start_shape are not the cells of {given.path}",
            "Move the nodes of that mesh, and keep their numbers and the order of the cells.",
        )
    shape = dataclasses.replace(given.in_file, path=path, points=shape.points)
    return source_of(given.body_kind).moved(given, shape)


def _has_same_cells(shape: MeshSource, other: MeshSource) -> bool:
    """Return whether cells have the same nodes; cells of a shell may be numbered from another side."""
    return (
        shape.kind == other.kind
        and len(shape.points) == len(other.points)
        and shape.cells.shape == other.cells.shape
        and bool((np.sort(shape.cells, axis=1) == np.sort(other.cells, axis=1)).all())
    )
