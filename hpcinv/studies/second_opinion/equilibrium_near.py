"""Equilibrium of a loaded rest shape next to given places, also with hexahedra that have 20 nodes on their edges.

With ``u = T v`` of the displacements v on edges, our residual R and tangent K of 27 nodes give Newton's iteration
``Tᵀ K T Δv = -Tᵀ R(T v)`` of elements with 20 nodes: T has their shape functions at the other nodes. For all other
elements T is the identity.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc
from scipy import sparse

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.job.job import Job
from hpcinv.mesh import build_body
from hpcinv.mesh.cells import scalar_element
from hpcinv.mesh.refine.degree import centre_weights, serendipity
from hpcinv.mesh.source import Floats, Ints, MeshSource
from hpcinv.model.assembly.system import System
from hpcinv.solver.equations import Equations
from hpcinv.studies.second_opinion.slides import Slide

_MOST_STEPS = 12
_PARALLEL = 1e-6
"""Sine of the angle below which directions are the same; raised, nearly parallel planes hold one direction only."""
_SETTLED = 1e-10
"""Newton step, relative to the largest displacement, after which it ends. Raised, fewer digits can be compared."""


def equilibrium_near(
    job: Job, rest: MeshSource, start: Floats, slides: Sequence[Slide] = (), *, has_20_nodes: bool
) -> Floats | None:
    """Return the places (n, 3), m, of a loaded body in equilibrium; ``None`` if Newton's iteration fails.

    Args:
        job: a forward analysis of the displacement alone, with supports along axes that do not move.
        rest: the rest shape, with the degree of the displacement.
        start: places (n, 3), m, near to it.
        slides: planes in which nodes of the rest shape stay, which are not supports of the job.
        has_20_nodes: whether cells of degree 2, hexahedra, have displacements of nodes on edges alone.
    """
    mesh = dataclasses.replace(rest, points=serendipity(rest.kind, rest.cells, rest.points)) if has_20_nodes else rest
    body = build_body(job.mesh, job.regions, MPI.COMM_SELF, resolve=job.resolve, degree=rest.degree, replacement=mesh)
    equations = Equations(job, body, Timings())
    system = System(equations.weak_form("forward"), equations.supports, Timings())
    nodes = body.mesh.geometry.input_global_indices[body.mesh.geometry.dofmaps[0]]
    cells = equations.unknowns.displacement_space.dofmap.list
    file_nodes = np.empty(len(rest.points), dtype=np.int64)
    file_nodes[cells] = nodes
    count = len(rest.points)
    interpolation = _interpolation(rest.kind, cells, count) if has_20_nodes else sparse.eye(3 * count, format="csc")
    is_free = np.ones(3 * count)
    equations.supports.free(is_free)
    unknowns = _unknowns((is_free > 0) & (interpolation.diagonal() > 0), slides, file_nodes)
    to_all = (interpolation @ unknowns).tocsr()
    length = equations.scales.length
    values = unknowns.T @ (start - body.source.points)[file_nodes].ravel() / length
    for _ in range(_MOST_STEPS):
        equations.put_displacement(to_all @ values)
        system.linearise(1.0)
        if system.fault() is not None:
            return None
        system.residual(system.rhs)
        step = _solved(to_all, system.matrix, system.rhs.array)
        values -= step
        if np.abs(step).max() <= _SETTLED * np.abs(values).max():
            places = body.source.points.copy()
            places[file_nodes] += length * (to_all @ values).reshape(-1, 3)
            return places
    return None


def _interpolation(kind: str, cells: Ints, count: int) -> sparse.csc_matrix:
    """Return T, with rows and columns for displacements at all nodes; columns of nodes in faces and cells are zero."""
    weights = np.eye(scalar_element(kind, 2).dim)
    for node, row in centre_weights(kind):
        weights[node] = row
    rows, columns = (
        np.broadcast_to(part, (len(cells), *weights.shape)) for part in (cells[:, :, None], cells[:, None])
    )
    values = np.broadcast_to(weights, rows.shape)
    used = values != 0.0
    places = np.stack([rows[used], columns[used]])
    distinct, first = np.unique(places, axis=1, return_index=True)  # cells agree on the nodes that they share
    matrix = sparse.coo_matrix((values[used][first], distinct), shape=(count, count))
    return sparse.kron(matrix, sparse.eye(3)).tocsc()


def _unknowns(is_free: npt.NDArray[np.bool_], slides: Sequence[Slide], file_nodes: Ints) -> sparse.csc_matrix:
    """Return unit vectors along which nodes move, as columns of displacements (3 n).

    Args:
        is_free: displacements along axes (3 n).
        file_nodes: rows of the nodes (n,) in the mesh.
    """
    directions: dict[int, list[Floats]] = {}
    for slide in slides:
        for row, direction in zip(slide.nodes.tolist(), slide.directions, strict=True):
            directions.setdefault(row, []).append(direction)
    node_of = {int(row): node for node, row in enumerate(file_nodes)}
    columns = sparse.eye(len(is_free), format="lil")
    keeps = is_free.copy()
    for row, held in directions.items():
        node = node_of[row]
        own = slice(3 * node, 3 * node + 3)
        axes = np.eye(3)[~is_free[own]]
        _, sizes, turned = np.linalg.svd(np.vstack([*held, *axes]))
        rank = int((sizes > _PARALLEL * sizes[0]).sum())
        columns[own, own] = turned.T
        keeps[own] = np.arange(3) >= rank
    return columns.tocsc()[:, np.flatnonzero(keeps)]


def _solved(to_all: sparse.csr_matrix, tangent: PETSc.Mat, residual: Floats) -> Floats:
    indices, columns, entries = tangent.getValuesCSR()
    matrix = (to_all.T @ sparse.csr_matrix((entries, columns, indices)) @ to_all).tocsr()
    matrix.sort_indices()
    left = PETSc.Mat().createAIJ(matrix.shape, csr=(matrix.indptr, matrix.indices, matrix.data), comm=PETSc.COMM_SELF)
    solver = PETSc.KSP().create(PETSc.COMM_SELF)
    solver.setOperators(left)
    solver.setType("preonly")
    solver.pc.setType("lu")
    solver.pc.setFactorSolverType("mumps")
    right, found = left.createVecRight(), left.createVecRight()
    right.array[:] = to_all.T @ residual
    solver.solve(right, found)
    step: Floats = found.array.copy()
    solver.destroy()
    left.destroy()
    return step
