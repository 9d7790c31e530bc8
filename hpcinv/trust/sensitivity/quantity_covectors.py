"""Derivatives of quantities of interest by displacements and positions of nodes, and as forms of the state.

Quantities of positions at a point or at nodes are differentiated where they are taken. Means and integrals of other
fields, and fields at a point, are integrals of UFL expressions (`hpcinv.trust.sensitivity.quantity_forms`). Points move
with the material as the nodes of the mesh do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.expressions import Expression
from hpcinv.base.quantity.parameter_paths import POINTS, central_difference
from hpcinv.job.quantity_of_interest import QuantityOfInterest
from hpcinv.mesh.extent import diagonal
from hpcinv.mesh.location import locate
from hpcinv.mesh.source import Floats
from hpcinv.results.quantities_of_interest import owned_nodes
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.trust.sensitivity.point_maps import PointMap, PointMaps

_STEP = 2.0**-10
"""Length of differences of a formula, over the body's size or the largest displacement; raised, their error grows with
its fourth power; lowered, rounding errors grow."""


@dataclass(frozen=True)
class PointSlopes:
    """Derivatives of a quantity by displacements (m) and by positions of the mesh (m) at points of this rank.

    Attributes:
        displacement, position: maps from nodes to the points.
        by_displacement, by_position: derivatives (p, 3) there, for each component of the quantity.
    """

    displacement: PointMap
    position: PointMap | None
    by_displacement: tuple[Floats, ...]
    by_position: tuple[Floats, ...]


def refusal_of(quantity: QuantityOfInterest) -> str:
    """Return why a quantity has no derivative by an adjoint solve; empty if it has one."""
    if quantity.is_reaction:
        return "is a reaction or a result of contact, which has no derivative"
    if quantity.cavity is not None:
        return "is of a cavity; give the shape's covector instead"
    if quantity.state or quantity.from_state:
        return "is of a state"
    if quantity.uses_quadrature and quantity.reduce in ("max", "min", "max_abs"):
        return "is a largest value over quadrature points; take 'mean', 'rms' or 'integral'"
    return ""


def is_at_points(quantity: QuantityOfInterest) -> bool:
    """Return whether a quantity is of positions and displacements at a point, or at the nodes of a region."""
    return not quantity.fields and (quantity.at is not None or not quantity.uses_quadrature)


def point_slopes(
    quantity: QuantityOfInterest, equations: Equations, solution: Solution, maps: PointMaps
) -> PointSlopes:
    """Return the derivatives of a quantity for which `is_at_points` holds; collective."""
    body, nodes = equations.body, solution.mesh_nodes
    if quantity.at is not None:
        place = locate(body, [quantity.at])[quantity.at]
        assert place is not None  # the quantity was evaluated
        displacement, position = maps.at(place)
        there = np.array([quantity.at])[: len(displacement.points)]
    else:
        assert quantity.on is not None
        chosen = np.flatnonzero(np.isin(maps.displacement.points, owned_nodes(body, quantity.on)))
        displacement, position = maps.displacement.rows(chosen), None
        there = maps.source_positions(nodes)[displacement.points]
    u = displacement.at_points(solution.displacement.x.array.reshape(-1, 3))
    if quantity.is_displacement:
        ones = tuple(np.tile(row, (len(u), 1)) for row in np.eye(3))
        return PointSlopes(displacement, position, ones, tuple(np.zeros_like(one) for one in ones))
    comm = body.mesh.comm
    length = diagonal(comm, nodes)
    largest = comm.allreduce(float(np.abs(u).max(initial=0.0)), op=MPI.MAX) or _STEP * length
    f, by_u, by_mesh = _pointwise(quantity.of, there, u, solution.sign, _STEP * length, _STEP * largest)
    factors = _factors(quantity, comm, f)[:, None]
    return PointSlopes(displacement, position, (factors * by_u,), (factors * by_mesh,))


def _pointwise(
    formula: Expression, mesh: Floats, u: Floats, sign: int, step: float, small: float
) -> tuple[Floats, Floats, Floats]:
    """Return values (p,) of a formula and derivatives (p, 3) by displacement and by position of the mesh.

    Args:
        mesh: positions (p, 3) m on the mesh.
        step, small: lengths (m) of differences by positions and by displacements.
    """

    def values(mesh: Floats, other: Floats, u: Floats) -> Floats:
        X, x = (mesh, other) if sign > 0 else (other, mesh)
        named = dict(zip("XYZ", X.T, strict=True)) | dict(zip("xyz", x.T, strict=True))
        named |= dict(zip(("ux", "uy", "uz"), u.T, strict=True))
        return np.array(np.broadcast_to(formula.evaluate(**named), len(u)), dtype=np.float64)

    other, by_u, by_mesh = mesh + sign * u, np.zeros_like(u), np.zeros_like(u)
    for axis, e in enumerate(np.eye(3)):
        by_other = central_difference([values(mesh, other + k * step * e, u) for k in POINTS], step)
        own = central_difference([values(mesh, other, u + k * small * e) for k in POINTS], small)
        by_u[:, axis] = own + sign * by_other
        by_mesh[:, axis] = by_other + central_difference([values(mesh + k * step * e, other, u) for k in POINTS], step)
    return values(mesh, other, u), by_u, by_mesh


def _factors(quantity: QuantityOfInterest, comm: MPI.Intracomm, f: Floats) -> Floats:
    """Return the derivatives (p,) of a quantity by the values of its formula at the points; collective."""
    count = max(comm.allreduce(len(f)), 1)
    if quantity.at is not None or quantity.reduce == "mean":
        return np.full(len(f), 1.0 / count)
    if quantity.reduce == "rms":
        value = (comm.allreduce(float((f**2).sum())) / count) ** 0.5
        return f / (count * value) if value else np.zeros_like(f)
    sign = {"max": np.ones_like(f), "min": -np.ones_like(f), "max_abs": np.sign(f)}[str(quantity.reduce)]
    largest = [float((sign * f).max(initial=-np.inf))]
    ranks = comm.allgather(largest[0])
    result = np.zeros(len(f))
    if ranks.index(max(ranks)) == comm.rank:
        place = int((sign * f).argmax())
        result[place] = abs(sign[place]) if quantity.reduce != "max_abs" else sign[place]
    return result
