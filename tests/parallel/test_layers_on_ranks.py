"""Spaces of pressures that jump between layers: numbering, stability, checkpoints and transfer between meshes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import CellType, GhostMode, Mesh, compute_midpoints, create_unit_cube, locate_entities_boundary
from helpers.solutions import SOLVES
from helpers.verification import Solved, box, job
from scipy.linalg import eigh
from scipy.sparse.linalg import splu

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.mesh import build_body
from hpcinv.model.cell_layers import layers_of_cells
from hpcinv.model.spaces import Unknowns
from hpcinv.output.checkpoint import Checkpoints, Position
from hpcinv.results.solution import solution_of
from hpcinv.solver.equations import Equations
from hpcinv.solver.methods.nested_iteration import _transferred
from hpcinv.solver.workspace import Workspace
from hpcinv.trust.accuracy.trial import guess_from

CELLS = pytest.mark.parametrize("cell", [CellType.tetrahedron, CellType.hexahedron], ids=lambda cell: cell.name)
LAYERED = {
    name: {"law": "isochoric-neo-hookean", "mu": mu, "kappa": "incompressible"}
    for name, mu in (("lower", "10 kPa"), ("elsewhere", "30 kPa"))
}


def middles(mesh: Mesh) -> np.ndarray:
    cells = mesh.topology.index_map(3)
    return compute_midpoints(mesh, 3, np.arange(cells.size_local + cells.num_ghosts, dtype=np.int32))


def scattered(mesh: Mesh) -> np.ndarray:
    """Three layers whose cells lie here and there, and touch in vertices and edges."""
    return (np.floor(middles(mesh) @ [7.1, 13.3, 29.7]) % 3).astype(np.int64)


@pytest.mark.everyday("hexahedron-none")
@pytest.mark.parallel([1, 3])
@pytest.mark.parametrize("ghosts", [GhostMode.none, GhostMode.shared_facet], ids=lambda mode: mode.name)
@CELLS
def test_each_layer_has_its_own_pressure_at_each_node(cell: CellType, ghosts: GhostMode, comm: MPI.Intracomm) -> None:
    def value(x: np.ndarray) -> np.ndarray:
        return x @ [1.0, 10.0, 100.0]

    mesh = create_unit_cube(comm, 3, 2, 3, cell, ghost_mode=ghosts)
    layers, owned = scattered(mesh), mesh.topology.index_map(3).size_local
    for degrees in ((2, 1), (3, 2), (4, 3)):
        unknowns = Unknowns(mesh, *degrees, layers)
        space, points = unknowns.pressure_space, unknowns.pressure_space.tabulate_dof_coordinates()
        dofs = space.dofmap.list
        nodes = {(*np.round(points[d], 8), layers[c]) for c in range(owned) for d in dofs[c]}
        assert unknowns.pressure_size == len(set().union(*comm.allgather(nodes)))
        p = fem.Function(space)
        p.x.array[dofs] = layers[:, None]
        assert (p.x.array[dofs] == layers[:, None]).all()  # none belongs to two layers
        p.x.array[dofs] = 1000 * layers[:, None] + value(points[dofs])
        expected = p.x.array.copy()
        p.x.scatter_forward()
        assert np.abs(p.x.array - expected).max() < 1e-12  # the owner has the same
        unknowns.set_pressure(p.x.array)
        unknowns.state.x.scatter_forward()
        assert np.abs(unknowns.state.x.array[unknowns.dofs_of_cells()[1][:, :, 0]] - expected[dofs]).max() < 1e-12
        assert comm.allreduce(len(unknowns.owned_pressure_dofs)) == unknowns.pressure_size
        assert unknowns.has_whole_nodes


def smallest_inf_sup(mesh: Mesh, layers: np.ndarray | None) -> float:
    """Constant of the Taylor–Hood pair of degree 2 on a body that is fixed at z = 0."""
    unknowns = Unknowns(mesh, 2, 1, layers)
    u, p = ufl.split(ufl.TrialFunction(unknowns.space))
    v, q = unknowns.v, unknowns.q
    strains = ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v)))
    matrix = fem.assemble_matrix(fem.form((strains - q * ufl.div(u) + p * q) * ufl.dx)).to_scipy().tocsr()
    facets = locate_entities_boundary(mesh, 2, lambda x: np.isclose(x[2], 0))
    held = [fem.locate_dofs_topological(unknowns.displacement_component(i), 2, facets) for i in range(3)]
    free, pressures = np.setdiff1d(unknowns.owned_displacement_dofs, np.concatenate(held)), unknowns.owned_pressure_dofs
    B, mass = matrix[pressures][:, free], matrix[pressures][:, pressures]
    schur = B @ splu(matrix[free][:, free].tocsc()).solve(B.T.toarray())
    return float(eigh(schur, mass.toarray(), eigvals_only=True)[0].clip(min=0.0) ** 0.5)


@CELLS
def test_layers_are_inf_sup_stable_whatever_their_shape(cell: CellType, comm: MPI.Intracomm) -> None:
    """Layers of one cell lose nothing; even where each cell has a layer of its own the pressures are held."""
    mesh = create_unit_cube(comm, 3, 3, 3, cell)
    points, random = middles(mesh), np.random.default_rng(0)
    whole = smallest_inf_sup(mesh, None)
    layered = smallest_inf_sup(mesh, np.floor(3 * points[:, 2]).astype(np.int64))
    others = {
        "cubes": np.floor(3 * points) @ [1, 3, 9],
        "all": np.arange(len(points)),
        **{f"random {n}": random.integers(0, n, len(points)) for n in (2, 4, 10)},
    }
    constants = {name: smallest_inf_sup(mesh, layers.astype(np.int64)) for name, layers in others.items()}
    print(f"{whole:.3f} whole, {layered:.3f} in layers, {constants}")
    assert layered > 0.9 * whole
    assert min(constants.values()) > 0.15


def lying(pieces: int, comm: MPI.Intracomm, *, hexahedra: bool, **changes: Any) -> Any:
    """A block of two layers with different moduli."""
    data: dict[str, Any] = {
        "analysis": "forward",
        "mesh": box((2, 2, pieces), lx="1 m", ly="1 m", lz="1 m", hexahedra=hexahedra),
        "regions": {"lower": "z < 0.51 m"},
        "material": LAYERED,
        "effects": [{"effect": "traction", "region": "x1", "traction": [2e3, 0, 0], "area_in": "reference"}],
        "supports": [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"],
    }
    return job(**data | changes)


def jumping(layers: np.ndarray) -> Callable[[np.ndarray, int], np.ndarray]:
    """A linear pressure in each layer."""
    numbers = np.unique(layers)
    return lambda x, layer: np.asarray((1 + np.searchsorted(numbers, layer)) * (2 - x[:, 0] + 3 * x[:, 2]))


def filled(space: fem.FunctionSpace, layers: np.ndarray) -> fem.Function:
    """That pressure, in m."""
    positions, points, pressure = fem.Function(space), space.tabulate_dof_coordinates(), jumping(np.array([0, 1]))
    for layer in (0, 1):
        dofs = np.unique(space.dofmap.list[layers == layer])
        positions.x.array[dofs] = pressure(points[dofs], layer)
    return positions


@pytest.mark.release
@pytest.mark.parallel(3)
@pytest.mark.parametrize("hexahedra", [True, False], ids=["hexahedra", "tetrahedra"])
def test_a_checkpoint_keeps_both_sides_of_the_interface(
    hexahedra: bool, comm: MPI.Intracomm, run_directory: Path
) -> None:
    """Written on two ranks, it reads the same on one and three."""
    layered = lying(4, comm, hexahedra=hexahedra)

    def pressure(some: MPI.Intracomm, *, zero: bool) -> fem.Function:
        body = build_body(layered.mesh, layered.regions, some, resolve=layered.resolve)
        layers = layers_of_cells(layered, body)
        assert layers is not None
        space = Unknowns(body.mesh, 3, 2, layers).pressure_space
        return fem.Function(space) if zero else filled(space, layers)

    two = comm.Split(0 if comm.rank < 2 else 1)
    if comm.rank < 2:
        Checkpoints(run_directory, two, {}, keep=2).write(
            Position(0, 0.5, (SOLVES,)), {"pressure-0": pressure(two, zero=False)}
        )
    comm.Barrier()
    for some in (comm, MPI.COMM_SELF):
        restart = Checkpoints(run_directory, some, {}, keep=2).latest()
        assert restart is not None
        read, expected = pressure(some, zero=True), pressure(some, zero=False)
        restart.read("pressure-0", read)
        np.testing.assert_allclose(read.x.array, expected.x.array, rtol=0, atol=1e-13)


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("way", ["nested iteration", "accuracy"])
def test_a_pressure_comes_from_the_same_layer_of_another_mesh(way: str, comm: MPI.Intracomm) -> None:
    """At the interface each side gets its own value."""
    models = []
    for pieces in (2, 4):
        wall = lying(pieces, comm, hexahedra=False)
        body = build_body(wall.mesh, wall.regions, comm, resolve=wall.resolve)
        models.append(Equations(wall, body, Timings()))
    coarse, model = models
    expected = []
    for equations in models:
        layers = equations.unknowns.layers
        assert layers is not None
        expected.append(filled(equations.unknowns.pressure_space, layers))
    coarse.put_fields((coarse.state().displacement, expected[0]))
    if way == "accuracy":
        guess = guess_from(solution_of(coarse, "forward", coarse.weak_form("forward"), ()), coarse.body, model)
    else:
        guess = _transferred(coarse, model, "forward", 0)
    assert guess is not None
    assert guess.pressure is not None
    np.testing.assert_allclose(guess.pressure, expected[1].x.array, rtol=0, atol=1e-9)
    for equations in models:
        equations.destroy()


@pytest.mark.release
@pytest.mark.parallel([1, 2])
def test_iterative_and_direct_solvers_agree(comm: MPI.Intracomm) -> None:
    fields = []
    for linear in ("direct", "iterative"):
        solved = Solved(lying(2, comm, hexahedra=True, solver={"linear": linear}), comm)
        u, p = solved.model.unknowns.u, solved.model.unknowns.p
        fields.append([solved.integral(p**2), solved.integral(ufl.inner(u, u))])
    assert fields[0] == pytest.approx(fields[1], rel=1e-6)


@pytest.mark.release
def test_layers_with_equal_numbers_give_the_result_of_one_material(comm: MPI.Intracomm) -> None:
    """In one process, in any order, each job is what it is by itself, though jobs of one structure share equations."""

    def run(mu: str, workspace: Workspace | None) -> list[float]:
        material = {**LAYERED, "elsewhere": {**LAYERED["elsewhere"], "mu": mu}}
        quantity = {"name": "pull", "of": "ux", "on": "x1", "reduce": "mean"}
        case = lying(2, comm, hexahedra=True, material=material, quantities=[quantity])
        result = hpcinv.run(case, comm, workspace=workspace)
        p = result.solutions[0].pressure
        assert p is not None
        return [result.quantities["pull"], float(len(p.x.array))]

    moduli = ("10 kPa", "30 kPa", "20 kPa", "10 kPa")
    with Workspace(comm) as workspace:
        together = [run(mu, workspace) for mu in moduli]
    assert together[0][1] < together[1][1] == together[2][1]
    assert together == [pytest.approx(run(mu, None), rel=1e-12) for mu in moduli]
