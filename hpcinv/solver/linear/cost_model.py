"""Cost model of factorizations and preconditioned Krylov iterations, from size and shape of the body.

Nested dissection cuts a body with n unknowns by separators of about s = n h/L of them, where L is its longest extent
and h the distance of its nodes. Most work is in the largest fronts: O(s³) each; a cube has O(1) of them and a rod
O(n/s^1.5) one after the other, so that both take O(n s^1.5) operations and O(n s^0.5) entries (George, SIAM J. Numer.
Anal. 10, 345–363, 1973, doi:10.1137/0710032). The constants were fitted to MUMPS's own counts for blocks of 2,312 to
112,724 unknowns and of aspect ratio 1 to 40 (docs/performance/linear-solvers.md), the times to one core; more cores
change the times of both solvers alike.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from hpcinv.base.parallel.runtime import MPI
from hpcinv.model.spaces import Unknowns

_BY_NODE = 3  # unknowns
_OPERATIONS, _LONG, _SHORTER = 28.0, 3.6, 2.6  # operations are 28 (3.6 - 2.6 / a) n s^1.5
TANGENTS, CORRECTIONS = 4, 8  # of a typical solution
COARSER = 2.0  # factor of the cell sizes in nested iteration
_TANGENT = 5e-6  # s for each unknown: assembly
_SET_UP, _MESH, _TRANSFER = 0.05, 8e-6, 3e-6  # s: one more model; gmsh by coarse unknown; transfer by unknown
SLENDER = 15.0  # aspect ratio from which approximate minimum fill orders better than nested dissection
COMPACT = 3.0  # aspect ratio below which factors in single precision serve power series; of thinner bodies they may not
SINGLE, LOW_RANK = 4e9, 3e11  # operations of a factorization from which single precision and low rank pay
# s of a set-up by unknown of degree 1, which is aggregated, and of a higher degree, without its level of degree 1; s of
# an iteration by unknown. Larger ones favour factors.
_AGGREGATION, _LEVEL, _ITERATION = 14e-6, 5.2e-6, 6e-7
# Mean number of nodes in a row, by degree from 1, in regular meshes of tetrahedra and of hexahedra. Products with the
# tangent, and its products by interpolations, take a time in proportion.
_ROWS = (15, 29, 49, 75), (27, 64, 125, 216)
# Krylov iterations of a correction of a cube of 20,000 to 160,000 unknowns; higher ones favour factors.
_DISPLACEMENT_KRYLOV, _MIXED_KRYLOV = 9, 18
_STIFF = 10.0  # bulk by shear modulus from which the displacement form takes iterations by the root of that ratio
_FLAT = 100.0  # cubed norm of a cell's edges by its volume: 5 for equal orthogonal edges, 100 for a height of 1/35
# Volume of solid bodies by the product of their extents: 0.79 to 0.91 for blocks and organs, at most 0.56 for lattices,
# sponges and trees, 1.3 for a mesh that is graded towards a corner. A wider range saves analyses and may miss branches.
_FILLED = 0.7, 1.15
_FLATTENED = 2.0  # ratio of the shorter extents above which a body is a plate, whose separators are smaller
_REFINEMENTS = 5  # iterations of a correction with factors in single precision, or with kept ones


@dataclass(frozen=True)
class Shape:
    """Number of unknowns in a cut across the longest extent of a body, and that extent by the root of the cut area.

    Attributes:
        is_solid: whether the body fills the extents of a rod or a cube, so that no separator is clearly smaller.
    """

    cut: float
    aspect: float
    is_solid: bool = False

    @classmethod
    def equal_rod(cls, operations: float, unknowns: int) -> Shape:
        """Return the shape of the rod whose factorization takes as many operations.

        A body of many branches has its separators, and multigrid has as much trouble with it. Blocks up to 2.6 times
        as long as wide take as many operations as one another, and count as rods here.
        """
        ratio, cube = operations / (_OPERATIONS * unknowns), unknowns * math.sqrt(_BY_NODE)
        # ratio = (3.6 - 2.6 / a) s^1.5 with a = cube / s^1.5: a rod of N nodes is N / (s / 3)^1.5 times as long as wide
        root = _LONG**2 - 4 * _SHORTER * ratio / cube
        power = 2 * ratio / (_LONG + math.sqrt(root)) if root > 0 else ratio  # or a block, of more than a cube has
        return cls(cut=power ** (2 / 3), aspect=max(cube / power, 1.0))


@dataclass(frozen=True)
class Forecast:
    """Cost of the tangents of one solution with either solver, in seconds of one core, and memory in bytes.

    Args:
        unknowns: number of unknowns.
        degree: polynomial degree of the displacement.
        is_mixed: whether the pressure is an unknown.
        has_hexahedra: whether the cells are hexahedra.
        stiffness: largest ratio of bulk to shear modulus.
        extents: shape of the body, where ``shape`` is the rod with as many operations. It decides on the precision.
    """

    unknowns: int
    degree: int
    shape: Shape
    is_mixed: bool = False
    has_hexahedra: bool = False
    stiffness: float = 1.0
    extents: Shape | None = None

    def degree_forecast(self, degree: int) -> Forecast:
        """Return the forecast for spaces of another degree on the same body."""
        finer = degree / self.degree
        shape = replace(self.shape, cut=self.shape.cut * finer**2)
        return replace(self, unknowns=round(self.unknowns * finer**3), degree=degree, shape=shape)

    @property
    def block(self) -> Forecast:
        """The forecast by the extents of the body."""
        return self if self.extents is None else replace(self, shape=self.extents, extents=None)

    @property
    def coarser(self) -> Forecast:
        """The forecast on cells `COARSER` times as large."""
        shape = replace(self.shape, cut=self.shape.cut / COARSER**2)
        return replace(self, unknowns=round(self.unknowns / COARSER**3), shape=shape)

    def nested_gain(self, tangents: int, ranks: int = 1) -> float:
        """Return the time that nested iteration saves by the time that it takes.

        Args:
            tangents: number of them on the way from the unloaded body; one of them is left.
            ranks: number of ranks, which share assembly and transfer, and factorizations less well; gmsh runs on one.
        """
        coarser = self.coarser
        moved = _SET_UP + _MESH * coarser.unknowns + _TRANSFER * self.unknowns / ranks
        return (tangents - 1) * self.tangent(ranks) / (moved + tangents * coarser.tangent(ranks))

    def tangent(self, ranks: int = 1) -> float:
        """Time of one tangent and its factorization (s); slender bodies have little to share among ranks."""
        factorization = self.factorization if self.operations < SINGLE else self._single_precision_time
        return _TANGENT * self.unknowns * self.degree**2 / 4 / ranks + factorization / math.sqrt(ranks)

    @property
    def entries(self) -> float:
        """Number of entries of the factors L and U."""
        return 38.0 * (1.35 - 0.35 / self.shape.aspect) * self.unknowns * math.sqrt(self.shape.cut)

    @property
    def operations(self) -> float:
        """Number of operations of one factorization L U."""
        factor = _LONG - _SHORTER / self.shape.aspect
        return _OPERATIONS * factor * self.unknowns * math.pow(self.shape.cut, 1.5)

    @property
    def factors(self) -> float:
        """Memory (bytes) of L U with MUMPS's working space."""
        return 10 * self.entries

    @property
    def multigrid(self) -> float:
        """Memory (bytes) of the tangent, its blocks and their multigrid hierarchy."""
        return 40 * 24 * self.degree**2 * self.unknowns

    @property
    def least(self) -> float:
        """Memory (bytes) of the solver that needs less."""
        return min(self.factors, self.multigrid)

    @property
    def factorization(self) -> float:
        """Time of one factorization L U in double precision (s)."""
        return self.operations / 48e9 + 1.2e-8 * self.entries

    @property
    def back_substitution(self) -> float:
        """Time of one solve by these factors and one product with the tangent (s)."""
        return 1.2e-9 * self.entries + 2e-7 * self.unknowns

    @property
    def direct(self) -> float:
        """Time of the factorizations (s), and of their refinement."""
        block = self.block
        if block.operations < SINGLE:
            return self._new_tangents * self.factorization
        refinement = 6e-10 * self.entries + 2e-7 * self.unknowns
        # Compact and slender bodies have factors in single precision (`hpcinv.solver.linear.selection`).
        is_double = COMPACT <= block.shape.aspect < SLENDER and block.operations < LOW_RANK
        factorization = self.factorization if is_double else self._single_precision_time
        return self._new_tangents * factorization + CORRECTIONS * _REFINEMENTS * refinement

    @property
    def _new_tangents(self) -> float:
        """Number of tangents with a set-up of their own; chunky bodies can keep more."""
        return TANGENTS * (1 - 0.5 / self.shape.aspect)

    @property
    def _single_precision_time(self) -> float:
        """Time of one factorization in single precision (s)."""
        compressed = 0.7 if self.operations >= LOW_RANK and self.block.shape.aspect < SLENDER else 1.0
        return compressed * (self.operations / 1e11 + 7e-9 * self.entries)

    @property
    def iterative(self) -> float:
        """Time of the multigrid set-up and the Krylov iterations (s)."""
        return self.multigrid_time(self._new_tangents, CORRECTIONS * self.krylov)

    def multigrid_time(self, tangents: float, iterations: float) -> float:
        """Return the time (s) of a number of multigrid set-ups and of Krylov iterations."""
        rows, measured = _ROWS[self.has_hexahedra], _ROWS[False]
        share = rows[0] / measured[0]
        set_up = _AGGREGATION * share
        if self.degree > 1:
            share = rows[self.degree - 1] / measured[1]  # an iteration of degree 1 or 2 on tetrahedra has one price
            set_up = set_up / self.degree**3 + _LEVEL * share
        return (tangents * set_up + iterations * _ITERATION * share) * self.unknowns

    @property
    def equal_krylov(self) -> float:
        """Krylov iterations of one correction with which multigrid takes as long as factorizations; at least 0."""
        return max(self.direct - self.multigrid_time(self._new_tangents, 0), 0.0) / self.multigrid_time(0, CORRECTIONS)

    @property
    def locking(self) -> float:
        """Factor by which a bulk modulus far above the shear modulus multiplies the iterations."""
        return 1.0 if self.is_mixed else math.sqrt(max(self.stiffness / _STIFF, 1.0))

    @property
    def krylov(self) -> float:
        """Krylov iterations of one correction."""
        cube = _MIXED_KRYLOV if self.is_mixed else _DISPLACEMENT_KRYLOV * self.locking
        return cube * math.pow(self.shape.aspect, 0.25)


