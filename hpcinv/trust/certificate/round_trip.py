"""Round trip: the return solve, from the computed body in the opposite direction.

Near the known displacement the return solve needs no factors of its own. Forward, its tangent is the one by which
stability is judged, and its factors, or multigrid instead, give the corrections. In the inverse direction they do so
after a change of variables. To move points of the reference body by ``-w`` and points of the loaded body by ``-F w``
only relabels them. This changes the residual by no more than the discretisation error, so the inverse tangent is
``K F`` with the forward tangent ``K``. Neither this nor the symmetric part of ``K`` is the exact tangent; Anderson's
acceleration makes up for the difference. The residual is exact in any case: the corrections converge to the solution.

Corrections end as soon as what is left of them cannot change the verdict. With a contraction ``θ`` of successive steps
that is about ``θ/(1-θ)`` times the last one, where ``θ`` is the largest of the last three ratios. Where they do not
settle, Newton's method takes over.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from math import isfinite

import numpy as np
import numpy.typing as npt
from dolfinx import la

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.units import readable
from hpcinv.base.updates import Anderson
from hpcinv.mesh.source import Floats
from hpcinv.model.assembly.system import System
from hpcinv.model.quadrature_values import CellMeans
from hpcinv.physics.effects import Direction
from hpcinv.results.displacement_scale import displacement_scale
from hpcinv.results.solution import Solution
from hpcinv.solver.equations import Equations
from hpcinv.solver.methods import solve_direction
from hpcinv.solver.methods.method import UNLOADED
from hpcinv.solver.observer import SILENT, IterationObserver, Observer, stop_if_asked
from hpcinv.trust.certificate.certify import Check, CheckedRun
from hpcinv.trust.certificate.check import Line, Verdict, judged_with_given_numbers, skipped, topic, upper_bound_line
from hpcinv.trust.stability.forward_factors import ForwardFactors, TangentSolver
from hpcinv.trust.stability.inertia import SymmetricFactors

ROUND_TRIP = topic(
    "round trip, relative to the displacement",
    "The computed body is solved back; its distance from the given body must vanish.",
    "Read the line on stability: the return solve may lead to another state.",
    "Try 'certificate: {round_trip: path}', or a smaller solver.initial_step.",
    computed="distance of the given body from the one that is solved back",
    thresholds="above 1e-3 and all other errors of the shape; above 0.1",
    costs="a factorization; with `path` a solve",
)
WARN, FAIL = 1e-3, 0.1

_CORRECTIONS = 15  # of one return solve, with the same factors
_MEMORY = 6  # steps that Anderson's acceleration uses
_ACCURACY = 1e-6  # of the return solve near the solution, relative to the displacement: a thousandth of `WARN`
_KNOWN, _ROUGHLY_KNOWN = 0.1, 0.25  # share of its value to which the line is known, by factors or by multigrid
_ROUND_OFF = 1e-9  # size of a step, relative to the displacement; below it the ratio of steps means nothing
_GROWTH = 1.0  # of a step over the first one; above it the corrections are given up: they do not contract


class RoundTripCheck(Check):
    """Check that the given body comes back, judged by the largest other error of the shape."""

    name, order = "round trip", 100
    has_switch = True

    def lines(self, run: CheckedRun) -> Iterator[Line]:
        equations, solution, estimate = run.equations, run.solution, run.estimate
        if len(run.solutions) > 1:
            checked = iter([closure_error(equations, solution, run.solutions[1].u)])
        else:
            checked = round_trip(equations, solution, run.forward, run.observer)
            if run.has_unknown_loads:
                checked = judged_with_given_numbers(checked)
        error = 0.0 if estimate is None or not isfinite(estimate.shape) else estimate.shape
        for line in checked:
            scale = displacement_scale(equations, solution).length
            yield _with_assumptions(_judged(line, scale, max(run.deviation, error)), solution)


def _with_assumptions(line: Line, solution: Solution) -> Line:
    """Return the line with what it cannot confirm: bodies come back with any contact pressure."""
    if line.value is None or not any(interface.closure for interface in solution.job.all_interfaces):
        return line
    note = "any pressure between the bodies closes: this does not confirm the assumed one"
    return replace(line, note="; ".join(filter(None, [line.note, note])))


def _judged(line: Line, scale: float, largest: float) -> Line:
    """Return the line, relative to ``scale``, judged by the largest other error of the shape (m)."""
    if line.verdict is not Verdict.WARN or (line.value or 0.0) * scale > largest:
        return line
    note = f"{line.note}; the shape has a larger error of {readable(largest, 'm')}"
    return replace(line, verdict=Verdict.PASS, note=note)


def round_trip(
    equations: Equations, solution: Solution, forward: ForwardFactors, observer: Observer = SILENT
) -> Iterator[Line]:
    """Solve back from the body that a solution found, and compare the displacements; collective.

    The two directions are exact discrete inverses, since the cells' geometry has the degree of the displacement.

    Args:
        forward: factors of the forward tangent at the solution.
        observer: of the solve back, where the factors do not suffice; it is also asked whether to stop.
    """
    start = solution.job.certificate.round_trip
    if start == "off":
        yield skipped(ROUND_TRIP, "switched off: certificate.round_trip")
    elif start == "near":
        yield return_solve(equations, solution, forward, observer)
    else:
        yield _path_line(equations, solution, observer)


def closure_error(equations: Equations, solution: Solution, back: np.ndarray) -> Line:
    """Compare a solution's displacements with those (m) of the solve back at the same nodes; collective."""
    difference, scale = _difference(equations, solution, back), displacement_scale(equations, solution)
    note = "; ".join(filter(None, [readable(difference, "m"), scale.note]))
    return upper_bound_line(ROUND_TRIP, scale.share(difference), WARN, FAIL, note=note)


