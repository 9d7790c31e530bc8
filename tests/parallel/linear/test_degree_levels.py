"""Multigrid by degree on curved cells: rotations are in the coarse space, and a curved beam needs few iterations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from helpers.linear_cases import MATERIALS
from helpers.silicone_beam import beam
from helpers.verification import box, job

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.mesh import build_body
from hpcinv.model.assembly.system import System
from hpcinv.model.rigid_motions import Frame
from hpcinv.solver.equations import Equations
from hpcinv.solver.linear import degree_levels
from hpcinv.solver.linear.degree_levels import DegreeLevels
from hpcinv.solver.linear.selection import Choice
from hpcinv.solver.linear_solver import LinearSolver

type Floats = np.ndarray[Any, np.dtype[np.float64]]


def unloaded(comm: MPI.Intracomm, data: dict[str, Any]) -> tuple[Equations, System]:
    """The equations of an unloaded body, and its tangent."""
    inverse = job(**data, analysis="inverse")
    body = build_body(inverse.mesh, inverse.regions, comm, resolve=inverse.resolve)
    model = Equations(inverse, body, Timings())
    system = System(model.weak_form("inverse"), model.supports, Timings())
    system.linearise(1.0)
    return model, system


def rotations(points: Floats) -> list[Floats]:
    return [motion.ravel() for motion in np.moveaxis(Frame(np.zeros(3), 1.0).motions(points), 2, 0)]


@pytest.mark.everyday("-incompressible")
@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("material", ["compressible", "incompressible"])
def test_coarse_displacements_contain_the_rigid_motions_of_curved_cells(material: str, comm: MPI.Intracomm) -> None:
    model, system = unloaded(comm, {**beam(), "material": MATERIALS[material]})
    unknowns, interpolation = model.unknowns, DegreeLevels(model.weak_form("inverse")).interpolation(system.matrix)
    vertices = fem.functionspace(unknowns.mesh, ("Lagrange", 1, (3,)))
    owned = vertices.dofmap.index_map.size_local
    coarse, fine = interpolation.createVecRight(), interpolation.createVecLeft()
    nodes, dofs = unknowns.owned_displacement_points(), unknowns.owned_displacement_dofs
    corners = vertices.tabulate_dof_coordinates()[:owned]
    clamped = comm.allreduce(float(nodes[:, 0].min(initial=np.inf)), op=MPI.MIN)
    beyond = np.repeat(nodes[:, 0] > clamped + 0.2, 3)  # where no cell has a clamped vertex; in scaled lengths
    assert comm.allreduce(int(beyond.sum())) > 0.5 * comm.allreduce(beyond.size)
    for motion, expected in zip(rotations(corners), rotations(nodes), strict=True):
        coarse.array[:] = motion
        interpolation.mult(coarse, fine)
        np.testing.assert_allclose(fine.array[dofs][beyond], expected[beyond], atol=1e-12)


def iterations(comm: MPI.Intracomm, **data: Any) -> int:
    """Krylov iterations for the first correction."""
    _, system = unloaded(comm, data)
    linear = LinearSolver(system, {}, Choice("iterative", ""))
    linear.factorize()
    system.residual(system.rhs)
    x = system.rhs.duplicate()
    assert linear.back_substitute(system.rhs, x)
    number = linear.take_iterations()
    linear.destroy()
    system.destroy()
    return number


@pytest.mark.release
@pytest.mark.parallel([2, 1])
def test_curved_cells_need_as_many_iterations_as_straight_ones(comm: MPI.Intracomm) -> None:
    straight, curved = (iterations(comm, **beam(geometry_degree=degree)) for degree in (1, 2))
    print(f"{straight} iterations on straight cells, {curved} on curved ones")
    assert curved < 1.2 * straight


@pytest.mark.release
@pytest.mark.parallel([2, 1])
def test_bodies_that_only_their_pressure_keeps_from_swelling_converge(comm: MPI.Intracomm) -> None:
    """Without pressures, the tangent of an incompressible bar on three planes maps its dilatation to nothing."""
    effects = [{"effect": "pressure", "region": "x1", "pressure": -100}]
    bar = {"mesh": box((24, 2, 2), lx=12.0), "material": MATERIALS["incompressible"], "effects": effects}
    planes = [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"]
    clamped = iterations(comm, **bar, supports=[{"region": "x0", "fix": ["x", "y", "z"]}])
    assert iterations(comm, **bar, supports=planes) <= clamped


@pytest.mark.release
@pytest.mark.parallel([1, 2])
def test_incompressible_cubes_need_less_than_twice_the_iterations_of_compressible_ones(comm: MPI.Intracomm) -> None:
    cube = {"mesh": box((5, 5, 5)), "supports": [{"region": "z0", "fix": ["x", "y", "z"]}]}
    cube["effects"] = [{"effect": "gravity", "acceleration": [0, 0, -0.5], "density": 1000}]
    compressible, incompressible = (
        iterations(comm, **cube, material=MATERIALS[name]) for name in ("compressible", "incompressible")
    )
    print(f"{compressible} iterations compressible, {incompressible} incompressible")
    assert incompressible < 2 * compressible  # 13 and 8; 17 by the diagonal of the pressures' mass matrix


def test_a_coarse_level_that_is_too_large_for_factors_takes_multigrid(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    cube = {"mesh": box((3, 3, 3)), "supports": [{"region": "z0", "fix": ["x", "y", "z"]}]}
    cube["effects"] = [{"effect": "gravity", "acceleration": [0, 0, -0.5], "density": 1000}]
    cube["material"] = MATERIALS["compressible"]
    counts, kinds = list[int](), list[str]()
    for operations in (np.inf, 0.0):
        monkeypatch.setattr(degree_levels, "_FEW_OPERATIONS", operations)
        _, system = unloaded(comm, cube)
        kinds.append(str(DegreeLevels(system.weak_form).options["mg_coarse_pc_type"]))
        system.destroy()
        counts.append(iterations(comm, **cube))
    assert kinds == ["lu", "gamg"]
    assert counts[0] <= counts[1] < 2 * counts[0]  # 6 and 7


@pytest.mark.parametrize("divisions", [1, 2])
def test_prescribed_vertices_are_alone_in_their_coarse_rows(divisions: int, comm: MPI.Intracomm) -> None:
    held = [{"region": "boundary", "fix": ["x", "y", "z"]}]
    block = {"mesh": box((divisions,) * 3), "material": MATERIALS["compressible"], "supports": held}
    model, system = unloaded(comm, {**block, "effects": []})
    interpolation = DegreeLevels(model.weak_form("inverse")).interpolation(system.matrix)
    coarse = system.matrix.ptap(interpolation).convert("dense").getDenseArray()
    free = 3 * (divisions - 1) ** 3  # inner vertices
    assert np.count_nonzero(np.abs(coarse - np.eye(len(coarse))).max(axis=1)) == free
