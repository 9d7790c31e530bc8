"""Pressure on segments, which turns and stretches with the first surface while segments stay where they are on it.

The force of a pressure ``p`` is ``∫ p (δx₂ - δx₁)·n da``, with the area vectors ``n da`` of the first surface at
present. Without their derivative, surfaces under a pressure of half a shear modulus would not settle. Opposite to a
rigid obstacle the pressure keeps the direction out of it, and the area stretches only.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from petsc4py import PETSc

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh.source import Floats, Ints
from hpcinv.model.interfaces.entries import matrix_of_entries
from hpcinv.model.interfaces.facets import Facets
from hpcinv.model.interfaces.segments import Segments


class PressedSegments:
    """The segments of the facets of the first surface on this rank; construction is collective.

    Args:
        names: sorted global numbers of the corners that have a pressure, on all ranks.
        owned: number of owned unknowns.
        fixes_normals: whether pressures keep the directions of the segments' normals.
    """

    def __init__(
        self,
        names: Ints,
        first: Facets,
        second: Facets,
        segments: Segments,
        owned: int,
        comm: MPI.Intracomm,
        *,
        fixes_normals: bool = False,
    ) -> None:
        self._comm, self._owned, self._count = comm, owned, len(names)
        self._directions_of_force = segments.normals if fixes_normals else None
        self._facets, j, self._starts = segments.first, segments.second, segments.starts
        values = first.kind.values(segments.first_places)
        opposite = second.kind.values(segments.second_places)[0]
        self._hats = first.kind.corner_values(segments.first_places)
        self._corners = np.searchsorted(names, first.nodes[:, : first.kind.corner_count])[self._facets]
        self._slopes, self._unknowns = values[1:], first.unknowns[self._facets]
        self._factors = np.ones(len(segments.weights))
        self._factors = (
            segments.weights / np.linalg.norm(self._turned_areas(first.points), axis=1) * first.signs[self._facets]
        )
        rows = 3 * np.arange(len(j))[:, None, None] + np.arange(3)
        self._jump_columns = np.concatenate([self._unknowns, second.unknowns[j]], axis=1)
        self._jump_values = np.concatenate([-values[0], opposite], axis=1)
        rows = np.broadcast_to(rows, self._jump_columns.shape)
        size = 3 * len(j)
        self._first_row = comm.exscan(size) or 0
        self._size = size
        self._jumps = self._matrix(
            (size, PETSc.DETERMINE),
            rows + self._first_row,
            self._jump_columns,
            np.repeat(self._jump_values[:, :, None], 3, axis=2),
        )
        self._at_points: PETSc.Vec = self._jumps.createVecLeft()

    def _matrix(self, rows: Any, row_numbers: Ints, columns: Ints, values: Floats) -> PETSc.Mat:
        return matrix_of_entries(self._comm, rows, (self._owned, PETSc.DETERMINE), (row_numbers, columns), values)

    def areas(self, points: Floats) -> Floats:
        """Return the area vectors (n, 3) with the nodes of the facets at ``points`` (facets, nodes, 3)."""
        areas = self._turned_areas(points)
        if self._directions_of_force is None:
            return areas
        return np.asarray(np.linalg.norm(areas, axis=1)[:, None] * self._directions_of_force)

    def _turned_areas(self, points: Floats) -> Floats:
        one, other = self._directions(points)
        return np.asarray(self._factors[:, None] * np.cross(one, other))

    def _directions(self, points: Floats) -> tuple[Floats, Floats]:
        one, other = np.matmul(self._slopes[:, :, None], points[self._facets])[:, :, 0]
        return one, other

    def forces(self, pressures: Floats, points: Floats, into: PETSc.Vec) -> None:
        """Set a vector to the nodal forces of pressures at the corners; collective."""
        at_points = np.einsum("nk,nk->n", self._hats, pressures[self._corners])
        self._at_points.array[:] = (at_points[:, None] * self.areas(points)).ravel()
        self._jumps.multTranspose(self._at_points, into)

    def resultant(self, pressures: Floats, points: Floats) -> Floats:
        """Return the force (3,) on the first side of all segments; collective."""
        at_points = np.einsum("nk,nk->n", self._hats, pressures[self._corners])
        force: Floats = -self._comm.allreduce(at_points @ self.areas(points), op=MPI.SUM)
        return force

    def force_matrix(self, points: Floats) -> PETSc.Mat:
        """Return the matrix (corners, unknowns) whose transpose makes forces of pressures; collective."""
        areas = self.areas(points)
        at_points = np.einsum("nc,nk,nd->nckd", self._hats, self._jump_values, areas)
        values = np.add.reduceat(at_points, self._starts)
        rows = np.broadcast_to(self._corners[self._starts, :, None, None], values.shape)
        columns = np.broadcast_to(self._jump_columns[self._starts, None], values.shape)
        return self._matrix((PETSc.DECIDE, self._count), rows, columns, values)

    def turning(self, pressures: Floats, points: Floats, free: PETSc.Vec | None = None) -> PETSc.Mat:
        """Return the derivative of the forces by the unknowns at constant pressures; collective.

        Args:
            free: 1 for unknowns whose rows and columns it has; all without it.
        """
        at_points = self._factors * np.einsum("nk,nk->n", self._hats, pressures[self._corners])
        one, other = self._directions(points)
        axes = np.eye(3)
        first, second = np.cross(axes, other[:, None]), np.cross(one[:, None], axes)  # by component d: (n, d, c)
        values = np.einsum("nk,ndc->nckd", self._slopes[0], first) + np.einsum("nk,ndc->nckd", self._slopes[1], second)
        values *= at_points[:, None, None, None]
        if (fixed := self._directions_of_force) is not None:
            areas = self._turned_areas(points)
            unit = areas / np.linalg.norm(areas, axis=1, keepdims=True)
            values = np.einsum("nc,ne,nekd->nckd", fixed, unit, values)
        rows = self._first_row + 3 * np.arange(len(at_points))[:, None] + np.arange(3)
        rows = np.broadcast_to(rows[:, :, None, None], values.shape)
        columns = np.broadcast_to(self._unknowns[:, None], values.shape)
        derivative = self._matrix((self._size, PETSc.DETERMINE), rows, columns, values)
        jumps = self._jumps.copy()
        if free is not None:
            jumps.diagonalScale(None, free)
            derivative.diagonalScale(None, free)
        product = jumps.transposeMatMult(derivative)
        jumps.destroy()
        derivative.destroy()
        return product

    def destroy(self) -> None:
        """Free PETSc objects."""
        self._jumps.destroy()
        self._at_points.destroy()