def _closed(equations: Equations, solution: Solution) -> Line:
    """Return the line of a return solve that ended in the present state of the equations."""
    return closure_error(equations, solution, equations.unknowns.geometry_values(equations.state().displacement))


def _difference(equations: Equations, solution: Solution, back: np.ndarray) -> float:
    largest = float(np.linalg.norm(back - solution.u, axis=1).max(initial=0.0))
    return float(equations.body.mesh.comm.allreduce(largest, op=MPI.MAX))


def opposite_direction(solution: Solution) -> Direction:
    """Return the direction opposite to a solution's."""
    return "forward" if solution.direction == "inverse" else "inverse"


def return_solve(
    equations: Equations, solution: Solution, forward: ForwardFactors, observer: Observer = SILENT
) -> Line:
    """Return the line of a return solve that begins with the solution, and is bounded in effort; collective."""
    solver = forward.factors if forward.affordable else forward.multigrid
    other_body = solution.moved_to(solution.other_nodes)
    if solver is not None and _ReturnSolve(equations, solution, solver).settles(observer):
        return _closed(equations, solution)
    if not forward.affordable:
        forward.destroy()  # the tangent of multigrid is assembled again
    equations.put(other_body)
    equilibrium = equations.equilibrium(equations.weak_form(opposite_direction(solution)), observer)
    last = equilibrium.solve(1.0, max(solution.job.solver.tolerance, _ACCURACY), begins_near=True)
    equations.release(equilibrium)
    if last.outcome.accepted:
        return _closed(equations, solution)
    note = f"near the known displacement the solve back did not converge: {last.outcome.text}"
    return Line(ROUND_TRIP, None, "", "the solve back must converge", Verdict.UNDECIDED, note)


def _path_line(equations: Equations, solution: Solution, observer: Observer) -> Line:
    """Return the line of a return solve that begins with the unloaded body."""
    nodes, given = solution.other_nodes, solution.given_displacement
    equations.put(equations.unloaded(solution.job, nodes, given, solution.contacts))
    solved = solve_direction(equations, opposite_direction(solution), UNLOADED, IterationObserver(observer))
    if solved.load == 1.0:
        return _closed(equations, solution)
    reason = solved.solves[-1].outcome.text if solved.solves else "it was stopped"
    note = f"the solve back from the unloaded body stopped at load factor {solved.load:.4g}: {reason}"
    return Line(ROUND_TRIP, None, "", "the solve back must converge", Verdict.UNDECIDED, note)


