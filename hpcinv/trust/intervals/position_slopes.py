"""Slopes of quantities of positions alone along many changes of the displacement: no field of the body is evaluated."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from dolfinx import fem

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.parameter_paths import POINTS, central_difference
from hpcinv.job.quantity_of_interest import QuantityOfInterest
from hpcinv.mesh import Body
from hpcinv.mesh.body import source_node_values
from hpcinv.mesh.location import locate
from hpcinv.mesh.source import Floats
from hpcinv.results.quantities_of_interest import owned_nodes
from hpcinv.results.solution import Solution
from hpcinv.trust.sensitivity.slopes import STEP

_SMOOTH = ("mean", "rms")


def is_of_positions(quantity: QuantityOfInterest) -> bool:
    """Return whether a quantity is a smooth function of the positions of a point, or of a region's nodes."""
    is_smooth = not any(f"{name}(" in quantity.of.source for name in ("max", "min", "abs"))
    is_there = quantity.at is not None or quantity.reduce in _SMOOTH
    is_simple = quantity.cavity is None and not quantity.is_displacement and not quantity.uses_quadrature
    return is_smooth and is_there and is_simple and not quantity.fields and not quantity.is_reaction


def position_slopes(
    quantity: QuantityOfInterest, body: Body, solution: Solution, rates: Sequence[tuple[fem.Function, Floats]]
) -> Floats:
    """Return the slopes of a quantity of positions along rates of the displacement of an inverse solution; collective.

    Args:
        rates: derivatives (m) of the displacement, as function and at the local geometry nodes.
    """
    comm = body.mesh.comm
    here, at_points = _point(quantity, body) if quantity.at is not None else _nodes(quantity, body, solution)
    u = at_points(solution.displacement, solution.u)
    count = comm.allreduce(len(u))
    sizes = comm.allreduce(np.abs(u).max(initial=0.0), op=MPI.MAX)
    slopes = []
    for function, values in rates:
        rate = at_points(function, values)
        largest = comm.allreduce(np.abs(rate).max(initial=0.0), op=MPI.MAX)
        step = STEP * (max(sizes, STEP * body.length * body.length_scale) / largest if largest else 1.0)
        shifted = (u + k * step * rate for k in POINTS)
        changes = np.array([_sum(quantity, here, moved) for moved in shifted])
        slopes.append(central_difference(comm.allreduce(changes) / count, step))
    result = np.array(slopes)
    if quantity.reduce == "rms":
        value = np.sqrt(comm.allreduce(_sum(quantity, here, u)) / count)
        result = result / (2 * value) if value > 0 else np.zeros_like(result)
    return result


type _AtPoints = Callable[[fem.Function, Floats], Floats]
"""Returns the values (n, 3) of a function, which has the given values at the local geometry nodes, on this rank."""


def _point(quantity: QuantityOfInterest, body: Body) -> tuple[Floats, _AtPoints]:
    """Return the point of a quantity on one rank, none on the others, with the values of functions there."""
    assert quantity.at is not None
    place = locate(body, [quantity.at])[quantity.at]
    assert place is not None  # the quantity was evaluated
    is_here = body.mesh.comm.rank == place.rank
    here, cells = np.array([quantity.at]), np.array([place.cell], dtype=np.int32)

    def at_points(function: fem.Function, _: Floats) -> Floats:
        if not is_here:
            return np.zeros((0, 3))
        return np.asarray(function.eval(here / body.length_scale, cells)).reshape(1, 3)

    return here if is_here else here[:0], at_points


def _nodes(quantity: QuantityOfInterest, body: Body, solution: Solution) -> tuple[Floats, _AtPoints]:
    """Return the owned nodes of the region of a quantity, with the values of functions there."""
    assert quantity.on is not None
    nodes = owned_nodes(body, quantity.on)

    def at_points(_: fem.Function, values: Floats) -> Floats:
        return np.asarray(source_node_values(body, values)[nodes])

    return source_node_values(body, solution.current_nodes)[nodes], at_points


def _sum(quantity: QuantityOfInterest, x: Floats, u: Floats) -> float:
    """Return the sum over points at ``x`` with displacements ``u``: of the formula, or of its square for 'rms'."""
    if not len(u):
        return 0.0
    named = {
        name: axis for names, axes in (("XYZ", (x - u).T), ("xyz", x.T)) for name, axis in zip(names, axes, strict=True)
    }
    values = np.broadcast_to(quantity.of.evaluate(**named, ux=u[:, 0], uy=u[:, 1], uz=u[:, 2]), len(u))
    return float((values**2).sum() if quantity.reduce == "rms" else values.sum())
