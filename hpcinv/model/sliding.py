"""Nodes that slide: constraints ``c·u = 0`` along directions that are not axes, without penalties or multipliers.

At a node with directions ``c_k`` and components that are prescribed along axes, the displacement is

    u = P u + τ,    P = I - C⁺C,    τ = -C⁺ C_F ū

with ``C`` the directions' components along the free axes, ``C_F`` along the prescribed ones. The unknowns stay
Cartesian. With the projector P of all nodes, the linear system has the matrix ``P K P + (I - P)``, with the pattern
of K. It is symmetric if K is, and each constraint adds an eigenvalue 1. A direction along an axis would give what a
Dirichlet condition gives: its row and column are zero, with a one on the diagonal.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from petsc4py import PETSc

from hpcinv.mesh.source import Floats
from hpcinv.model.spaces import Integers, Unknowns

_SUBSET: Any = PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN  # their stubs have the wrong type
_DIFFERENT: Any = PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN
_PARALLEL = 1e-6
"""Sine of the angle below which directions are the same; raised, nearly parallel planes hold one direction only."""


@dataclass(frozen=True)
class Slide:
    """The nodes of one support that slide.

    Attributes:
        space: of vectors; ``nodes`` are of it.
        nodes: local nodes of the space, (n,).
        normals: directions in which they are held, (n, 3).
    """

    field: str
    region: str
    space: fem.FunctionSpace
    nodes: Integers
    normals: Floats

    @property
    def points(self) -> Floats:
        """Present positions of ``nodes``, (n, 3) in scaled lengths."""
        points: Floats = self.space.tabulate_dof_coordinates()[self.nodes]
        return points

    def component_of(self, vectors: Floats) -> Floats:
        """Return the held component of vectors (n, 3, …) at ``nodes``."""
        component: Floats = np.einsum("ni...,ni->n...", vectors, self.normals)
        return component


class Sliding:
    """Constraints of all slides; arrays are of local unknowns, or of owned ones.

    Args:
        fixed: which local unknowns are prescribed along axes.
    """

    def __init__(self, slides: Sequence[Slide], unknowns: Unknowns, fixed: npt.NDArray[np.bool_]) -> None:
        self._unknowns = unknowns
        self._regions = [slide.region for slide in slides]
        nodes = np.unique(np.concatenate([np.zeros(0, dtype=np.int32), *(slide.nodes for slide in slides)]))
        self.dofs: Integers = unknowns.displacement_dofs_of_nodes[nodes]
        directions = np.zeros((len(nodes), len(slides), 3))
        for k, slide in enumerate(slides):
            directions[np.searchsorted(nodes, slide.nodes), k] = slide.normals
        self._is_fixed = fixed[self.dofs]
        self._fixed_part = np.where(self._is_fixed[:, None], directions, 0.0)
        free = np.where(self._is_fixed[:, None], 0.0, directions)
        free[np.linalg.norm(free, axis=2) < _PARALLEL] = 0.0
        self._free_part = free
        self._inverse = np.linalg.pinv(free, rcond=_PARALLEL)  # (nodes, 3, slides)
        self._normal_part: Floats = self._inverse @ free

    def targets(self, prescribed: Floats) -> Floats:
        """Return τ (nodes, 3) for local unknowns that have the prescribed displacements, and zeros."""
        u = np.where(self._is_fixed, prescribed[self.dofs], 0.0)
        targets: Floats = -np.einsum("nik,nkj,nj->ni", self._inverse, self._fixed_part, u)
        return targets

    def disagreement(self, prescribed: Floats) -> Floats:
        """Return how far prescribed displacements leave the slides, (nodes,)."""
        u = np.where(self._is_fixed, prescribed[self.dofs], 0.0)
        left = np.einsum("nkj,nj->nk", self._fixed_part, u)
        left += np.einsum("nkj,nj->nk", self._free_part, self.targets(prescribed))
        distances: Floats = np.abs(left).max(axis=1, initial=0.0)
        return distances

    def held(
        self, values: npt.NDArray[np.floating[Any]], regions: Collection[str] | None = None
    ) -> tuple[Integers, Floats]:
        """Return unknowns (n, 3) of nodes among ``values``, and the held part of the values there.

        Args:
            regions: of the slides whose directions count; by default all.
        """
        inside = (self.dofs < len(values)).all(axis=1)
        dofs, values_there = self.dofs[inside], values[self.dofs[inside]]
        if regions is None:
            return dofs, np.einsum("nij,nj->ni", self._normal_part[inside], values_there)
        sizes = np.einsum("nik,ni->nk", self._inverse[inside], values_there)
        sizes *= [region in regions for region in self._regions]
        return dofs, np.einsum("nk,nki->ni", sizes, self._free_part[inside])

    def normal_part(self, x: Floats) -> Floats:
        """Return the held part of local unknowns, (nodes, 3)."""
        part: Floats = np.einsum("nij,nj->ni", self._normal_part, x[self.dofs])
        return part

    def constraint(self, matrix: PETSc.Mat) -> MatrixConstraint:
        """Return what makes a tangent obey the constraints; collective."""
        inside = (self.dofs < matrix.getLocalSize()[0]).all(axis=1)
        return MatrixConstraint(matrix, self.dofs[inside], self._normal_part[inside])


class MatrixConstraint:
    """``K ← P K P + (I - P)`` of one matrix, which keeps its pattern.

    Args:
        dofs: owned unknowns of nodes, (n, 3).
        normal_part: ``I - P`` of these nodes, (n, 3, 3).
    """

    def __init__(self, matrix: PETSc.Mat, dofs: Integers, normal_part: Floats) -> None:
        self._matrix = matrix
        self._product: PETSc.Mat | None = None
        first, last = matrix.getOwnershipRange()
        starts = np.arange(last - first + 1, dtype=PETSc.IntType)
        identity = (starts, first + starts[:-1], np.ones(last - first))
        rows = np.zeros(last - first, dtype=PETSc.IntType)
        rows[dofs] = 3
        constrained = np.concatenate([[0], np.cumsum(rows)]).astype(PETSc.IntType)
        columns, values = np.empty(constrained[-1], dtype=PETSc.IntType), np.empty(constrained[-1])
        places = constrained[dofs][:, :, None] + np.arange(3)
        columns[places] = first + dofs[:, None]
        values[places] = normal_part
        size, comm = matrix.getSizes(), matrix.getComm()
        self._held = PETSc.Mat().createAIJ(size, csr=(constrained, columns, values), comm=comm)
        self._projector = PETSc.Mat().createAIJ(size, csr=identity, comm=comm)
        self._projector.axpy(-1.0, self._held, _DIFFERENT)

    def apply(self) -> None:
        """Constrain the matrix as it is assembled now; collective."""
        self._product = self._matrix.PtAP(self._projector, result=self._product)
        self._product.axpy(1.0, self._held, _SUBSET)
        # MatCopy would take the prefix of the options from the matrix, and with it the determinant.
        self._matrix.setValuesCSR(*self._product.getValuesCSR())
        self._matrix.assemble()

    def destroy(self) -> None:
        """Free PETSc objects."""
        for matrix in (self._held, self._projector, self._product):
            if matrix is not None:
                matrix.destroy()
