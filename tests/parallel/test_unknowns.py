"""Displacement and pressure taken out of the mixed space and put back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dolfinx import fem
from helpers.mesh_cases import spec

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh import build_body
from hpcinv.model.spaces import Unknowns


@pytest.mark.parallel([1, 2])
def test_parts_of_the_mixed_space_are_the_functions_that_they_seem(comm: MPI.Intracomm, meshes: Path) -> None:
    """Polynomials of the spaces' degrees between the nodes, on tetrahedra whose edges point in any direction."""

    def u(x: np.ndarray) -> np.ndarray:
        return np.stack([x[0] ** 3 - x[1] * x[2] ** 2, x[0] * x[1] * x[2], 1 + x[2] ** 3])

    def p(x: np.ndarray) -> np.ndarray:
        return np.asarray(x[0] * x[1] - x[2] ** 2)

    body = build_body(spec(meshes / "pdms_beam.py", parameters={"size": "4 mm", "length": "20 mm"}), {}, comm)
    mesh = body.mesh
    for displacement, pressure in ((3, 2), (4, 3)):
        unknowns = Unknowns(mesh, displacement, pressure)
        unknowns.state.sub(0).interpolate(u)
        unknowns.state.sub(1).interpolate(p)
        cells = np.arange(mesh.topology.index_map(3).size_local, dtype=np.int32)
        corners = mesh.geometry.x[mesh.geometry.dofmaps[0][cells]]
        inside = np.einsum("v,cvi->ci", [0.1, 0.2, 0.3, 0.4], corners)
        taken, pressures = unknowns.displacement(), unknowns.pressure()
        assert pressures is not None
        for part_values, exact in ((taken, u), (pressures, p)):
            values = part_values.eval(inside, cells)
            assert np.abs(values - exact(inside.T).reshape(-1, len(cells)).T).max() < 1e-13
        before = unknowns.state.x.array.copy()
        unknowns.state.x.array[:] = np.nan
        for function, exact, put in ((taken, u, unknowns.set_displacement), (pressures, p, unknowns.set_pressure)):
            again = fem.Function(function.function_space)
            again.interpolate(exact)
            put(again.x.array)
        assert np.abs(unknowns.state.x.array - before).max() < 1e-14
