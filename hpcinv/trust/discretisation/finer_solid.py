"""The finer problem of a solid: spaces of one degree more, on the true geometry where that is known."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import ClassVar

import numpy as np
from dolfinx import fem, la

from hpcinv.job.job import Job
from hpcinv.mesh.cells import jacobians, kind_and_degree, scalar_element
from hpcinv.mesh.checks import CHUNK
from hpcinv.mesh.interpolation import interpolate
from hpcinv.mesh.refine.finer_geometry import transfer_function
from hpcinv.mesh.regions import Mesh
from hpcinv.mesh.source import Floats, Ints
from hpcinv.results.displacement_scale import displacement_scale
from hpcinv.solver.equations import Equations
from hpcinv.solver.linear.cost_model import Forecast
from hpcinv.solver.methods import solve_direction
from hpcinv.solver.methods.method import UNLOADED
from hpcinv.solver.observer import Observer
from hpcinv.trust.discretisation import two_level
from hpcinv.trust.discretisation.estimate import DEGREE_MORE, LINEAR
from hpcinv.trust.discretisation.finer_problem import Budget, FinerProblem, Found, put_with_ghosts

_ROUNDING = 1e-12  # offset of a node, relative to the size of its cell, up to which it counts as in place


class FinerSolid(FinerProblem):
    """A correction in spaces of one degree more; a solve there where that is large."""

    where: ClassVar[str] = DEGREE_MORE

    @staticmethod
    def forecast(given: Equations) -> Forecast:
        own = given.chooser.forecast
        return own.degree_forecast(own.degree + 1)

    @staticmethod
    def attempts(forecast: Forecast) -> str:
        return ", and iterations do not find it" if forecast.operations > two_level.MANY else ""

    def solve(self, observer: Observer) -> Found | None:
        given, finer, direction = self.given, self.equations, self.solution.direction
        forecast = self.forecast(given)
        is_affordable = forecast.least <= given.chooser.room
        is_large = forecast.operations > two_level.MANY
        if not (is_large and two_level.correct(given, direction, finer, observer)):
            if not is_affordable:
                return None
            equilibrium = finer.equilibrium(finer.weak_form(direction))
            equilibrium.correct(1.0)
            equilibrium.destroy()
        found = self.moved()
        if not is_affordable or found.largest <= LINEAR * displacement_scale(given, self.solution).length:
            return found
        corrected = finer.state()
        budget = Budget(observer, self.tangents_allowed(forecast))
        if not budget.is_spent:
            solved = solve_direction(finer, direction, UNLOADED, budget)
            finer.destroy()
            if solved.load == 1.0:
                return replace(self.moved(), is_solved=True)
        finer.put_fields(corrected.fields)
        return replace(found, is_too_dear=budget.is_spent)

    def change(self, found: Found, start: fem.Function) -> fem.Function:
        found.displacement.x.array[:] -= start.x.array
        return found.displacement

    def _equations(self) -> Equations:
        given, solution, correction = self.given, self.solution, self.rest_correction
        body = given.body
        if solution.is_on_given_mesh:  # one solved from the rest shape has the cells of the given mesh
            with given.timings("mesh"):
                body = given.body.true_geometry_body[0] or body
        finer = Equations(one_degree_more(solution.job), body, given.timings)
        finer.take_supports_as_checked()
        finer.put_contacts(solution.direction, solution.contacts, partial(transfer_function, body.mesh))
        given.put(solution.moved_to(self.nodes))
        state = replace(finer.unloaded(nodes=self.nodes if body is given.body else None), load=solution.load)
        if (other := solution.given_displacement) is not None:
            u = fem.Function(finer.unknowns.displacement_space)
            interpolate(other if correction is None else correction.displacement, u)
            state = replace(state, given_displacement=u)
        extend(solution.displacement, state.displacement)
        if state.pressure is not None:
            assert solution.pressure is not None
            interpolate(solution.pressure, state.pressure)
        put_with_ghosts(finer, state)
        return finer

    def _node_values(self, displacement: fem.Function) -> Floats:
        # A finer geometry has the nodes of the given one at the same places of the cells.
        return self.given.unknowns.geometry_values(displacement)


def one_degree_more(job: Job) -> Job:
    """Return the job in spaces of one degree more, with the quadrature that they need."""
    spaces = job.discretisation
    finer: dict[str, int] = {"displacement": spaces.displacement + 1}
    if spaces.pressure is not None:
        finer["pressure"] = spaces.pressure + 1
    if spaces.quadrature is not None:
        finer["quadrature"] = spaces.quadrature + 2
    return job.model_copy(update={"discretisation": spaces.model_copy(update=finer)})


def extend(coarse: fem.Function, finer: fem.Function) -> None:
    """Interpolate a function in a space on the same cells, perhaps with a finer geometry; collective.

    A node that lies ``s`` away from its place in the coarse mesh gets ``u + ∇u s``, with the mean of ∇u over its cells.
    By reference coordinates alone it would get ``u``, and a rotation R would strain the cells there by ``(R - I) ∇s``.

    Args:
        coarse: scalar or vector in a Lagrange space; its mesh must lie where it was computed.
        finer: function in a Lagrange space, whose values are replaced.
    """
    space, target = coarse.function_space, finer.function_space
    interpolate(coarse, finer)
    if target.mesh is space.mesh:
        return
    size, points = target.dofmap.bs, target.element.basix_element.points
    slopes = space.element.basix_element.tabulate(1, points)[1:, :, :, 0]
    values = coarse.x.array.reshape(-1, size)
    added, counts = (la.vector(target.dofmap.index_map, n) for n in (size, 1))
    owned = np.arange(target.mesh.topology.index_map(3).size_local, dtype=np.int64)
    for cells in np.array_split(owned, 1 + len(owned) // CHUNK):
        nodes = _nodes(space.mesh, cells)
        offset = _positions(points, target.mesh, _nodes(target.mesh, cells)) - _positions(points, space.mesh, nodes)
        moved = np.abs(offset).max(axis=(1, 2)) > _ROUNDING * np.ptp(nodes, axis=1).max(axis=1)
        jacobian = jacobians(*kind_and_degree(space.mesh), nodes[moved], points)
        shift = np.linalg.solve(jacobian, offset[moved, :, :, None])[..., 0]  # in reference coordinates
        u, dofs = values[space.dofmap.list[cells[moved]]], target.dofmap.list[cells[moved]]
        change = sum((slope @ u) * shift[..., a, None] for a, slope in enumerate(slopes))
        np.add.at(added.array.reshape(-1, size), dofs, change)
        np.add.at(counts.array, dofs, 1.0)
    for vector in (added, counts):
        vector.scatter_reverse(la.InsertMode.add)
        vector.scatter_forward()
    finer.x.array.reshape(-1, size)[:] += added.array.reshape(-1, size) / np.maximum(counts.array, 1.0)[:, None]


def _nodes(mesh: Mesh, cells: Ints) -> Floats:
    """Geometry nodes of cells, (cells, nodes, 3)."""
    return np.asarray(mesh.geometry.x[mesh.geometry.dofmaps[0][cells]])


def _positions(points: Floats, mesh: Mesh, nodes: Floats) -> Floats:
    """Positions (cells, points, 3) of points of the reference cell."""
    return np.asarray(scalar_element(*kind_and_degree(mesh)).tabulate(0, points)[0, :, :, 0] @ nodes)
