"""Nodes that slide: constraints ``c_k(u) = 0`` along directions that are not axes, without penalties or multipliers.

On a plane ``c = n·u``. On a surface ``g = 0`` the other place ``y`` of a node at ``x`` of the mesh is on the level of
``x``, ``c = (g(y) - g(x)) / |∇g(y)|``: nodes inside of straight edges, which are not on it, stay as far from it.

At a node with components that are prescribed along axes, let C be the derivatives of ``c`` along the free axes, ``C_F``
along the prescribed ones. A displacement lacks

    -C⁺ (c(u) + C_F (ū - u)_F)

of the constraints, to first order. Forces are balanced in the tangent plane at the loaded place of the node, with
directions D: ``D = C`` on planes and in forward problems; the unknown place of inverse problems is the unloaded one.
The unknowns stay Cartesian. With projectors ``P = I - C⁺C`` and ``Q = I - D⁺D`` of all nodes, the linear system has the
matrix

    Q (K - Σ λ_k ∇²g_k / |∇g_k|) P + D⁺C,    λ = (D⁺)ᵀ R,

with the pattern of K. The reactions λ turn with the tangent planes of forward problems; in inverse problems the planes
are fixed, and the sum is left out. The matrix is symmetric if K is and ``D = C``; then each constraint adds an
eigenvalue 1. A direction along an axis would give what a Dirichlet condition gives: its row and column are zero, with a
one on the diagonal.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from dolfinx.mesh import entities_to_geometry
from petsc4py import PETSc

from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.errors import MeshError, naming_field
from hpcinv.job.support import Support
from hpcinv.mesh import Body
from hpcinv.mesh.source import Floats
from hpcinv.model.nodal_normals import nodal_normals
from hpcinv.model.sliding_surfaces import SlidingSurface, surface_of
from hpcinv.model.spaces import Unknowns
from hpcinv.model.supports import dofs_on

_SUBSET: Any = PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN  # its stub has the wrong type
_PARALLEL = 1e-6
"""Sine of the angle below which directions are the same; raised, nearly parallel planes hold one direction only."""


@dataclass(frozen=True)
class Slide:
    """The nodes of one support that slide.

    Attributes:
        space: of vectors; ``nodes`` are of it.
        nodes: local nodes of the space, (n,).
        normals: directions in which they are held, (n, 3), on the given mesh.
        surface: on which they slide; ``None`` for the planes of the normals.
    """

    field: str
    region: str
    space: fem.FunctionSpace
    nodes: LocalIndices
    normals: Floats
    surface: SlidingSurface | None = None

    @property
    def points(self) -> Floats:
        """Present positions of ``nodes``, (n, 3) in scaled lengths."""
        points: Floats = self.space.tabulate_dof_coordinates()[self.nodes]
        return points

    def component_of(self, vectors: Floats) -> Floats:
        """Return the held component of vectors (n, 3, …) at ``nodes``."""
        component: Floats = np.einsum("ni...,ni->n...", vectors, self.normals)
        return component


def slide_of(spec: Support, place: str, body: Body, unknowns: Unknowns) -> Slide:
    """Return the nodes of a support that slide, on the mesh at its given coordinates; collective."""
    space = unknowns.displacement_space
    if spec.normal is not None:
        nodes = dofs_on(space, body.held_entities(spec.region))
        normals = np.tile(np.array(spec.normal) / np.linalg.norm(spec.normal), (len(nodes), 1))
        return Slide(f"{place}.fix", spec.region, space, nodes, normals)
    if spec.surface is None or spec.fitted_surface:
        with naming_field(f"{place}.region"):
            remedy = "Name a region of the boundary, or give the 'normal' or the formula of a 'surface'."
            facets = body.boundary_facets(spec.region, remedy)
        nodes, normals, edge = nodal_normals(space, facets)
        if edge is not None:
            point = ", ".join(f"{c:.6g}" for c in edge * body.length_scale)
            raise MeshError(
                f"{place}.fix: '{spec.region}' has a sharp edge at ({point}) m, where it has no normal",
                "Give each smooth face a support of its own.",
            )
        if spec.surface is None:
            return Slide(f"{place}.fix", spec.region, space, nodes, normals)
    else:
        facets = body.facets(spec.region)
        nodes = fem.locate_dofs_topological(space, 2, facets)
        normals = np.zeros((len(nodes), 3))
    points = space.tabulate_dof_coordinates()[nodes] * body.length_scale
    corners = body.mesh.geometry.x[np.unique(entities_to_geometry(body.mesh, 2, facets))] * body.length_scale
    surface = surface_of(spec, place, points, normals, corners, body.mesh.comm)
    gradients = surface.values(points).gradient
    normals = gradients / np.linalg.norm(gradients, axis=1)[:, None]
    return Slide(f"{place}.fix", spec.region, space, nodes, normals, surface)


class Sliding:
    """Constraints of all slides; arrays are of local unknowns, or of owned ones.

    Args:
        fixed: which local unknowns are prescribed along axes.
        metre: scaled unit of length in m.
        sign: of displacements from the mesh to the other body, as in `Kinematics`.

    Attributes:
        sign: as given; `Supports.scale` sets it.
        is_curved: whether directions depend on the state; they are evaluated at the unknowns' state.
    """

    def __init__(
        self,
        slides: Sequence[Slide],
        unknowns: Unknowns,
        fixed: npt.NDArray[np.bool_],
        metre: float,
        sign: int,
    ) -> None:
        self._unknowns, self._metre, self.sign = unknowns, metre, sign
        self._regions = [slide.region for slide in slides]
        nodes = np.unique(np.concatenate([np.zeros(0, dtype=np.int32), *(slide.nodes for slide in slides)]))
        self._nodes: LocalIndices = nodes
        self.dofs: LocalIndices = unknowns.displacement_dofs_of_nodes[nodes]
        self._planes = np.zeros((len(nodes), len(slides), 3))
        rows = [np.searchsorted(nodes, slide.nodes) for slide in slides]
        for k, slide in enumerate(slides):
            self._planes[rows[k], k] = slide.normals
        self._surfaces = [(k, rows[k], slide.surface) for k, slide in enumerate(slides) if slide.surface is not None]
        self.is_curved = bool(self._surfaces)
        self._is_fixed = fixed[self.dofs]
        self._curvatures = np.zeros((*self._planes.shape, 3) if self.is_curved else 0)
        self._offsets = np.zeros(self._planes.shape[:2])  # c - n·u
        self._place: Floats = np.zeros(0)  # where the directions were evaluated
        self._set_directions(self._planes, self._planes)

    @property
    def is_symmetric(self) -> bool:
        """True if displacements and forces have the same directions."""
        return self.sign > 0 or not self.is_curved

    def _set_directions(self, trial: Floats, test: Floats) -> None:
        self._trial, fixed = trial, self._is_fixed[:, None]
        self._free_trial, self._free_test = (_without_small(np.where(fixed, 0.0, d)) for d in (trial, test))
        self._trial_inverse = _inverses(self._free_trial)  # (nodes, 3, slides)
        self._test_inverse = self._trial_inverse if test is trial else _inverses(self._free_test)

    def _locate(self, u: Floats) -> None:
        """Evaluate surfaces at displacements (nodes, 3) of the present mesh."""
        if not self.is_curved:
            return
        x = self._unknowns.displacement_space.tabulate_dof_coordinates()[self._nodes]
        now = np.stack([self.sign * u, x])
        if np.array_equal(now, self._place):
            return
        self._place = now
        trial, test = self._planes.copy(), self._planes.copy()
        for k, rows, surface in self._surfaces:
            here = surface.values(x[rows] * self._metre)
            there = surface.values((x[rows] + self.sign * u[rows]) * self._metre)
            sizes = np.linalg.norm(there.gradient, axis=1)
            with np.errstate(all="ignore"):
                at_mesh = here.gradient / np.linalg.norm(here.gradient, axis=1)[:, None]
                normals, values = there.gradient / sizes[:, None], (there.value - here.value) / sizes / self._metre
                bends = there.hessian * (self._metre / sizes[:, None, None])
            # Where g has no value, the constraint has none either, and the solve ends; directions stay finite.
            at_mesh, normals = (
                np.where(np.isfinite(n).all(axis=1)[:, None], n, self._planes[rows, k]) for n in (at_mesh, normals)
            )
            trial[rows, k] = self.sign * normals
            test[rows, k] = trial[rows, k] if self.sign > 0 else -at_mesh
            self._offsets[rows, k] = values - np.einsum("ni,ni->n", trial[rows, k], u[rows])
            self._curvatures[rows, k] = bends if self.sign > 0 else 0.0
        self._set_directions(trial, trial if self.sign > 0 else test)

    def values(self, x: Floats | None) -> Floats:
        """Return the constraints ``c`` (nodes, slides) for displacements among all local unknowns.

        Args:
            x: ``None`` for rates at the state, whose constraints are zero.
        """
        u = (self._unknowns.state.x.array if x is None else x)[self.dofs]
        self._locate(u)
        if x is None:
            return np.zeros_like(self._offsets)
        values: Floats = self._offsets + np.einsum("nkj,nj->nk", self._trial, u)
        return values

    def missing(self, prescribed: Floats, values: Floats | float) -> Floats:
        """Return what displacements lack of the constraints, (nodes, 3).

        Args:
            prescribed: local unknowns that are to be added to the displacements; only fixed ones count.
            values: constraints of the displacements, (nodes, slides).
        """
        u = np.where(self._is_fixed, prescribed[self.dofs], 0.0)
        lacking = np.einsum("nkj,nj->nk", self._trial, u) + values
        missing: Floats = -np.einsum("nik,nk->ni", self._trial_inverse, lacking)
        return missing

    def disagreement(self, prescribed: Floats) -> Floats:
        """Return how far prescribed displacements leave the slides, (nodes,), whatever the free ones are."""
        fixed = np.zeros_like(prescribed)
        fixed[self.dofs] = np.where(self._is_fixed, prescribed[self.dofs], 0.0)
        left = self.values(fixed)
        left += np.einsum("nkj,nj->nk", self._free_trial, self.missing(np.zeros_like(fixed), left))
        distances: Floats = np.abs(left).max(axis=1, initial=0.0)
        return distances

    def held(
        self,
        values: npt.NDArray[np.floating[Any]],
        regions: Collection[str] | None = None,
        *,
        displacements: bool = False,
    ) -> tuple[LocalIndices, Floats]:
        """Return unknowns (n, 3) of nodes among ``values``, and the held part of the values there.

        Args:
            regions: of the slides whose directions count; by default all.
            displacements: whether the values are displacements, not forces.
        """
        self._locate(self._unknowns.state.x.array[self.dofs])
        directions = self._free_trial if displacements else self._free_test
        inverse = self._trial_inverse if displacements else self._test_inverse
        inside = (self.dofs < len(values)).all(axis=1)
        dofs, values_there = self.dofs[inside], values[self.dofs[inside]]
        sizes: Any = np.einsum("nik,ni->nk", inverse[inside], values_there)
        if regions is not None:
            sizes *= [region in regions for region in self._regions]
        return dofs, np.einsum("nk,nki->ni", sizes, directions[inside])

    def row_values(self, values: Floats) -> tuple[LocalIndices, Floats]:
        """Return all unknowns (nodes, 3), and what the matrix makes there of local displacements that are missing."""
        u = values[self.dofs]
        rows = np.einsum("nik,nkj,nj->ni", self._test_inverse, self._free_trial, np.where(self._is_fixed, 0.0, u))
        return self.dofs, np.where(self._is_fixed, u, rows)

    def blocks(self, forces: Floats | None) -> tuple[Floats, Floats, Floats]:
        """Return ``I - Q``, ``I - P`` and what is added to ``Q K P``, (nodes, 3, 3).

        Args:
            forces: of the owned unknowns; ``None`` on planes.
        """
        self._locate(self._unknowns.state.x.array[self.dofs])
        test, trial = self._test_inverse @ self._free_test, self._trial_inverse @ self._free_trial
        added = self._test_inverse @ self._free_trial
        if forces is not None:
            owned = (self.dofs < len(forces)).all(axis=1)
            reactions = np.einsum("nik,ni->nk", self._test_inverse[owned], forces[self.dofs[owned]])
            bend = np.einsum("nk,nkij->nij", reactions, self._curvatures[owned])
            free = ~self._is_fixed[owned]
            bend *= free[:, :, None] & free[:, None, :]
            added[owned] -= (np.eye(3) - test[owned]) @ bend @ (np.eye(3) - trial[owned])
        return test, trial, added


def _without_small(directions: Floats) -> Floats:
    directions[np.linalg.norm(directions, axis=2) < _PARALLEL] = 0.0
    return directions


def _inverses(directions: Floats) -> Floats:
    """Return pseudo-inverses (n, 3, k) of directions (n, k, 3), which are zero or much longer than rounding errors."""
    if directions.shape[1] > 1:
        return np.asarray(np.linalg.pinv(directions, rcond=_PARALLEL), dtype=np.float64)
    squares = (directions**2).sum(axis=2, keepdims=True)
    return np.asarray((directions / np.where(squares > 0, squares, 1.0)).transpose(0, 2, 1))


class MatrixConstraint:
    """``K ← Q K P + A`` of one matrix, which keeps its pattern; the blocks are `Sliding.blocks`."""

    def __init__(self, matrix: PETSc.Mat, sliding: Sliding) -> None:
        self._matrix, self._sliding = matrix, sliding
        self._inside = (sliding.dofs < matrix.getLocalSize()[0]).all(axis=1)
        self._created: dict[str, PETSc.Mat] = {}

    def apply(self, forces: Floats | None = None) -> None:
        """Constrain the matrix as it is assembled now; collective.

        Args:
            forces: nodal forces without reactions, of the owned unknowns; needed on curved surfaces only.
        """
        known, sliding = self._created, self._sliding
        is_new = not known
        if is_new or sliding.is_curved:
            test, trial, added = (blocks[self._inside] for blocks in sliding.blocks(forces))
            self._set("P", np.eye(3) - trial, 1.0)
            self._set("A", added, 0.0)
            if not sliding.is_symmetric:
                self._set("Q", np.eye(3) - test, 1.0)
        if sliding.is_symmetric:
            known["product"] = self._matrix.PtAP(known["P"], result=known.get("product"))
        else:
            known["KP"] = self._matrix.matMult(known["P"], result=known.get("KP"))
            known["product"] = known["Q"].matMult(known["KP"], result=known.get("product"))
        known["product"].axpy(1.0, known["A"], _SUBSET)
        # MatCopy would take the prefix of the options from the matrix, and with it the determinant.
        self._matrix.setValuesCSR(*known["product"].getValuesCSR())
        self._matrix.assemble()

    def _set(self, name: str, blocks: Floats, elsewhere: float) -> None:
        """Set a matrix to ``blocks`` at the nodes, and to a multiple of the identity elsewhere."""
        dofs, (first, last) = self._sliding.dofs[self._inside], self._matrix.getOwnershipRange()
        counts = np.full(last - first, 1 if elsewhere else 0, dtype=PETSc.IntType)
        counts[dofs] = 3
        starts: Any = np.concatenate([[0], np.cumsum(counts)]).astype(PETSc.IntType)
        columns: Any = np.repeat(np.arange(first, last, dtype=PETSc.IntType), counts)
        values: Any = np.full(len(columns), elsewhere)
        places = starts[dofs][:, :, None] + np.arange(3)
        columns[places] = first + dofs[:, None]
        values[places] = blocks
        if name in self._created:
            self._created[name].setValuesCSR(starts, columns, values)
            self._created[name].assemble()
        else:
            size, comm = self._matrix.getSizes(), self._matrix.getComm()
            self._created[name] = PETSc.Mat().createAIJ(size, csr=(starts, columns, values), comm=comm)

    def destroy(self) -> None:
        """Free PETSc objects."""
        for matrix in self._created.values():
            matrix.destroy()