class _ReturnSolve:
    """Corrections of the return solve with a solver of the forward tangent; the state of the equations is the iterate.

    Args:
        solver: factors of the forward tangent, or multigrid.
    """

    def __init__(self, equations: Equations, solution: Solution, solver: TangentSolver) -> None:
        self._equations, self._solution, self._solver = equations, solution, solver
        self._scale = displacement_scale(equations, solution)
        self._inverse = _Relabelling(equations, solution) if solution.direction == "forward" else None
        equations.put(solution.moved_to(solution.other_nodes))
        self._share = _KNOWN if isinstance(solver, SymmetricFactors) else _ROUGHLY_KNOWN
        unknowns = equations.unknowns
        self._system = System(equations.weak_form(opposite_direction(solution)), equations.supports, equations.timings)
        self._system.set_load(1.0)
        self._u = unknowns.owned_displacement_dofs
        self._p = np.zeros(0, dtype=np.int32) if unknowns.p is None else unknowns.owned_pressure_dofs
        self._size = self._scale.length / equations.scales.length or 1.0

    def settles(self, observer: Observer = SILENT) -> bool:
        """Correct the state until the verdict cannot change; return whether it settled; collective."""
        system = self._system
        x, y = system.position(), system.rhs.duplicate()
        norms = [self._norm(np.array(x.array), part) or 1.0 for part in (self._u, self._p)]
        update = Anderson(1.0, _MEMORY, lambda a, b: self._inner(a, b, norms))
        steps: list[float] = []
        try:
            for _ in range(_CORRECTIONS):
                stop_if_asked(system.comm, observer)
                system.residual(system.rhs)
                with self._equations.timings("linear solve"):
                    if not self._solver.solve(system.rhs, y):
                        return False
                correction = np.array(y.array)
                if self._inverse is not None:
                    self._inverse.apply(correction)
                step = update.step(np.array(x.array), correction)
                steps.append(self._largest(step) / self._size)
                if not steps[-1] <= _GROWTH * steps[0]:  # also if it is not a number
                    return False
                x.array[:] += step
                system.set_state(x)
                if self._is_settled(steps):
                    return system.fault_of_solution() is None
            return False
        finally:
            for petsc_object in (x, y, system):
                petsc_object.destroy()

    def _is_settled(self, steps: list[float]) -> bool:
        """Return whether further steps can change neither the verdict nor the value by more than a share of it."""
        if len(steps) < 2:
            return steps[-1] <= _ROUND_OFF
        left = remaining(steps)
        u = self._equations.unknowns.geometry_values(self._equations.state().displacement)
        share = self._scale.share(_difference(self._equations, self._solution, u))
        same = all(share + left <= bound or share - left > bound for bound in (WARN, FAIL))
        return same and left <= max(self._share * share, _ACCURACY)

    def _inner(self, a: Floats, b: Floats, norms: list[float]) -> float:
        """Return the inner product with displacements and pressures relative to their norms in the solution."""
        parts = zip((self._u, self._p), norms, strict=True)
        return float(self._system.comm.allreduce(sum(float(a[part] @ b[part]) / norm**2 for part, norm in parts)))

    def _norm(self, a: Floats, part: npt.NDArray[np.int32]) -> float:
        return float(np.sqrt(self._system.comm.allreduce(float(a[part] @ a[part]))))

    def _largest(self, step: Floats) -> float:
        moved = np.linalg.norm(step[self._u].reshape(-1, 3), axis=1)
        # The largest of NaN and a number depends on their order.
        mine = float(moved.max(initial=0.0)) if np.isfinite(moved).all() else np.inf
        return float(self._system.comm.allreduce(mine, op=MPI.MAX))


def remaining(steps: list[float]) -> float:
    """Return a bound of what is left of a convergent sequence, from the sizes of its steps; infinite without one."""
    if steps[-1] <= _ROUND_OFF:
        return steps[-1]
    ratios = [following / previous for previous, following in pairwise(steps)]
    theta = max(ratios[-3:], default=1.0)
    return theta / (1 - theta) * steps[-1] if theta < 1 else float("inf")


class _Relabelling:
    """Approximate ``F⁻¹`` at the nodes of the displacement, from means over the cells around each of them."""

    def __init__(self, equations: Equations, solution: Solution) -> None:
        unknowns, mesh = equations.unknowns, equations.body.mesh
        equations.put(solution.moved_to(solution.reference_nodes))
        weak_form = equations.weak_form("forward")
        with equations.timings("programs"):
            means = CellMeans([(weak_form.H, None)], mesh, weak_form.quadrature_degree)
        with equations.timings("evaluation"):
            H = means()
        cells = mesh.topology.index_map(3).size_local
        dofmap = unknowns.displacement_space.dofmap
        sums = la.vector(dofmap.index_map, 10)
        totals = sums.array.reshape(-1, 10)
        cell_values = np.ones((cells, 10))
        cell_values[:, :9] = H.x.array.reshape(-1, 9)[H.function_space.dofmap.list[:cells, 0]]
        np.add.at(totals, dofmap.list[:cells], cell_values[:, None])
        sums.scatter_reverse(la.InsertMode.add)
        sums.scatter_forward()
        owned = totals[: dofmap.index_map.size_local]
        F = np.eye(3) + (owned[:, :9] / owned[:, 9:]).reshape(-1, 3, 3)
        F[~(np.linalg.det(F) > 0.0)] = np.eye(3)  # means of very different cells
        self._inverse = np.linalg.inv(F)
        self._dofs = unknowns.owned_displacement_dofs
        self._supports = equations.supports

    def apply(self, correction: Floats) -> None:
        """Multiply the displacements of a correction by ``F⁻¹``, but those that are prescribed."""
        kept = self._supports.held_part(correction)
        u = correction[self._dofs].reshape(-1, 3)
        correction[self._dofs] = np.einsum("nij,nj->ni", self._inverse, u).ravel()
        self._supports.free(correction)
        correction += kept
