"""Estimate of the discretisation error: the correction of a solution in spaces of one degree more.

A two-level estimate: ``u_h`` is put in the spaces of degree ``k + 1`` on the same mesh, and one Newton correction
``K δ = -R(u_h)`` there gives ``u_h + δ``, whose own error is of higher order. A second correction, with the same
factors, adds what is of second order in δ. Then ``Q(u_h + δ) - Q(u_h)`` estimates the error of any quantity ``Q``, with
its error of quadrature. In small bodies K is factorized; in large ones the factors of the solve precondition Krylov
iterations (`hpcinv.trust.certificate.two_level`).

Where more is known of the body's geometry than the mesh has (`Body.true_geometry_body`), the finer problem is posed on
the same cells with a geometry of a higher degree. ``u_h`` is taken there by reference coordinates, and so the residual,
the correction and the corrected quantities have the error of the geometry in them, to first order. Elsewhere the
estimate leaves that error out, and says so.

One Newton step says little of a correction that is as large as the displacement. The finer problem is then solved, so
that a certificate fails for an error that was found, and not for one that was extrapolated. That solve ends where it
takes more than a share of the time of the solve; the line is then not decided. Shells have another finer problem,
which is always solved (`hpcinv.trust.certificate.halved_cells`).

At re-entrant edges and at edges of supports it finds a part of the error only, and is multiplied by what is missing
(`hpcinv.trust.certificate.singular_limit`).

The one layer of a shell is the same on halved cells: what it leaves in stresses and near clamps is estimated apart
(`hpcinv.trust.certificate.layer_errors`).

A further state of a body is corrected on the corrected rest shape, so that its estimate has the error of that in it.

Source: Bank & Weiser, "Some a posteriori error estimators for elliptic partial differential equations" (1985),
doi:10.1090/S0025-5718-1985-0777265-X; Ainsworth & Oden, *A Posteriori Error Estimation in Finite Element Analysis*
(2000), ch. 5, doi:10.1002/9781118032824.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from math import isfinite
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from hpcinv.base.parallel.runtime import MPI
from hpcinv.job.job import Job
from hpcinv.job.sections import QuantityOfInterest, QuantityValue
from hpcinv.job.state_differences import parts, with_differences
from hpcinv.mesh import Body
from hpcinv.mesh.cells import quadrature_metadata
from hpcinv.mesh.interpolation import interpolate
from hpcinv.mesh.location import Point, cells_at, locate, position
from hpcinv.mesh.refine.finer_geometry import transfer_function
from hpcinv.mesh.source import Floats
from hpcinv.model.state import State
from hpcinv.physics.effects import Direction
from hpcinv.results.displacement_scale import displacement_scale
from hpcinv.results.quantities_of_interest import carried, evaluate
from hpcinv.results.solution import Solution, solution_of
from hpcinv.solver.equations import Equations
from hpcinv.solver.linear.cost_model import Forecast
from hpcinv.solver.methods import solve_direction
from hpcinv.solver.methods.method import UNLOADED
from hpcinv.solver.newton import NewtonIteration
from hpcinv.solver.observer import SILENT, IterationObserver, Observer, SolveEvent, stop_if_asked
from hpcinv.trust.certificate import halved_cells, two_level
from hpcinv.trust.certificate.extension import extend
from hpcinv.trust.certificate.layer_errors import LayerError, layer_errors
from hpcinv.trust.certificate.singular_edges import FIBRES, SingularEdges, singular_edges
from hpcinv.trust.certificate.singular_limit import SingularLimit, singular_limit

LINEAR = 0.5
"""Correction of the shape, relative to the displacement; above it one Newton step does not suffice."""

SHARE = 0.5
"""Largest forecast time of the finer solve, relative to the solve; larger decides more lines."""
LEAST = 1.0
"""Seconds that the finer solve may take in any case, since starting a run takes longer."""
_OVERHEAD = 0.02  # seconds of an iteration in a body of few unknowns

_SHELL_TANGENTS = 10
"""Tangents that the finer solve of a shell may take in any case; raised, more lines are decided"""


@dataclass(frozen=True)
class Correction:
    """Correction of the rest shape by the estimate of the given state. Further states are solved on it.

    Attributes:
        nodes: correction of the local geometry nodes of the rest shape, (n, 3) in m.
        displacement: corrected displacement of the given state in the finer spaces, in m.
        without_geometry: as in `Estimate`, of further states.
        finer_nodes: of a shell: the corrected rest shape at the nodes of the finer problem, (m, 3) in m.
    """

    nodes: Floats
    displacement: fem.Function
    without_geometry: str
    finer_nodes: Floats | None = None


@dataclass(frozen=True)
class Estimate:
    """Estimated discretisation errors of one solution.

    Attributes:
        quantities: corrected less computed value of each quantity of interest (SI), a list of 3 for a vector. Reactions
            are left out: the corrected solution balances its forces only to first order.
        corrected: the corrected values.
        shape: largest correction of the displacement at a geometry node, in m.
        cells: ``∫ |∇δ|² dx`` of each owned cell, in scaled lengths: where the error is.
        unknowns: number of unknowns of the finer spaces.
        limit: effect of singular edges; the errors are corrected for it; ``None`` without one.
        segments: ends (n, 2, 3) m of these edges, the same on all ranks.
        finer: where the finer problem is solved, as text for a note.
        tangents: number of tangents of the finer spaces that were factorized.
        is_solved: whether the finer problem was solved: of a shell, or with a correction too large for one Newton step.
        is_too_dear: whether that was left out or given up, since it takes too long.
        without_geometry: why the error of the geometry is left out; empty if it is included.
        unreliable: names of the quantities at a point where fibres are singular.
        correction: of the rest shape; ``None`` if it is not finite.
        layer: errors of a shell's quantities that the estimate leaves out, since its layer is the same on finer cells.
    """

    quantities: Mapping[str, QuantityValue]
    corrected: Mapping[str, QuantityValue]
    shape: float
    cells: npt.NDArray[np.float64]
    unknowns: int
    limit: SingularLimit | None = None
    segments: Floats | None = None
    finer: str = "in spaces of one degree more"
    tangents: int = 1
    is_solved: bool = False
    is_too_dear: bool = False
    without_geometry: str = ""
    unreliable: tuple[str, ...] = ()
    correction: Correction | None = None
    layer: Mapping[str, LayerError] = field(default_factory=dict)

    @property
    def left_out(self) -> str:
        """Text for a note: which errors the estimate leaves out."""
        return f", without the error of the geometry: {self.without_geometry}" if self.without_geometry else ""

    def joined(self, other: Estimate) -> Estimate:
        """Return the estimate with the quantities of another state added."""
        quantities, corrected = {**self.quantities, **other.quantities}, {**self.corrected, **other.corrected}
        unreliable = (*self.unreliable, *other.unreliable)
        layer = {**self.layer, **other.layer}
        return replace(self, quantities=quantities, corrected=corrected, unreliable=unreliable, layer=layer)

    def of_quantities(self, quantities: Sequence[QuantityOfInterest]) -> Estimate:
        """Return the estimate with the quantities between two states; their parts in each state are left out."""
        return replace(
            self,
            quantities=with_differences(quantities, self.quantities),
            corrected=with_differences(quantities, self.corrected),
            unreliable=tuple(q.name for q in quantities if not {p.name for p in parts(q)}.isdisjoint(self.unreliable)),
        )

    def as_data(self) -> dict[str, Any]:
        """The estimate as JSON data, without the cells."""
        return {
            "geometry": "left out" if self.without_geometry else "included",
            "without_geometry": self.without_geometry,
            "quantities": dict(self.quantities),
            "corrected": dict(self.corrected),
            "shape": self.shape,
            "unknowns": self.unknowns,
            "solved": self.is_solved,
            "singular": self.limit and self.limit.as_data(),
            "unreliable": list(self.unreliable),
            "layer": {name: {"error": error.size, "cause": error.cause} for name, error in self.layer.items()},
        }


def estimate(
    equations: Equations,
    solution: Solution,
    computed: Mapping[str, QuantityValue],
    rest_correction: Correction | None = None,
    observer: Observer = SILENT,
) -> Estimate | None:
    """Estimate the discretisation errors of a solution; collective.

    Args:
        equations: the equations that the solution was computed with.
        computed: values of the job's quantities of interest.
        rest_correction: of the rest shape, for a further state; without it, that shape is taken as computed.
        observer: of the solve of the finer problem, where one Newton step does not suffice; it is also asked whether to
            stop.

    Returns:
        ``None`` if iterations do not find the correction and there is no memory to factorize the finer problem.
    """
    quantities = tuple(q for q in solution.job.quantities if not q.is_reaction)
    if not solution.is_on_given_mesh:
        quantities = carried(quantities, equations.body, _nodes(solution, rest_correction))
    current = solution.current_nodes if solution.is_on_given_mesh else equations.body.given_nodes
    nodes = {"reference": solution.reference_nodes, "current": current}
    edges = singular_edges(solution.job, equations.body, nodes)
    unreliable = quantities_at_singular_fibres(solution.job.quantities, equations.body, edges)
    scale = displacement_scale(equations, solution).length
    finer = finer_equations(equations, solution, rest_correction)
    body, is_shell = finer.body, equations.body.source.midsurface is not None
    start = finer.state().displacement
    if is_shell:
        result = _solve_shell(equations, solution, finer, rest_correction, observer)
    else:
        result = _solve_solid(equations, solution, finer, rest_correction, observer, LINEAR * scale)
    if result is None:
        return None
    largest = result.largest
    stop_if_asked(body.mesh.comm, observer)
    has_values = bool(quantities) and isfinite(largest)
    corrected = _corrected(quantities, equations, result.nodal, solution.direction, finer) if has_values else {}
    displacement, delta = result.displacement.copy(), result.displacement
    delta.x.array[:] -= start.x.array
    if is_shell:  # indicators belong to the given cells
        delta = halved_cells.nodal_function(equations.unknowns, result.nodal - solution.u)
    indicators = _cell_indicators(delta, body.length_scale)
    limit = None if edges is None else singular_limit(equations, edges, indicators, delta)
    # A correction as large as the displacement is not one of edges.
    missed = limit.factor if limit and not result.is_solved else 1.0
    corrected = {n: _extrapolated(computed[n], v, missed) for n, v in corrected.items() if n in computed}
    return Estimate(
        quantities={name: _difference(value, computed[name]) for name, value in corrected.items()},
        corrected=corrected,
        shape=missed * largest,
        cells=indicators,
        limit=limit,
        segments=edges.segments if edges else None,
        unknowns=finer.unknowns.size,
        finer=halved_cells.DESCRIPTION if is_shell else Estimate.finer,
        tangents=result.tangents,
        is_solved=result.is_solved,
        is_too_dear=result.is_too_dear,
        without_geometry=_finer_body(equations, solution, rest_correction)[1],
        unreliable=unreliable,
        correction=_correction(equations, solution, finer, result.moved, displacement) if isfinite(largest) else None,
        layer=layer_errors(equations, solution, quantities, computed) if is_shell else {},
    )


@dataclass(frozen=True)
class _Found:
    """What the finer problem gave; displacements in m.

    Attributes:
        displacement: of the finer problem.
        nodal: the same at the geometry nodes of the equations' body, (n, 3).
        moved: correction of these nodes, (n, 3).
        largest: length of the largest one, infinite if one is not finite.
        is_solved, is_too_dear, tangents: as in `Estimate`.
    """

    displacement: fem.Function
    nodal: Floats
    moved: Floats
    largest: float
    is_solved: bool = False
    is_too_dear: bool = False
    tangents: int = 1


def _solve_shell(
    equations: Equations,
    solution: Solution,
    finer: Equations,
    rest_correction: Correction | None,
    observer: Observer,
) -> _Found | None:
    """Solve on halved cells; return ``None`` if there is no memory for it; collective."""
    forecast = finer.chooser.forecast
    if forecast.least > equations.chooser.room:
        return None
    budget = _Budget(observer, max(_SHELL_TANGENTS, _tangents_of_finer_solve(equations, solution, forecast)))
    is_solved = halved_cells.solve(equations, solution, finer, budget)
    stop_if_asked(finer.body.mesh.comm, observer)
    result = replace(
        _moved(equations, solution, finer, rest_correction), is_solved=is_solved, tangents=max(budget.used, 1)
    )
    return result if is_solved else replace(result, largest=np.inf)


def _solve_solid(
    equations: Equations,
    solution: Solution,
    finer: Equations,
    rest_correction: Correction | None,
    observer: Observer,
    most: float,
) -> _Found | None:
    """Correct by one Newton step, or solve if that is more than ``most`` (m); ``None`` without memory; collective."""
    forecast = finer_forecast(equations)
    is_affordable = forecast.least <= equations.chooser.room
    is_large = forecast.operations > two_level.MANY
    if not (is_large and two_level.correct(equations, solution.direction, finer, observer)):
        if not is_affordable:
            return None
        equilibrium = finer.equilibrium(finer.weak_form(solution.direction))
        equilibrium.correct(1.0)
        equilibrium.destroy()
    result = _moved(equations, solution, finer, rest_correction)
    if not is_affordable or result.largest <= most:
        return result
    corrected = finer.state()
    budget = _Budget(observer, _tangents_of_finer_solve(equations, solution, forecast))
    if not budget.is_spent and _solve(finer, solution.direction, budget):
        return replace(_moved(equations, solution, finer, rest_correction), is_solved=True)
    finer.put_fields(corrected.fields)
    return replace(result, is_too_dear=budget.is_spent)


def _correction(
    equations: Equations, solution: Solution, finer: Equations, moved: Floats, displacement: fem.Function
) -> Correction:
    nodes = None
    if equations.body.source.midsurface is not None:
        nodes = finer.body.nodes + solution.sign * finer.unknowns.geometry_values(displacement)
    return Correction(moved, displacement, _omitted_geometry(equations), nodes)


class _Budget(IterationObserver):
    """Observer that ends a solve after a number of tangents, the same on all ranks."""

    def __init__(self, observer: Observer, tangents: int) -> None:
        super().__init__(observer)
        self._left, self._of_this_solve = tangents, 0
        self._most = tangents

    @property
    def is_spent(self) -> bool:
        """True if no tangent is left."""
        return self._of_this_solve >= self._left

    @property
    def used(self) -> int:
        """Number of tangents so far."""
        return self._most - self._left + self._of_this_solve

    def iteration(self, iteration: NewtonIteration) -> None:
        super().iteration(iteration)
        self._of_this_solve += iteration.new_tangent

    def solved(self, event: SolveEvent) -> None:
        self._left -= max(event.solve.factorizations, self._of_this_solve)
        self._of_this_solve = 0

    def stop_asked(self) -> bool:
        return self.is_spent or super().stop_asked()


def _tangents_of_finer_solve(equations: Equations, solution: Solution, finer: Forecast) -> int:
    """Return how many tangents the solve of the finer problem may take; collective."""
    ranks = equations.body.mesh.comm.size
    forecast = equations.chooser.forecast
    solve = solution.factorizations * (forecast.tangent(ranks) + _OVERHEAD)
    return int(max(SHARE * solve, LEAST) / (finer.tangent(ranks) + _OVERHEAD))


def _solve(finer: Equations, direction: Direction, observer: Observer) -> bool:
    """Solve the finer problem from the unloaded body; return whether the state is its solution."""
    solved = solve_direction(finer, direction, UNLOADED, observer)
    finer.destroy()
    return solved.load == 1.0


def _moved(equations: Equations, solution: Solution, finer: Equations, rest_correction: Correction | None) -> _Found:
    """Return the difference of the state of ``finer`` from the solution; collective."""
    u = finer.state().displacement
    if equations.body.source.midsurface is not None:
        node_displacement = halved_cells.given_values(equations.body, finer.unknowns.geometry_values(u))
    else:  # a finer geometry has the nodes of the given one at the same places of the cells
        node_displacement = equations.unknowns.geometry_values(u)
    moved = solution.sign * (node_displacement - solution.u)
    if rest_correction is not None:
        moved += rest_correction.nodes
    mine = np.linalg.norm(moved, axis=1)
    # The largest of NaN and a number depends on their order.
    largest = float(mine.max(initial=0.0)) if np.isfinite(mine).all() else np.inf
    return _Found(u, node_displacement, moved, finer.body.mesh.comm.allreduce(largest, op=MPI.MAX))


def _nodes(solution: Solution, rest_correction: Correction | None) -> Floats:
    """Local geometry nodes (m) on which a solution is corrected."""
    return solution.mesh_nodes if rest_correction is None else solution.mesh_nodes + rest_correction.nodes


def _finer_body(equations: Equations, solution: Solution, rest_correction: Correction | None) -> tuple[Body, str]:
    """Return the body with the true geometry, if that is known, and why it is not; collective.

    A state that is solved from the rest shape has the cells of the given mesh.
    """
    if not solution.is_on_given_mesh:
        return (
            equations.body,
            "the rest shape is taken as computed" if rest_correction is None else rest_correction.without_geometry,
        )
    body, unknown = equations.body.true_geometry_body
    return body or equations.body, unknown


def _omitted_geometry(equations: Equations) -> str:
    """Return why the error of the geometry is left out in states that are solved from this one; collective."""
    body, unknown = equations.body.true_geometry_body
    return unknown if body is None or body is equations.body else "it is known for the given mesh only"


def finer_equations(equations: Equations, solution: Solution, rest_correction: Correction | None = None) -> Equations:
    """Return equations in spaces of one degree more, on the finer geometry if one is known; of a shell on halved cells.

    Collective.

    Their state is the solution on the mesh on which it was computed, or, with the correction of the rest shape, on the
    corrected one. The state of the given equations is the solution there too.
    """
    if equations.body.source.midsurface is not None:
        return _halved_equations(equations, solution, rest_correction)
    with equations.timings("mesh"):
        body, _ = _finer_body(equations, solution, rest_correction)
    finer = Equations(one_degree_more(solution.job), body, equations.timings)
    finer.take_supports_as_checked()
    contacts = finer.weak_form(solution.direction).contacts
    contacts.restore(solution.contacts, finer.scales, partial(transfer_function, body.mesh))
    nodes = _nodes(solution, rest_correction)
    equations.put(solution.moved_to(nodes))
    state = replace(finer.unloaded(nodes=nodes if body is equations.body else None), load=solution.load)
    if (other := solution.given_displacement) is not None:
        u = fem.Function(finer.unknowns.displacement_space)
        interpolate(other if rest_correction is None else rest_correction.displacement, u)
        state = replace(state, given_displacement=u)
    extend(solution.displacement, state.displacement)
    if state.pressure is not None:
        assert solution.pressure is not None
        interpolate(solution.pressure, state.pressure)
    _put_with_ghosts(finer, state)
    return finer


def _halved_equations(equations: Equations, solution: Solution, rest_correction: Correction | None) -> Equations:
    """Return equations of a shell on halved cells, in the state of the solution; collective."""
    body, unknowns = equations.body, equations.unknowns
    with equations.timings("mesh"):
        finer = Equations(solution.job, body.halved, equations.timings)
        finer.take_supports_as_checked()
    equations.put(solution.moved_to(_nodes(solution, rest_correction)))
    corrected = None if rest_correction is None else rest_correction.finer_nodes
    nodes = halved_cells.refined_values(body, solution.mesh_nodes) if corrected is None else corrected
    state = replace(finer.unloaded(nodes=None if solution.is_on_given_mesh else nodes), load=solution.load)

    def refined(displacement: fem.Function) -> fem.Function:
        return halved_cells.refined_function(body, unknowns, displacement, finer.unknowns)

    if (other := solution.given_displacement) is not None:
        state = replace(
            state, given_displacement=refined(other) if rest_correction is None else rest_correction.displacement
        )
    state = replace(state, displacement=refined(solution.displacement))
    if solution.pressure is not None:
        pressure = halved_cells.refined_pressure(body, unknowns, solution.pressure, finer.unknowns)
        state = replace(state, pressure=pressure)
    _put_with_ghosts(finer, state)
    return finer


def _put_with_ghosts(equations: Equations, state: State) -> None:
    for function in filter(None, state.fields):
        function.x.scatter_forward()
    equations.put(state)


def finer_forecast(equations: Equations) -> Forecast:
    """Return the forecast for a factorization in spaces of one degree more, of a shell on halved cells; collective."""
    if equations.body.source.midsurface is not None:
        return Equations(equations.job, equations.body.halved, equations.timings).chooser.forecast
    forecast = equations.chooser.forecast
    return forecast.degree_forecast(forecast.degree + 1)


def _corrected(
    quantities: Sequence[QuantityOfInterest], equations: Equations, u: Floats, direction: Direction, finer: Equations
) -> dict[str, QuantityValue]:
    """Return the quantities of interest of the corrected solution, without reactions, in the order of the job.

    Args:
        u: its displacement (m) at the nodes of the equations' body.
    """
    body, better = finer.body, solution_of(finer, direction, finer.weak_form(direction), ())
    nodal_solution = replace(better, mesh_nodes=equations.body.nodes, u=u)
    node_quantities = [q for q in quantities if q.on is not None and not q.uses_quadrature]
    others = _points_moved_inside([q for q in quantities if q not in node_quantities], equations.body, body)
    values = evaluate(node_quantities, equations.body, nodal_solution) | evaluate(others, body, better, finer)
    return {q.name: values[q.name] for q in quantities}


def _points_moved_inside(
    quantities: Sequence[QuantityOfInterest], coarse: Body, body: Body
) -> list[QuantityOfInterest]:
    """Return the quantities; points that are outside ``body``, which has the same cells, are moved with their cells."""
    if body is coarse:
        return list(quantities)
    inside = locate(body, [q.at for q in quantities if q.at])
    outside = [point for point, place in inside.items() if place is None]
    moved = dict[Point, Point]()
    for point, place in locate(coarse, outside).items():
        assert place is not None  # it has a value there
        x, y, z = position(body, place, body.nodes).tolist()
        moved[point] = (x, y, z)
    return [q.model_copy(update={"at": moved[q.at]}) if q.at in moved else q for q in quantities]


def one_degree_more(job: Job) -> Job:
    """Return the job in spaces of one degree more, with the quadrature that they need."""
    spaces = job.discretisation
    finer: dict[str, int] = {"displacement": spaces.displacement + 1}
    if spaces.pressure is not None:
        finer["pressure"] = spaces.pressure + 1
    if spaces.quadrature is not None:
        finer["quadrature"] = spaces.quadrature + 2
    return job.model_copy(update={"discretisation": spaces.model_copy(update=finer)})


def quantities_at_singular_fibres(
    quantities: Sequence[QuantityOfInterest], body: Body, edges: SingularEdges | None
) -> tuple[str, ...]:
    """Return the names of the quantities at a point of a cell with singular fibres; collective.

    Args:
        body: on its given nodes.
    """
    if edges is None or FIBRES not in edges.names:
        return ()
    kind, comm, names = edges.names.index(FIBRES), body.mesh.comm, list[str]()
    for quantity in quantities:
        cells = [] if quantity.at is None else cells_at(body, [quantity.at])
        if comm.allreduce(bool((edges.kinds[np.array(cells, dtype=np.int64)] == kind).any()), op=MPI.LOR):
            names.append(quantity.name)
    return tuple(names)


def _difference(corrected: QuantityValue, computed: QuantityValue) -> QuantityValue:
    if isinstance(corrected, list):
        assert isinstance(computed, list)
        return [a - b for a, b in zip(corrected, computed, strict=True)]
    assert not isinstance(computed, list)
    return corrected - computed


def _extrapolated(computed: QuantityValue, corrected: QuantityValue, factor: float) -> QuantityValue:
    """Return the corrected value with its correction multiplied by ``factor``."""
    if isinstance(corrected, list):
        assert isinstance(computed, list)
        return [a + factor * (b - a) for a, b in zip(computed, corrected, strict=True)]
    assert not isinstance(computed, list)
    return computed + factor * (corrected - computed)


def _cell_indicators(delta: fem.Function, length: float) -> npt.NDArray[np.float64]:
    mesh = delta.function_space.mesh
    constant = fem.functionspace(mesh, ("DG", 0))
    gradient = ufl.grad(delta) / length
    degree = 2 * delta.function_space.ufl_element().degree - 2
    dx = ufl.dx(metadata=quadrature_metadata(mesh.basix_cell().name, degree))
    form = ufl.inner(gradient, gradient) * ufl.TestFunction(constant) * dx
    vector = fem.assemble_vector(fem.form(form))
    owned = mesh.topology.index_map(3).size_local
    return np.asarray(vector.array[constant.dofmap.list[:owned, 0]])
