"""The finer problem of a shell: the same unknowns on cells of half the size.

Spaces of one degree more do not help on thin coarse cells: with full integration they lock, and with the quadrature
of a layer they have motions of little stiffness. The layer of quadratic hexahedra converges on finer surfaces; where
the error falls with the square of the size of the cells, halved ones find three quarters of it. Errors across the
thickness, which is one layer on both, are left out.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from dolfinx import fem

from hpcinv.mesh import Body
from hpcinv.mesh.body import local_node_values, reorder_to_source
from hpcinv.mesh.cells import scalar_element
from hpcinv.mesh.interpolation import interpolate
from hpcinv.mesh.midsurface import halved_values
from hpcinv.mesh.source import Floats, MeshSource
from hpcinv.model.spaces import Unknowns
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.solver.equilibrium import Equilibrium
from hpcinv.solver.methods import solve_direction
from hpcinv.solver.methods.method import NESTED, UNLOADED, Guess, sign_of
from hpcinv.solver.observer import Observer

_SHARE = 0.05
"""Error of the finer solution, relative to the change from the given one; raised, estimates have fewer digits"""
_LARGE, _EXACT = 1e-3, 1e-6
"""Change, relative to the state, above which the error must be below ``_EXACT`` too: far from the solution,
corrections shrink by chance. With 1e-3 for 1e-6, a pinched ring had an estimate of the wrong sign. Lowered, large
changes take more iterations."""
_REUSE = 0.6
"""Contraction up to which a finer tangent is kept, since a new one takes as long as five corrections by a kept one.
Lowered, more tangents are factorized."""


def refined_values(given: Body, values: Floats) -> Floats:
    """Return values at the local geometry nodes of `Body.halved` from values (n, k) at the nodes of ``given``."""
    return _carried(given, given.halved, values, halved_values)


def given_values(given: Body, values: Floats) -> Floats:
    """Return values at the local geometry nodes of ``given`` from values (n, k) at the nodes of `Body.halved`."""

    def kept_rows(source: MeshSource, rows: Floats) -> Floats:
        assert given.source.shell is not None
        levels = len(given.source.shell.levels)
        count = len(given.source.points) // levels
        return rows.reshape(levels, -1, rows.shape[1])[:, :count].reshape(levels * count, -1)

    return _carried(given.halved, given, values, kept_rows)


def _carried(source: Body, target: Body, values: Floats, rule: Callable[[MeshSource, Floats], Floats]) -> Floats:
    """Return nodal values of one body on another, by a rule for all nodes of its source; collective."""
    whole = reorder_to_source(source, values)
    return local_node_values(target, rule(source.source, whole) if source.mesh.comm.rank == 0 else whole[:0])


def refined_function(given: Body, unknowns: Unknowns, displacement: fem.Function, finer: Unknowns) -> fem.Function:
    """Return a displacement (m) on the cells of ``given`` in the space of ``finer``, on halved cells; collective."""
    return nodal_function(finer, refined_values(given, unknowns.geometry_values(displacement)))


def nodal_function(unknowns: Unknowns, values: Floats) -> fem.Function:
    """Return the displacement with values (n, 3) at the local geometry nodes."""
    nodal, geometry = fem.Function(unknowns.nodal_space), unknowns.mesh.geometry
    nodal.x.array.reshape(-1, 3)[nodal.function_space.dofmap.list] = values[geometry.dofmaps[0]]
    u = fem.Function(unknowns.displacement_space, name="displacement")
    interpolate(nodal, u)
    return u


def refined_pressure(given: Body, unknowns: Unknowns, pressure: fem.Function, finer: Unknowns) -> fem.Function:
    """Return a pressure (Pa), as `refined_function`; between layers it is one of both, since Newton's method is to
    find it."""
    nodes, geometry = scalar_element("hexahedron", given.degree), unknowns.mesh.geometry
    values = np.zeros((len(geometry.x), 1))
    nodal_basis = unknowns.scalar_elements[1].basix_element.tabulate(0, nodes.points)[0, :, :, 0]
    values[geometry.dofmaps[0], 0] = pressure.x.array[pressure.function_space.dofmap.list] @ nodal_basis.T
    values = refined_values(given, values)
    p = fem.Function(finer.pressure_space, name="pressure")
    pressure_basis = nodes.tabulate(0, finer.scalar_elements[1].basix_element.points)[0, :, :, 0]
    p.x.array[p.function_space.dofmap.list] = values[finer.mesh.geometry.dofmaps[0], 0] @ pressure_basis.T
    return p


def solve(equations: Equations, solution: Solution, finer: Equations, observer: Observer) -> bool:
    """Solve the finer problem, whose present state is the solution on the given cells; return whether it was found.

    The first solve begins with that state, others with the unloaded body: on coarse cells motions between the points of
    quadrature stretch a bent shell, and where rigid bodies touch, their pressures are not carried over.
    """
    finer.impose_supports(solution.direction)
    sign = finer.unknowns.unloaded_sign if sign_of(solution.solves) == equations.unknowns.unloaded_sign else 0
    weak_form = finer.weak_form(solution.direction)
    if not weak_form.contacts.is_iterated:
        equilibrium = finer.equilibrium(weak_form, observer)
        equilibrium.depart(0.0)
        was_found = _corrected(finer, equilibrium, sign)
        equilibrium.destroy()
        if was_found:
            return True
    solved = solve_direction(finer, solution.direction, UNLOADED, observer)
    finer.destroy()
    signs = solved.solves[-1].signs if solved.solves else ()
    # With another sign, a branching point is between the two, and the path has led to another solution.
    return solved.load == 1.0 and not (sign and signs and signs[-1] != sign)


def _corrected(finer: Equations, equilibrium: Equilibrium, sign: int) -> bool:
    """Solve from the present state, as exactly as an estimate needs it; return whether that was accepted."""

    def tolerance(change: float) -> float:
        wanted = _SHARE * change
        return max(wanted if change < _LARGE else min(wanted, _EXACT), finer.job.solver.tolerance)

    state, reuse = finer.state(), equilibrium.reuse
    pressure = None if state.pressure is None else state.pressure.x.array.copy()
    guess = Guess(state.displacement.x.array.copy(), pressure, sign, NESTED)
    equilibrium.reuse = _REUSE if reuse else 0.0
    solve = guess.solve(finer, equilibrium, tolerance)
    equilibrium.reuse = reuse
    return solve.outcome.accepted
