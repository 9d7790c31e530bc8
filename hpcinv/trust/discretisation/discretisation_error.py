"""Estimate of the discretisation error: the correction of a solution in spaces of one degree more.

A two-level estimate: ``u_h`` is put in the spaces of degree ``k + 1`` on the same mesh, and one Newton correction
``K δ = -R(u_h)`` there gives ``u_h + δ``, whose own error is of higher order. A second correction, with the same
factors, adds what is of second order in δ. Then ``Q(u_h + δ) - Q(u_h)`` estimates the error of any quantity ``Q``, with
its error of quadrature. In small bodies K is factorized; in large ones the factors of the solve precondition Krylov
iterations (`hpcinv.trust.discretisation.two_level`).

Where more is known of the body's geometry than the mesh has (`Body.true_geometry_body`), the finer problem is posed on
the same cells with a geometry of a higher degree. ``u_h`` is taken there by reference coordinates, and so the residual,
the correction and the corrected quantities have the error of the geometry in them, to first order. Elsewhere the
estimate leaves that error out, and says so.

One Newton step says little of a correction that is as large as the displacement. The finer problem is then solved, so
that a certificate fails for an error that was found, and not for one that was extrapolated. That solve ends where it
takes more than a share of the time of the solve; the line is then not decided. Each kind of body has its
finer problem (`hpcinv.trust.discretisation.finer_problem`); shells are always solved.

At re-entrant edges and at edges of supports it finds a part of the error only, and is multiplied by what is missing
(`hpcinv.trust.discretisation.singular_limit`).

The one layer of a shell is the same on halved cells: what it leaves in stresses and near clamps is estimated apart
(`hpcinv.trust.discretisation.layer_errors`).

A further state of a body is corrected on the corrected rest shape, so that its estimate has the error of that in it.

Source: Bank & Weiser, "Some a posteriori error estimators for elliptic partial differential equations" (1985),
doi:10.1090/S0025-5718-1985-0777265-X; Ainsworth & Oden, *A Posteriori Error Estimation in Finite Element Analysis*
(2000), ch. 5, doi:10.1002/9781118032824.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import isfinite

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from hpcinv.base.parallel.runtime import MPI
from hpcinv.job.body_kinds import BodyKind
from hpcinv.job.quantity_of_interest import QuantityOfInterest, QuantityValue
from hpcinv.mesh import Body
from hpcinv.mesh.cells import quadrature_metadata
from hpcinv.mesh.location import Point, cells_at, locate, position
from hpcinv.mesh.source import Floats
from hpcinv.on_demand import variant
from hpcinv.physics.effects import Direction
from hpcinv.results.quantities_of_interest import carried, evaluate
from hpcinv.results.solution import Solution, solution_of
from hpcinv.solver.equations import Equations
from hpcinv.solver.observer import SILENT, Observer, stop_if_asked
from hpcinv.trust.discretisation.estimate import Correction, Estimate
from hpcinv.trust.discretisation.finer_problem import FinerProblem
from hpcinv.trust.discretisation.finer_solid import FinerSolid
from hpcinv.trust.discretisation.singular_edges import FIBRES, SingularEdges, singular_edges
from hpcinv.trust.discretisation.singular_limit import singular_limit


def finer_problem_of(kind: BodyKind) -> type[FinerProblem]:
    """Return the finer problem of a kind of body."""
    return variant(f"finer problem of a {kind.name}", FinerSolid)  # type: ignore[return-value]


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
    problem = finer_problem_of(equations.job.mesh.kind)(equations, solution, rest_correction)
    if not solution.is_on_given_mesh:
        quantities = carried(quantities, equations.body, problem.nodes)
    current = solution.current_nodes if solution.is_on_given_mesh else equations.body.given_nodes
    nodes = {"reference": solution.reference_nodes, "current": current}
    edges = singular_edges(solution.job, equations.body, nodes)
    unreliable = quantities_at_singular_fibres(solution.job.quantities, equations.body, edges)
    finer = problem.equations
    start = finer.state().displacement
    found = problem.solve(observer)
    if found is None:
        return None
    stop_if_asked(finer.body.mesh.comm, observer)
    is_finite = isfinite(found.largest)
    has_values = bool(quantities) and is_finite
    corrected = _corrected(quantities, equations, found.nodal, solution.direction, finer) if has_values else {}
    displacement, change = found.displacement.copy(), problem.change(found, start)
    indicators = _cell_indicators(change, finer.body.length_scale)
    limit = None if edges is None else singular_limit(equations, edges, indicators, change)
    # A correction as large as the displacement is not one of edges.
    missed = limit.factor if limit and not found.is_solved else 1.0
    corrected = {n: _extrapolated(computed[n], v, missed) for n, v in corrected.items() if n in computed}
    return Estimate(
        quantities={name: _difference(value, computed[name]) for name, value in corrected.items()},
        corrected=corrected,
        shape=missed * found.largest,
        cells=indicators,
        limit=limit,
        segments=edges.segments if edges else None,
        unknowns=finer.unknowns.size,
        finer=problem.where,
        tangents=found.tangents,
        is_solved=found.is_solved,
        is_too_dear=found.is_too_dear,
        without_geometry=problem.without_geometry,
        unreliable=unreliable,
        correction=problem.correction(found.moved, displacement) if is_finite else None,
        layer=problem.layer_errors(quantities, computed),
    )


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