def shape_of(unknowns: Unknowns) -> Shape:
    """Return the shape of the body, measured on its mesh at the present coordinates; collective."""
    comm, x = unknowns.mesh.comm, unknowns.owned_displacement_points()
    nodes = comm.allreduce(len(x))
    centre = comm.allreduce(x.sum(axis=0)) / nodes
    spread = np.linalg.eigvalsh(comm.allreduce((x - centre).T @ (x - centre)) / nodes)
    extents = np.sqrt(12 * np.maximum(spread, 0.0))  # exact for a rod or a block
    length = float(extents[-1])
    volume = float(comm.allreduce(_volume(unknowns), op=MPI.SUM))
    spacing = (volume / nodes) ** (1 / 3)
    is_filled = _FILLED[0] * extents.prod() < volume < _FILLED[1] * extents.prod()
    return Shape(
        cut=unknowns.size * spacing / length,
        aspect=max(length / (volume / length) ** 0.5, 1.0),
        is_solid=bool(is_filled and extents[1] < _FLATTENED * extents[0]),
    )


def flat_share(unknowns: Unknowns) -> float:
    """Return the share of the cells whose edges at a corner are far from equal and orthogonal; collective."""
    edges = _edges_at_corner(unknowns)
    flat = np.linalg.norm(edges, axis=(1, 2)) ** 3 > _FLAT * np.abs(np.linalg.det(edges))
    counts = unknowns.mesh.comm.allreduce(np.array([flat.sum(), len(flat)]))
    return float(counts[0] / counts[1])


def _volume(unknowns: Unknowns) -> float:
    """Return the volume of the owned cells with straight edges."""
    tetrahedra = unknowns.mesh.topology.cell_type.name == "tetrahedron"
    return float(np.abs(np.linalg.det(_edges_at_corner(unknowns))).sum()) / (6 if tetrahedra else 1)


def _edges_at_corner(unknowns: Unknowns) -> npt.NDArray[np.float64]:
    """Return the three straight edges at a corner of each owned cell, (cells, 3, 3)."""
    mesh = unknowns.mesh
    last = 3 if mesh.topology.cell_type.name == "tetrahedron" else 4
    corners = mesh.geometry.dofmaps[0][: mesh.topology.index_map(3).size_local][:, [0, 1, 2, last]]
    points = mesh.geometry.x[corners]
    return np.asarray(points[:, 1:] - points[:, :1])
