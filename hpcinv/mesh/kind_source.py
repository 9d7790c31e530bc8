"""What depends on the kind of a body: its mesh as the file has it, the body made of it, and the cells of that.

This class is for solids, and the base of the others'.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from hpcinv.base.quantity.expressions import KeyPath
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.job.mesh_section import ArrayLabels, MeshSpec
from hpcinv.mesh.checks import consistently_oriented
from hpcinv.mesh.readers import FILES
from hpcinv.mesh.source import DataArray, Floats, Ints, MeshSource
from hpcinv.on_demand import on_demand, variant


class KindSource:
    """The mesh of a body of cells that its file has."""

    def read(self, path: Path, labels: ArrayLabels | None) -> MeshSource:
        """Return the mesh of a file, in its unit.

        Args:
            labels: array that has further regions, which `labelled` adds to solids.
        """
        return FILES[suffix_of(path)](path)

    def oriented(self, source: MeshSource) -> MeshSource:
        """Return the mesh as it was read with cells that are not inverted, where that can be seen."""
        return consistently_oriented(source)

    def labelled(self, source: MeshSource, labels: ArrayLabels) -> MeshSource:
        """Return the mesh as it was read with the regions of an array."""
        labelled: MeshSource = on_demand("regions of an array")(source, labels)
        return labelled

    def body(self, source: MeshSource, spec: MeshSpec) -> MeshSource:
        """Return the body of a mesh as it was read."""
        return source

    def cut(self, body: MeshSource) -> MeshSource:
        """Return the body with each cell cut into cells of half the size."""
        refined: MeshSource = on_demand("refined mesh")(body).source
        return refined

    def quadrature(self, body: MeshSource, degree: int) -> int:
        """Return the degree of the quadrature rule that integrates polynomials of some degree on the cells."""
        return degree

    def corrects_shear(self, body: MeshSource, degree: int) -> bool:
        """Return whether displacements of a degree are too soft in shear through the cells' third direction."""
        return False

    def surface_heights(self, body: MeshSource, cells: Ints, count: int) -> Floats:
        """Return where the given surface crosses the third axis (0 to 1) of cells, by their rows among ``count``."""
        return np.full(len(cells), np.nan)

    def node_rates(self, body: MeshSource, place: KeyPath, value: float) -> Floats:
        """Return the derivatives (n, 3) of the nodes of the body by a number (SI) of the section of its kind."""
        return np.zeros_like(body.points)

    def moved(self, body: MeshSource, shape: MeshSource) -> Floats:
        """Return the nodes (n, 3) m of the body whose mesh in the file has moved to ``shape``."""
        return shape.points

    def node_direction(self, body: MeshSource, nodes: Floats, rates: Floats) -> Floats:
        """Return rates (N, 3) of the nodes of the body as `moved` places them, from rates of the mesh in the file.

        Args:
            body: as it was given, before it moved.
            nodes, rates: places (m) of the nodes of the mesh in the file, and their rates, (n, 3).
        """
        return rates

    def node_gradient(self, body: MeshSource, nodes: Floats, gradient: Floats) -> Floats:
        """Return the transpose of `node_direction`: derivatives (n, 3) from derivatives (N, 3) by nodes of the body."""
        return gradient

    def saved(self, body: MeshSource, points: Floats, more: Mapping[str, DataArray]) -> tuple[MeshSource, Floats]:
        """Return mesh and nodes for a file of the body at ``points`` (n, 3) m, with more data."""
        return dataclasses.replace(body, data={**body.data, **more}), points


def source_of(kind: str) -> KindSource:
    """Return what makes the body of a kind, by its name."""
    source: KindSource = variant(f"mesh of a {kind}", KindSource)()
    return source
