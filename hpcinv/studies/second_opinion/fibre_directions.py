"""Directions of fibres on the rest body: where they are the same everywhere, and in each cell."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from hpcinv.base.quantity.spatial_fields import POSITIONS, ByData, ByRule
from hpcinv.errors import OutputError
from hpcinv.job.fibres import FibreFamily
from hpcinv.job.job import Job
from hpcinv.mesh.cells import scalar_element
from hpcinv.mesh.source import DataArray, Floats, MeshSource


def constant_directions(families: Mapping[str, FibreFamily]) -> Iterator[tuple[str, Floats]]:
    """Yield name and unit vector (3,) of families whose direction does not vary over the rest body."""
    for name, family in families.items():
        formulas = family.direction
        if formulas is None or family.given_on != "reference" or any(f.names & POSITIONS.keys() for f in formulas):
            continue
        vector = np.array([float(f.evaluate(**{n: family.constants[n] for n in f.names})) for f in formulas])
        yield name, vector / np.linalg.norm(vector)


def directions_in_cells(job: Job, rest: MeshSource, loaded: MeshSource) -> Iterator[tuple[str, Floats]]:
    """Yield name and unit vectors of each family on the rest body.

    They are at the nodes of each cell (cells, nodes, 3), or one in each cell (cells, 1, 3) where an array of the cells
    or a rule gives them.

    Raises:
        OutputError: there is no such array any more.
    """
    given, computed = (loaded, rest) if job.directions[0] == "inverse" else (rest, loaded)
    for name, family in job.fibres.items():
        (value, _) = family.quantities()["direction"]
        is_current = family.given_on == "current"
        if isinstance(value, ByRule):  # as the run has kept them, on the body that it computed
            array = _array(computed, f"fibres.{name}" if f"fibres.{name}" in computed.data else name, name)
            vectors, is_current = array.values[:, None], computed is loaded
        elif isinstance(value, ByData):
            array = _array(given, value.array, name)
            vectors = array.values[:, None] if array.place == "cells" else array.values[given.cells]
        else:
            places = np.concatenate([rest.points[rest.cells], loaded.points[rest.cells]], axis=2)
            positions = dict(zip("XYZxyz", np.moveaxis(places, 2, 0), strict=True))
            shape = rest.cells.shape
            vectors = np.stack([np.broadcast_to(f.values_at(positions), shape) for f in value], axis=2).astype(float)
        if is_current:
            vectors = _pulled_back(vectors, rest, loaded)
        lengths = np.linalg.norm(vectors, axis=2, keepdims=True)
        yield name, vectors / np.where(lengths > 0, lengths, 1.0)


def _array(mesh: MeshSource, array: str, family: str) -> DataArray:
    if array not in mesh.data:
        text = f"fibres.{family}: {mesh.path} has no array '{array}'"
        raise OutputError(text, "Keep the mesh of the job, and run with output: {mesh: [msh]}.")
    return mesh.data[array]


def _pulled_back(vectors: Floats, rest: MeshSource, loaded: MeshSource) -> Floats:
    """Return ``F⁻¹ a`` of vectors (cells, n, 3) at the nodes of the cells, or in their middle."""
    element = scalar_element(rest.kind, rest.degree)
    middle = scalar_element(rest.kind, 1).points.mean(axis=0)[None]
    slopes = element.tabulate(1, element.points if vectors.shape[1] > 1 else middle)[1:, :, :, 0]
    before, after = (np.einsum("dqk,cki->cqid", slopes, m.points[rest.cells]) for m in (rest, loaded))
    pulled: Floats = (before @ np.linalg.solve(after, vectors[..., None]))[..., 0]
    return pulled
