"""Quantities of interest: formulas at a point, or over a region, reduced to one number, and reactions of supports.

Formulas of position and displacement alone are taken at a region's nodes. Formulas of stress, energy and volume ratio,
and integrals of any, are taken at quadrature points in its cells, or on its facets if it has no cells.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from dolfinx import la

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.nondimensional import Scales
from hpcinv.errors import MeshError, naming_field
from hpcinv.job.quantity_of_interest import QuantityOfInterest, QuantityValue
from hpcinv.job.vocabulary import STRESS
from hpcinv.mesh import Body
from hpcinv.mesh.body import source_node_values
from hpcinv.mesh.boundary_shells import cells_and_sides
from hpcinv.mesh.cells import scalar_element
from hpcinv.mesh.extent import extent
from hpcinv.mesh.location import Point, PointLocation, locate, position
from hpcinv.mesh.regions import find
from hpcinv.mesh.source import Floats
from hpcinv.model.weak_form import WeakForm
from hpcinv.on_demand import on_demand
from hpcinv.results.point_fields import PointFields
from hpcinv.results.reactions import contact_values, reactions
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations

NOT_FINITE = "look for divisions by zero, and roots and logarithms of negative values"
"""Remedy for a formula without a finite value."""

_INSIDE = "Integrals and stress are evaluated on boundary facets or in cells: name a region that has such."


def check_points(quantities: Iterable[QuantityOfInterest], body: Body) -> Mapping[Point, PointLocation | None]:
    """Check that the quantities' points and regions exist on the body, and return where points are; collective.

    Raises:
        MeshError: on every rank, with all problems.
    """
    quantities, problems = tuple(quantities), list[str]()
    places = locate(body, _points(quantities))
    for quantity in quantities:
        if quantity.on is not None:
            with naming_field(f"quantities: {quantity.name}"):
                region = find(body.regions, quantity.on, body.source)
                if quantity.needs_surface and region.cell_count:
                    problems.append(
                        f"quantities: {quantity.name}: '{quantity.of}' has the normal of a surface, and '{quantity.on}'"
                        " has cells"
                    )
                elif quantity.uses_quadrature and not region.cell_count:
                    body.boundary_facets(quantity.on, _INSIDE)
        elif quantity.at is not None and places[quantity.at] is None:
            problems.append(f"quantities: {quantity.name}: the point ({_triple(quantity.at)}) m is outside of the body")
    if problems:
        low, high = extent(body.mesh.comm, body.mesh.geometry.x * body.length_scale)
        raise MeshError(
            "\n".join(f"{body.source.path}: {p}" for p in problems),
            f"It extends from ({_triple(low)}) to ({_triple(high)}) m; points are in metres unless they have a unit.",
        )
    return places


def _points(quantities: Iterable[QuantityOfInterest]) -> Iterator[Point]:
    """Yield the points (m) of those quantities that have one."""
    return (q.at for q in quantities if q.at is not None)


def fault_of(quantity: QuantityOfInterest, value: QuantityValue) -> str:
    """Return what is wrong with a value of a quantity; empty if it is finite."""
    if np.isfinite(value).all():
        return ""
    where = f"at ({_triple(quantity.at)}) m" if quantity.at else f"somewhere on '{quantity.on}'"
    return f"{quantity.name}: '{quantity.of}' has no finite value {where}"


def carried(quantities: Iterable[QuantityOfInterest], body: Body, nodes: Floats) -> tuple[QuantityOfInterest, ...]:
    """Return the quantities at the same material points of the body with its local nodes at ``nodes`` (m); collective.

    Their points are on the given mesh.
    """
    quantities, moved = tuple(quantities), []
    with body.at(body.given_nodes):
        places = locate(body, _points(quantities))
    for quantity in quantities:
        if quantity.at is not None and (place := places[quantity.at]) is not None:
            quantity = quantity.model_copy(update={"at": tuple(position(body, place, nodes).tolist())})
        moved.append(quantity)
    return tuple(moved)


def evaluate(
    quantities: Iterable[QuantityOfInterest], body: Body, solution: Solution, equations: Equations | None = None
) -> dict[str, QuantityValue]:
    """Evaluate the quantities in SI by name, displacements and reactions as lists of 3; collective.

    One whose formula has no finite value somewhere is NaN (`fault_of`): it must not end a run that has its solution.

    Args:
        equations: the equations of the solution, which must have reached the full load.
            Without it there are no quantities of stress, energy and volume ratio, none by quadrature, and no reactions.

    Raises:
        MeshError: on every rank, if a point is outside of the body, or there is no such region.
    """
    quantities = tuple(quantities)
    if equations is None:
        with body.at(solution.mesh_nodes):
            return _evaluated(quantities, body, solution, None)
    equations.put(solution)
    return _evaluated(quantities, body, solution, equations)


def _evaluated(
    quantities: tuple[QuantityOfInterest, ...], body: Body, solution: Solution, equations: Equations | None
) -> dict[str, QuantityValue]:
    places = check_points(quantities, body)
    others = [q for q in quantities if not q.is_reaction]
    values = values_of(others, body, solution, _fields(quantities, body, solution, equations), places)
    if len(others) < len(quantities):
        assert equations is not None
        values |= contact_values([q for q in quantities if q.is_contact], solution)
        if supported := [q for q in quantities if q.is_reaction and not q.is_contact]:
            values |= reactions(supported, solution, equations)
    return {q.name: values[q.name] for q in quantities}


def values_of(
    quantities: Iterable[QuantityOfInterest],
    body: Body,
    solution: Solution,
    fields: PointFields | None,
    located: Mapping[Point, PointLocation | None] | None = None,
) -> dict[str, QuantityValue]:
    """Evaluate quantities other than reactions, with mesh and equations put into the solution; collective.

    Args:
        fields: at the solution; ``None`` if no quantity needs them.
        located: where their points are, if that is known.
    """
    quantities = tuple(quantities)
    located = locate(body, _points(quantities)) if located is None else located
    places = {q.name: place for q in quantities if q.at and (place := located[q.at])}
    names = [q.name for q in quantities if q.at and q.fields]
    point_values = fields.point_values([places[name] for name in names]) if fields else []
    known = dict(zip(names, point_values, strict=True))
    values: dict[str, QuantityValue] = {}
    for q in quantities:
        if q.at is not None:
            values[q.name] = _point_value(q, body, solution, places[q.name], known.get(q.name, {}))
        elif q.cavity is not None:
            values[q.name] = _cavity_value(q, q.cavity, body, solution)
        elif q.uses_quadrature:
            values[q.name] = _quadrature_value(q, body, fields)
        else:
            values[q.name] = _node_value(q, body, solution)
    return values


def _fields(
    quantities: tuple[QuantityOfInterest, ...], body: Body, solution: Solution, equations: Equations | None
) -> PointFields | None:
    """Return the fields that the quantities need, at the solution and the full load."""
    if not any(q.fields or q.uses_quadrature for q in quantities):
        return None
    assert equations is not None
    weak_form = equations.weak_form(solution.direction)
    return fields_for(quantities, body, weak_form, equations.scales)


def fields_for(
    quantities: Iterable[QuantityOfInterest], body: Body, weak_form: WeakForm, scales: Scales
) -> PointFields | None:
    """Return the fields that the quantities need, ``None`` if there are none."""
    names = [q.of.names for q in quantities if q.fields or q.uses_quadrature]
    return PointFields(body, weak_form, scales, frozenset().union(*names)) if names else None


def _cavity_value(quantity: QuantityOfInterest, cavity: str, body: Body, solution: Solution) -> float:
    """Return the pressure or the volume of a cavity."""
    if quantity.dimension == STRESS:
        return next(found.pressure for found in solution.cavities if found.name == cavity)
    nodes = solution.reference_nodes if quantity.over == "reference" else solution.current_nodes
    return float(on_demand("enclosed volume")(solution.job, body, cavity).volume(nodes))


def _point_value(
    quantity: QuantityOfInterest, body: Body, solution: Solution, place: PointLocation, fields: Mapping[str, float]
) -> QuantityValue:
    here, comm = np.array(quantity.at), body.mesh.comm
    u: Floats | None = None
    if comm.rank == place.rank:
        u = solution.displacement.eval(here / body.length_scale, np.array([place.cell], dtype=np.int32))
    u = comm.bcast(u, root=place.rank)
    assert u is not None
    if quantity.is_displacement:
        return [float(c) for c in u]
    X, x = (here, here + u) if solution.direction == "forward" else (here - u, here)
    value = float(quantity.of.evaluate(**{**fields, **_positions(X[None], x[None], u[None])})[0])
    return value if math.isfinite(value) else math.nan


def _node_value(quantity: QuantityOfInterest, body: Body, solution: Solution) -> float:
    """Reduce a quantity over the nodes of a region in the given cells, with equal weights."""
    assert quantity.on is not None
    nodes = owned_nodes(body, quantity.on)
    fields = (solution.reference_nodes, solution.current_nodes, solution.u)
    known = _positions(*(source_node_values(body, values)[nodes] for values in fields))
    return _reduced(quantity, body.mesh.comm, quantity.of.evaluate(**known), np.ones(len(nodes)))


def _quadrature_value(quantity: QuantityOfInterest, body: Body, fields: PointFields | None) -> float:
    """Reduce a quantity over the volume of a region, or over its area if it has no cells."""
    assert quantity.on is not None
    assert fields is not None
    region = find(body.regions, quantity.on, body.source)
    samples = fields.cell_samples(region.cells) if region.cell_count else fields.facet_samples(region.facets)
    weights = samples.current if quantity.over == "current" else samples.reference
    values = np.broadcast_to(quantity.of.evaluate(**samples.values), weights.shape)
    return _reduced(quantity, body.mesh.comm, values, weights)


def _positions(X: Floats, x: Floats, u: Floats) -> dict[str, Any]:
    """Return reference and current positions and displacements (n, 3) m by the names of their components."""
    named = dict(zip("XYZ", X.T, strict=True)) | dict(zip("xyz", x.T, strict=True))
    return named | dict(zip(("ux", "uy", "uz"), u.T, strict=True))


def _reduced(quantity: QuantityOfInterest, comm: MPI.Intracomm, values: Floats, weights: Floats) -> float:
    assert quantity.reduce is not None
    if comm.allreduce(int(np.count_nonzero(~np.isfinite(values)))):
        return math.nan
    return _REDUCTIONS[quantity.reduce](comm, values, weights)


def _integral(comm: MPI.Intracomm, values: Floats, weights: Floats) -> float:
    return float(comm.allreduce(float((weights * values).sum())))


def _mean(comm: MPI.Intracomm, values: Floats, weights: Floats) -> float:
    return _integral(comm, values, weights) / float(comm.allreduce(float(weights.sum())))


def _max(comm: MPI.Intracomm, values: Floats, _weights: Floats) -> float:
    return float(comm.allreduce(float(values.max(initial=-np.inf)), op=MPI.MAX))


_REDUCTIONS: Mapping[str, Callable[[MPI.Intracomm, Floats, Floats], float]] = {
    "max": _max,
    "min": lambda comm, values, weights: -_max(comm, -values, weights),
    "mean": _mean,
    "max_abs": lambda comm, values, weights: _max(comm, np.abs(values), weights),
    "rms": lambda comm, values, weights: _mean(comm, values**2, weights) ** 0.5,
    "integral": _integral,
}


def owned_nodes(body: Body, name: str) -> npt.NDArray[np.int64]:
    """Return the nodes of a region that the given cells have there, among the local nodes of the source."""
    region, geometry = find(body.regions, name, body.source), body.source_geometry
    marks, nodes = la.vector(geometry.index_map(), 1), geometry.dofmaps[0]
    marks.array[nodes[region.cells]] = 1.0
    if len(region.facets):
        cells, side = cells_and_sides(body.mesh, region.facets)
        element = scalar_element(body.source.kind, body.source.degree)
        marks.array[nodes[cells[:, None], np.array(element.entity_closure_dofs[2])[side]]] = 1.0
    # A rank may own a node on the region's edge without having a facet of the region.
    marks.scatter_reverse(la.InsertMode.add)
    return np.flatnonzero(marks.array[: geometry.index_map().size_local])


def _triple(point: Any) -> str:
    return ", ".join(f"{c:g}" for c in point)
