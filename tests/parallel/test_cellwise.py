"""Means over cells and ranges over quadrature points, against formulas for tetrahedra and integrals over a block."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import ufl
from dolfinx import fem
from helpers.mesh_cases import spec
from helpers.solutions import corners

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh import build_body
from hpcinv.mesh.cells import quadrature
from hpcinv.model.quadrature_values import CellMeans, QuadratureValues


@pytest.mark.parallel([1, 2])
def test_means_are_over_the_volume_and_ranges_over_points(comm: MPI.Intracomm, meshes: Path) -> None:
    body = build_body(spec(meshes / "box.py", parameters={"lx": 2.0, "nx": 3, "ny": 2, "nz": 2}), {}, comm)
    x = ufl.SpatialCoordinate(body.mesh) * body.length_scale
    v = corners(body)
    owned = body.mesh.topology.index_map(3).size_local

    # ∫ x xᵀ dV / V = (Σ vᵢ vᵢᵀ + Σvᵢ Σvᵢᵀ) / 20 on a tetrahedron with vertices vᵢ
    means = CellMeans([(ufl.outer(x, x) + ufl.as_matrix([[0, 1, 0]] + 2 * [[0, 0, 0]]), None)], body.mesh, 2)()
    mean_stress = means.x.array.reshape(-1, 3, 3)[means.function_space.dofmap.list[:, 0]]
    total = v.sum(axis=1)
    exact = (np.einsum("cvi,cvj->cij", v, v) + np.einsum("ci,cj->cij", total, total)) / 20
    exact[:, 0, 1] += 1
    assert comm.allreduce(len(mean_stress) == owned > 0 and np.allclose(mean_stress, exact, rtol=1e-13), op=MPI.LAND)

    points, _ = quadrature("tetrahedron", 3)
    barycentric = np.insert(points, 0, 1 - points.sum(axis=1), axis=1)
    mine = np.einsum("qv,cv->cq", barycentric, v[..., 0] - v[..., 1])
    everywhere = np.concatenate(comm.allgather(mine))
    assert QuadratureValues(x[0] - x[1], body.mesh, 3).range() == pytest.approx(
        (everywhere.min(), everywhere.max()), rel=1e-13
    )

    # Curved and distorted inside, the block as a whole is as before; degree 10 integrates x² exactly, as 8/3.
    for hexahedra in (False, True):
        mesh = spec(meshes / "box.py", parameters={"lx": 2.0, "hexahedra": hexahedra}, geometry_degree=2)
        body = build_body(mesh, {}, comm)
        nodes = body.mesh.geometry.x * body.length_scale
        bubble = np.prod(nodes * (np.array([2.0, 1.0, 1.0]) - nodes), axis=1)
        body.mesh.geometry.x[:, 0] += 2.5 * bubble / body.length_scale
        x = ufl.SpatialCoordinate(body.mesh) * body.length_scale
        volumes = fem.assemble_vector(
            fem.form(ufl.TestFunction(fem.functionspace(body.mesh, ("DG", 0))) * ufl.dx(degree=8))
        )
        means = CellMeans([(x[0] ** 2, None)], body.mesh, 12)()
        integral = comm.allreduce(means.x.array @ volumes.array) * body.length_scale**3
        assert integral == pytest.approx(8 / 3, rel=1e-12)
        assert comm.allreduce(np.ptp(volumes.array) > 0.2 * volumes.array.mean(), op=MPI.LOR)  # it is distorted
