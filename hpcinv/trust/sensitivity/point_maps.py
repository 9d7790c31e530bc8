"""Linear maps between values at the nodes of cells and values at points of the body, with their transposes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from dolfinx import la

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh import Body
from hpcinv.mesh.body import source_node_values, values_on_cells
from hpcinv.mesh.cells import scalar_element
from hpcinv.mesh.location import PointLocation
from hpcinv.mesh.source import Floats, Ints
from hpcinv.model.spaces import Unknowns


@dataclass(frozen=True)
class PointMap:
    """Values at points as weighted sums of values at nodes.

    Attributes:
        points: rows of the points, (p,).
        nodes: nodes of each point, (p, k).
        weights: of the values at those, (p, k).
    """

    points: Ints
    nodes: Ints
    weights: Floats

    def at_points(self, values: Floats) -> Floats:
        """Return the values (p, c) at the points, from values (n, c) at the nodes."""
        return np.asarray(np.einsum("pk,pkc->pc", self.weights, values[self.nodes]))

    def at_nodes(self, covector: Floats, count: int) -> Floats:
        """Return the transpose: (count, c) at the nodes, from (p, c) at the points."""
        result = np.zeros((count, covector.shape[1]))
        np.add.at(result, self.nodes, self.weights[:, :, None] * covector[:, None, :])
        return result

    def rows(self, chosen: Ints) -> PointMap:
        """Return the map of some of the points, by their places in ``points``."""
        return PointMap(self.points[chosen], self.nodes[chosen], self.weights[chosen])


class PointMaps:
    """Maps between the nodes of the job's mesh, the nodes of the computed cells, and the unknown displacements.

    The nodes of the mesh are those in the files of shapes, in their order: of the mesh file, if it has no unused nodes.
    """

    def __init__(self, body: Body, unknowns: Unknowns) -> None:
        self._body, self._unknowns = body, unknowns
        self.comm: MPI.Intracomm = body.mesh.comm
        self.node_count = int(self.comm.allreduce(len(body.source.points)))
        self.cell_count = sum(body.partition.cells)
        geometry = body.source_geometry
        self._owned = geometry.index_map().size_local
        self.numbers: Ints = np.asarray(geometry.input_global_indices, dtype=np.int64)

    @cached_property
    def displacement(self) -> PointMap:
        """Values at the owned nodes of the mesh, from nodes of the displacement's space."""
        kind, degree = self._body.source.kind, self._body.source.degree
        return self._between(
            self._body.source_geometry.dofmaps[0],
            self._owned,
            self._unknowns.displacement_space.dofmap.list,
            _tabulated(self._unknowns.scalar_elements[0], scalar_element(kind, degree).points),
        )

    @cached_property
    def geometry(self) -> PointMap:
        """Positions of the owned nodes of the computed cells, from the local nodes of the mesh."""
        body, kind = self._body, self._body.source.kind
        here = body.mesh.geometry
        table = _shapes(kind, body.source.degree, scalar_element(kind, body.degree).points)
        return self._between(here.dofmaps[0], here.index_map().size_local, body.source_geometry.dofmaps[0], table)

    @cached_property
    def positions(self) -> PointMap:
        """Positions of all local nodes of the displacement's space, from the local nodes of the mesh."""
        body = self._body
        nodes = self._unknowns.displacement_space.dofmap.list
        points = self._unknowns.scalar_elements[0].basix_element.points
        table = _shapes(body.source.kind, body.source.degree, points)
        return self._between(nodes, int(nodes.max(initial=-1)) + 1, body.source_geometry.dofmaps[0], table)

    @staticmethod
    def _between(points: Ints, count: int, nodes: Ints, table: Floats) -> PointMap:
        """Return the map to the points below ``count``, each from one of its cells.

        Args:
            points, nodes: of each cell, (cells, m) and (cells, k).
            table: weights (m, k).
        """
        number, first = np.unique(points.ravel(), return_index=True)
        first, number = first[number < count], number[number < count]
        cell, place = np.divmod(first, points.shape[1])
        return PointMap(number, nodes[cell], table[place])

    def at(self, place: PointLocation) -> tuple[PointMap, PointMap]:
        """Return maps to one point, which other ranks do not have: of the displacement, and of positions."""
        body, xi = self._body, place.xi[None]
        cells = np.array([place.cell] if place.rank == self.comm.rank else [], dtype=np.int64)
        displacement = _tabulated(self._unknowns.scalar_elements[0], xi)
        position = _shapes(body.source.kind, body.source.degree, xi)
        nodes = self._unknowns.displacement_space.dofmap.list, body.source_geometry.dofmaps[0]
        first, second = (
            PointMap(np.zeros(len(cells), dtype=np.int64), of[cells], np.repeat(table, len(cells), axis=0))
            for of, table in zip(nodes, (displacement, position), strict=True)
        )
        return first, second

    def source_positions(self, nodes: Floats) -> Floats:
        """Return positions at the local nodes of the mesh, from positions at the local nodes of the computed cells."""
        return source_node_values(self._body, nodes)

    def scattered(self, covector: Floats) -> Floats:
        """Return rows (N, c) of the mesh's nodes at the owned nodes, (n, c), which `displacement` has."""
        return np.asarray(covector[self.numbers[self.displacement.points]])

    def gathered(self, values: Floats) -> Floats:
        """Return values (n, c) at the local nodes of the mesh, which differ in nothing among ranks, as (N, c)."""
        rows, whole = slice(0, self._owned), np.zeros((self.node_count, values.shape[1]))
        whole[self.numbers[rows]] = values[rows]
        return self._total(whole)

    def summed(self, covector: Floats) -> Floats:
        """Return the sum over ranks of a covector (n, c) at the local nodes of the mesh, as (N, c)."""
        whole = np.zeros((self.node_count, covector.shape[1]))
        np.add.at(whole, self.numbers, covector)
        return self._total(whole)

    def on_computed_cells(self, values: Floats) -> Floats:
        """Return values (N, c) at the nodes of the mesh at the nodes of each computed local cell, (cells, k, c)."""
        local = values_on_cells(self._body, values[self.numbers])
        return np.asarray(local[self._body.mesh.geometry.dofmaps[0]])

    def nodal(self, function_space: Any, covector: Floats) -> Floats:
        """Return a covector by the nodal values (n, c) of a function of the computed cells' degree, as (N, c).

        Args:
            covector: of this rank alone, at the local degrees of freedom.
        """
        width, index_map = covector.shape[1], function_space.dofmap.index_map
        vector = la.vector(index_map, width)
        vector.array[:] = covector.ravel()
        vector.scatter_reverse(la.InsertMode.add)
        vector.scatter_forward()
        here = self._body.mesh.geometry
        values = np.zeros((len(here.x), width))
        values[here.dofmaps[0]] = vector.array.reshape(-1, width)[function_space.dofmap.list]
        count = len(self._body.source_geometry.x)
        return self.summed(self.geometry.at_nodes(values[self.geometry.points], count))

    def on_motion(self, function_space: Any, values: Floats) -> Floats:
        """Return values (N, c) at the nodes of the mesh at the local degrees of freedom, the opposite of `nodal`."""
        nodes = function_space.dofmap.list
        there = np.zeros((int(nodes.max(initial=-1)) + 1, values.shape[1]))
        there[nodes] = self.on_computed_cells(values)
        return there

    def by_cell(self, values: Floats) -> Floats:
        """Return values (owned cells, c) of this rank as (cells, c) in the order of the mesh, on all ranks."""
        number = np.asarray(self._body.mesh.topology.original_cell_index)[: len(values)]
        whole = np.zeros((self.cell_count, values.shape[1]))
        whole[number] = values
        return self._total(whole)

    def of_local_cells(self, values: Floats) -> Floats:
        """Return values (cells, c) in the order of the mesh at the local cells, ghosts included."""
        return np.asarray(values[np.asarray(self._body.mesh.topology.original_cell_index)])

    def _total(self, whole: Floats) -> Floats:
        self.comm.Allreduce(MPI.IN_PLACE, whole, MPI.SUM)
        return whole


def _shapes(kind: str, degree: int, points: Floats) -> Floats:
    """Return values (points, nodes) of the shape functions of cells."""
    return np.asarray(scalar_element(kind, degree).tabulate(0, points)[0, :, :, 0])


def _tabulated(element: Any, points: Floats) -> Floats:
    """Return values (points, functions) of a scalar element."""
    return np.asarray(element.tabulate(0, points)[0]).reshape(len(points), element.dim)
