"""Fibres in files of shapes and fields are directions of the body in the file, and belong to its nodes and cells."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import pyvista
from helpers.mesh_cases import spec
from helpers.solutions import made_up

from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.job.fibres import FibreFamily
from hpcinv.mesh import Body, build_body, read_source, write_mesh
from hpcinv.output.vtk import write_fields
from hpcinv.results.cell_fields import shape_directions
from hpcinv.results.cell_middles import unit_vectors

SHEAR = np.array([[0.1, 0.7, 0.0], [0.0, -0.2, 0.3], [0.0, 0.0, 0.2]])
"""displacement gradient of a homogeneous deformation, by the position in the mesh"""
FAMILIES = {
    "cells": FibreFamily.model_validate({"data": "axis", "given_on": "current"}),
    "nodes": FibreFamily.model_validate({"data": "line", "given_on": "reference"}),
    "formula": FibreFamily.model_validate({"direction": ["1", "x", "0"], "given_on": "current"}),
}


def write_block(path: Path) -> None:
    """A block of tetrahedra whose numbers are not in order, with directions of any length and labels of its sides."""
    block = pyvista.ImageData(dimensions=(3, 2, 2)).to_tetrahedra(5)
    block.cell_data.clear()
    sides = block.extract_surface(algorithm="dataset_surface")
    solids, triangles = block.n_cells, sides.faces.reshape(-1, 4).copy()
    triangles[:, 1:] = sides.point_data["vtkOriginalPointIds"][triangles[:, 1:]]
    cells = np.concatenate([block.cells, triangles.ravel()])
    mesh = pyvista.UnstructuredGrid(cells, [10] * solids + [5] * len(triangles), block.points)
    x = mesh.cell_centers().points
    mesh.cell_data["axis"] = np.stack([2 + x[:, 0], x[:, 1], 0 * x[:, 2]], axis=1)
    mesh.cell_data["tag"] = np.where(np.arange(len(x)) < solids, 7, 3 + (x[:, 0] < 1e-9)).astype(np.int32)
    mesh.cell_data["cell_tag"] = 900 - np.arange(len(x))
    y = mesh.points
    mesh.point_data["line"] = np.stack([1 + y[:, 2], y[:, 0], np.ones(len(y))], axis=1)
    mesh.point_data["node_tag"] = 500 - 3 * np.arange(len(y))
    mesh.save(path)


def block_of(comm: MPI.Intracomm, directory: Path) -> Body:
    path = directory / "block.vtu"
    on_root(comm, lambda: write_block(path))
    return build_body(spec(path), {}, comm)


@pytest.mark.everyday("later state")
@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("case", ["inverse", "forward", "later state"])
def test_directions_in_shape_files_are_of_the_computed_body(
    case: str, comm: MPI.Intracomm, run_directory: Path
) -> None:
    """F is I + h forward, (I - h)^-1 inverse; a later state has the given one as second displacement."""
    body = block_of(comm, run_directory)
    direction = "inverse" if case == "inverse" else "forward"
    solution = made_up(body, direction, lambda x: x @ SHEAR.T, degree=1)
    given = np.eye(3)
    if case == "later state":
        earlier = made_up(body, "forward", lambda x: 0.5 * x @ SHEAR.T, degree=1)
        solution = made_up(body, "forward", lambda x: x @ SHEAR.T, degree=1, given_displacement=earlier.displacement)
        given = np.linalg.inv(np.eye(3) + 0.5 * SHEAR)
    path = run_directory / "shape.vtu"
    write_mesh(path, body, solution.other_nodes, shape_directions(body, FAMILIES, solution))
    if comm.rank > 0:
        return
    shape, source = read_source(spec(path), path), body.source
    F = np.eye(3) + SHEAR
    from_current = F @ given if case == "later state" else np.eye(3) if direction == "forward" else np.eye(3) - SHEAR
    from_reference = F if direction == "forward" else np.eye(3)
    middles = source.points[source.cells].mean(axis=1)
    x = middles @ {"inverse": np.eye(3), "forward": F, "later state": np.eye(3) + 0.5 * SHEAR}[case].T
    formula = np.stack([np.ones(len(x)), x[:, 0], 0 * x[:, 0]], axis=1)
    for name, directions, turn in (
        ("axis", source.data["axis"].values, from_current),
        ("line", source.data["line"].values, from_reference),
        ("formula", formula, from_current),
    ):
        assert shape.data[name].place == ("nodes" if name == "line" else "cells")
        assert np.allclose(shape.data[name].values, unit_vectors(directions @ turn.T), rtol=0, atol=1e-12)
    assert np.array_equal(shape.cell_tags, source.cell_tags)


def test_integer_labels_of_surface_cells_come_back(comm: MPI.Intracomm, tmp_path: Path) -> None:
    """In a run with regions of these labels, whose shape file then has groups, and without."""
    labels = {"array": "tag", "names": {"left": 4, "muscle": 7}}
    path, shape_path = tmp_path / "block.vtu", tmp_path / "shape.vtu"
    write_block(path)
    given = pyvista.read(path)
    for settings in ({}, {"labels": labels}, {"labels": labels, "geometry_degree": 2}):
        body = build_body(spec(path, **settings), {}, comm)
        write_mesh(shape_path, body, 2 * body.given_nodes)
        shape = pyvista.read(shape_path)
        assert shape.cell_data["tag"].dtype.kind == "i"
        for grid in (given, shape):
            grid.cell_data["middle"] = np.array([cell.points[:3].mean(axis=0) for cell in grid.cell])
        scale = {id(given): 2.0, id(shape): 1.0}
        first, second = (
            sorted(zip((g.cell_data["middle"] * scale[id(g)]).round(9).tolist(), g.cell_data["tag"], strict=True))
            for g in (given, shape)
        )
        assert [tag for _, tag in first] == [tag for _, tag in second]
    again = build_body(spec(shape_path, labels=labels), {}, comm)
    counts = {name: (again.regions[name].facet_count, again.regions[name].cell_count) for name in body.regions}
    assert counts == {name: (r.facet_count, r.cell_count) for name, r in body.regions.items()}
    assert counts["left"] == (2, 0)


@pytest.mark.parallel([2])
def test_fields_have_the_numbers_of_the_file(comm: MPI.Intracomm, run_directory: Path) -> None:
    body = block_of(comm, run_directory)
    write_fields(run_directory / "fields", body, [made_up(body, "inverse", lambda x: 0 * x)])
    if comm.rank > 0:
        return
    fields, source = pyvista.read(run_directory / "fields" / "deformed.vtu"), body.source
    numbered = dict(zip(source.node_tags.tolist(), source.points, strict=True))
    tags = fields.point_data["node_tag"]
    assert np.count_nonzero(tags) == len(source.points) < len(tags)  # the displacement has nodes in the middle of edges
    for tag, point in zip(tags, fields.points, strict=True):
        assert tag == 0 or np.allclose(point, numbered[tag], atol=1e-9)
    middles = dict(zip(source.cell_tags.tolist(), source.points[source.cells].mean(axis=1), strict=True))
    for tag, cell in zip(fields.cell_data["cell_tag"], fields.cell, strict=True):
        assert np.allclose(cell.points[:4].mean(axis=0), middles[tag], atol=1e-9)
