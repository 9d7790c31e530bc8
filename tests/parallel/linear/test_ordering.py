"""Ordering of the nodes of a tangent instead of its unknowns."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dolfinx.mesh import CellType, create_unit_cube
from helpers.verification import box, job
from petsc4py import PETSc

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.mesh import build_body
from hpcinv.model.assembly.system import System
from hpcinv.model.spaces import Unknowns
from hpcinv.solver.equations import Equations
from hpcinv.solver.linear import factorization

MIXED: dict[str, Any] = {
    "analysis": "forward",
    "mesh": box((3, 2, 2)),
    "material": {"law": "mooney-rivlin", "c1": "10 kPa", "c2": "5 kPa", "d1": "1 MPa"},
    "supports": [{"region": "x0", "fix": ["x", "y", "z"]}],
}
CASES: dict[str, dict[str, Any]] = {
    "mixed": MIXED,
    "hexahedra": MIXED | {"mesh": box((2, 2, 2), hexahedra=True)},
    "cubic": MIXED | {"mesh": box((2, 1, 1)), "discretisation": {"displacement": 3, "pressure": 2}},
    "displacements": MIXED | {"material": {"law": "neo-hookean", "mu": "10 kPa", "lam": "40 kPa"}},
}


def model_of(data: dict[str, Any], comm: MPI.Intracomm) -> Equations:
    given = job(**data)
    return Equations(given, build_body(given.mesh, given.regions, comm, resolve=given.resolve), Timings())


def places_of(unknowns: Unknowns) -> np.ndarray:
    """Coordinates of all unknowns of all ranks, by their global numbers, and 1 for pressures."""
    positions = np.zeros((len(unknowns.state.x.array), 4))
    spaces = [unknowns.displacement_space, *([] if unknowns.p is None else [unknowns.pressure_space])]
    for part, (dofs, space) in enumerate(zip(unknowns.dofs_of_cells(), spaces, strict=True)):
        positions[dofs, :3] = space.tabulate_dof_coordinates()[space.dofmap.list][:, :, None]
        positions[dofs, 3] = part
    dofmap = unknowns.space.dofmap
    owned = positions[: dofmap.index_map.size_local * dofmap.index_map_bs]
    return np.concatenate(unknowns.mesh.comm.allgather(owned))


@pytest.mark.parallel([1, 2, 3])
@pytest.mark.parametrize(
    ("cell", "degrees"),
    [("tetrahedron", (2, 1)), ("hexahedron", (2, 1)), ("tetrahedron", (3, 2)), ("tetrahedron", (2, None))],
)
def test_nodes_have_all_unknowns_of_a_vertex(cell: str, degrees: tuple[int, int | None], comm: MPI.Intracomm) -> None:
    unknowns = Unknowns(create_unit_cube(comm, 3, 2, 2, CellType[cell]), *degrees)
    order, starts = unknowns.nodes
    assert np.array_equal(np.sort(order), np.arange(unknowns.size))
    assert starts[0] == 0
    assert starts[-1] == unknowns.size
    places = places_of(unknowns)
    nodes = np.split(order, starts[1:-1])
    assert all(np.allclose(places[node, :3], places[node[0], :3]) for node in nodes)
    displacements = [node for node in nodes if not places[node, 3].all()]
    assert all(np.count_nonzero(places[node, 3] == 0) == 3 for node in displacements)
    with_pressure = sum(bool(places[node, 3].any()) for node in displacements)
    vertices = unknowns.mesh.topology.index_map(0).size_global
    assert with_pressure == (0 if unknowns.p is None else vertices)


@pytest.mark.everyday("mixed-cholesky", "hexahedra-lu")
@pytest.mark.parallel([1, 3, 2])
@pytest.mark.parametrize("kind", [PETSc.PC.Type.CHOLESKY, PETSc.PC.Type.LU])
@pytest.mark.parametrize("name", ["mixed", "hexahedra", "cubic"])
def test_factors_are_right_and_no_larger(name: str, kind: str, comm: MPI.Intracomm) -> None:
    """The entries of the factors, which METIS's randomness changes by some per cent, and a solution."""
    model = model_of(CASES[name], comm)
    system = System(model.weak_form("forward"), model.supports, Timings())
    system.linearise(1.0)
    option: Any = PETSc.Mat.Option.SYMMETRIC
    system.matrix.setOption(option, True)
    b, x = system.matrix.createVecs()
    b.array[:] = np.random.default_rng(comm.rank).normal(size=b.local_size)
    size, entries = b.norm(), []
    for by_nodes in (False, True):
        ksp = PETSc.KSP().create(comm)
        ksp.setOperators(system.matrix)
        ksp.setType(PETSc.KSP.Type.PREONLY)
        ksp.pc.setType(kind)
        ksp.pc.setFactorSolverType("mumps")
        ksp.pc.setFactorSetUpSolverType()
        factors = ksp.pc.getFactorMatrix()
        factors.setMumpsIcntl(7, 5)  # METIS at any size
        if by_nodes:
            factorization.order_by_nodes(factors, model.unknowns)
        ksp.solve(b, x)
        assert by_nodes == (factors.getMumpsIcntl(15) == 1)
        entries.append(factors.getMumpsInfog(29))
        assert factors.getMumpsInfog(7) == 5
        residual = system.matrix * x - b
        assert residual.norm() < 1e-10 * size
        ksp.destroy()
    print(name, entries)
    assert entries[1] < 1.5 * entries[0]


def test_petsc_orders_blocks_of_displacements(comm: MPI.Intracomm) -> None:
    """By the block size of the matrix, where there are no pressures."""
    model = model_of(CASES["displacements"], comm)
    equilibrium = model.equilibrium(model.weak_form("forward"))
    equilibrium.correct(1.0)
    assert equilibrium.linear.ksp.pc.getFactorMatrix().getMumpsIcntl(15) == -3
    equilibrium.destroy()


def test_a_petsc_without_our_ordering_orders_unknowns_itself(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that lacks the function."""
    monkeypatch.setattr(factorization, "petsc_function", lambda name: None)
    model = model_of(MIXED, comm)
    equilibrium = model.equilibrium(model.weak_form("forward"))
    equilibrium.correct(1.0)
    assert equilibrium.linear.ksp.pc.getFactorMatrix().getMumpsIcntl(15) == 0
    equilibrium.destroy()


@pytest.mark.parametrize(("options", "expected"), [({}, 1), ({"mat_mumps_icntl_15": 0}, 0)])
def test_options_of_the_job_prevail(options: dict[str, Any], expected: int, comm: MPI.Intracomm) -> None:
    model = model_of(MIXED | {"solver": {"petsc": options}}, comm)
    equilibrium = model.equilibrium(model.weak_form("forward"))
    equilibrium.correct(1.0)
    assert equilibrium.linear.ksp.pc.getFactorMatrix().getMumpsIcntl(15) == expected
    equilibrium.destroy()
