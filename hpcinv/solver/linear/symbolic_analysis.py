"""Operations of a factorization, by MUMPS's symbolic analysis of the mesh's vertices.

An eighth of the nodes of degree 2, and a scalar for each, take 5 to 15 times less time than an analysis of the tangent.
Separators of a finer graph on the same cells have more nodes in proportion to (N/n)^(2/3), for N nodes and n vertices.
Operations, which are cubes of them, grow with (N/n)².
"""

import ctypes
from typing import Any

import numpy as np
from dolfinx.mesh import Mesh
from petsc4py import PETSc

from hpcinv.base.parallel.petsc_calls import petsc_function
from hpcinv.model.spaces import Unknowns

_ORDERING = 7  # ICNTL
_MATCHING = 6  # ICNTL(6) permutes columns by values, and there are none
_INFO = 32  # numbers of PETSc's ``MatFactorInfo``: more than it has; MUMPS reads none of them


def operations_of(unknowns: Unknowns, ordering: int) -> float | None:
    """Return about the operations of a factorization L U of the tangent, ``None`` if not known; collective."""
    mesh = unknowns.mesh
    operations = _scalar_operations(mesh, ordering)
    if operations is None:
        return None
    vertices = int(mesh.topology.index_map(0).size_global)
    nodes = int(unknowns.displacement_space.dofmap.index_map.size_global)
    return operations * (nodes / vertices) ** 2 * (unknowns.size / nodes) ** 3


def _scalar_operations(mesh: Mesh, ordering: int) -> float | None:
    function = petsc_function("MatLUFactorSymbolic")
    if function is None:
        return None
    graph = _vertex_graph(mesh)
    pc = PETSc.PC().create(graph.comm)
    try:
        pc.setOperators(graph)
        pc.setType(PETSc.PC.Type.LU)
        pc.setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
        pc.setFactorSetUpSolverType()
        factors = pc.getFactorMatrix()
        factors.setMumpsIcntl(_MATCHING, 0)
        factors.setMumpsIcntl(_ORDERING, ordering)
        info = (ctypes.c_double * _INFO)()
        if function(ctypes.c_void_p(factors.handle), ctypes.c_void_p(graph.handle), None, None, info):
            return None
        return factors.getMumpsRinfog(1) if factors.getMumpsInfog(1) >= 0 else None
    finally:
        pc.destroy()
        graph.destroy()


def _vertex_graph(mesh: Mesh) -> PETSc.Mat:
    """Return a matrix of zeros, with an entry for any two vertices of a cell; collective.

    It has either (i, j) or (j, i), since MUMPS's analysis is of the matrix and its transpose.
    """
    topology = mesh.topology
    vertices, cells = topology.index_map(0), topology.index_map(3).size_local
    corners = topology.connectivity(3, 0).array.reshape(-1, mesh.ufl_cell().num_vertices)[:cells]
    numbers = vertices.local_to_global(corners.ravel()).reshape(corners.shape).astype(PETSc.IntType)
    graph = PETSc.Mat().create(mesh.comm)
    graph.setSizes(((vertices.size_local, vertices.size_global),) * 2)
    graph.setType(PETSc.Mat.Type.AIJ)
    first, second = np.triu_indices(corners.shape[1], 1)
    rows: Any = numbers[:, first].ravel()  # an array, whatever the stub says
    columns: Any = numbers[:, second].ravel()
    graph.setPreallocationCOO(rows, columns)
    graph.assemble()
    return graph
