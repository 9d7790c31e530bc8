"""Trial of one discretisation: solution, quantities of interest and estimated errors in a job's first direction."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from dolfinx import fem
from dolfinx.mesh import create_submesh

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.base.quantity.arrays import LocalIndices
from hpcinv.errors import JobError
from hpcinv.job.job import UNNAMED, Job, PlannedSolve
from hpcinv.job.quantity_of_interest import QuantityValue
from hpcinv.mesh import Body
from hpcinv.mesh.interpolation import interpolate
from hpcinv.mesh.source import Floats, Ints
from hpcinv.model.cell_layers import layers_of_cells, layers_on
from hpcinv.results.quantities_of_interest import NOT_FINITE, check_points, evaluate, fault_of
from hpcinv.results.solution import Solution
from hpcinv.results.steps import StepControl, carry_out
from hpcinv.solver.equations import Equations
from hpcinv.solver.methods.method import UNLOADED, Guess, Start
from hpcinv.solver.newton import Solve
from hpcinv.solver.observer import Observer, Observers, SolvedDirection, Stopped
from hpcinv.trust.accuracy.meshes import Variant
from hpcinv.trust.accuracy.refinement_forecast import Step, Work
from hpcinv.trust.discretisation.discretisation_error import estimate
from hpcinv.trust.discretisation.estimate import Estimate

_PHASES = ("tangent", "factorization", "programs")
# A curved surface of one mesh lies outside the straight cells of another, by a share of the larger cell.
_PADDING = 0.2


@dataclass(frozen=True)
class Trial:
    """Results of one discretisation.

    Attributes:
        job: with degrees and mesh parameters of this discretisation.
        variant, body, equations: its mesh and its equations.
        solution: with all solves that led to it, also in earlier trials.
        quantities: the job's quantities of interest; none below the full load.
        estimate: estimated errors of these quantities.
        step: costs on this rank.
        unused_options: PETSc options of the job that were not used.
    """

    job: Job
    variant: Variant
    body: Body
    equations: Equations
    solution: Solution
    quantities: Mapping[str, QuantityValue]
    estimate: Estimate | None
    step: Step
    unused_options: Sequence[str]


def attempt(
    job: Job,
    variant: Variant,
    body: Body,
    timings: Timings,
    observer: Observer,
    last_trial: Trial | None,
) -> Trial:
    """Solve and estimate one discretisation, from the solution of ``last_trial``; collective."""
    observed = _Steps(observer, last_trial)
    with _measured(timings) as solved:
        check_points(job.quantities, body)
        equations = Equations(job, body, timings)
        (solution,) = carry_out(job.plan[:1], [equations], observed)
    reached, solves = solution.load == 1.0, solution.solves
    solution = replace(solution, solves=(*_path(last_trial, equations), *solves))
    quantities: Mapping[str, QuantityValue] = evaluate(job.quantities, body, solution, equations) if reached else {}
    with _measured(timings) as estimated:
        estimated_error = estimate(equations, solution, quantities, observer=observer) if reached else None
    equations.destroy()  # their factors: the next mesh needs the memory
    _check_finite(job, quantities, estimated_error.corrected if estimated_error else {})
    degree, count = job.discretisation.displacement, sum(s.factorizations for s in solves)
    cells, kind = sum(body.partition.cells), job.mesh.kind
    step = Step(
        cell=body.source.kind,
        size=variant.size,
        cells=cells,
        solve=Work(degree, cells, equations.unknowns.size, count, solved["tangent"], solved["factorization"]),
        estimate=Work(
            degree + 1 if kind.raises_degree else degree,
            cells if kind.raises_degree else 2**kind.dimension * cells,
            estimated_error.unknowns if estimated_error else 0,
            estimated_error.tangents if estimated_error else 1,
            estimated["tangent"],
            estimated["factorization"],
        ),
        programs=solved["programs"] + estimated["programs"],
        dimension=kind.dimension,
    )
    return Trial(job, variant, body, equations, solution, quantities, estimated_error, step, observed.unused_options)


def _check_finite(job: Job, *value_sets: Mapping[str, QuantityValue]) -> None:
    """Raise ``JobError`` if a quantity whose accuracy the job demands has no finite value: no mesh would meet it."""
    demanded = [quantity for quantity in job.quantities if quantity.name in job.accuracy]
    faults = {
        q.name: fault
        for q in demanded
        for known in value_sets
        if q.name in known and (fault := fault_of(q, known[q.name]))
    }
    if faults:
        raise JobError(*(f"{job.path or UNNAMED}: quantities: {fault}; {NOT_FINITE}" for fault in faults.values()))


def _path(last_trial: Trial | None, equations: Equations) -> Iterator[Solve]:
    """Yield the solves of earlier trials, with signs of tangents as for the unknowns of ``equations``.

    Each pressure unknown is a negative eigenvalue of a stable state: an odd number more changes the sign.
    """
    if last_trial is not None:
        odd = (equations.unknowns.pressure_size - last_trial.equations.unknowns.pressure_size) % 2
        for solve in last_trial.solution.solves:
            yield replace(solve, signs=tuple(-sign if odd else sign for sign in solve.signs))


class _Steps(StepControl):
    """Observer of the solve of a trial, which begins with the solution of the trial before."""

    def __init__(self, observer: Observer, last_trial: Trial | None) -> None:
        super().__init__(Observers(observer, self))
        self._last_trial = last_trial
        self.unused_options: Sequence[str] = ()

    def choose_start(self, number: int, equations: Equations) -> Start:
        if self._last_trial is None:
            return UNLOADED
        with equations.timings("transfer"):
            guess = guess_from(self._last_trial.solution, self._last_trial.body, equations)
        return Start(guess=guess)

    def check(self, earlier: Sequence[Solution], solved: SolvedDirection, step: PlannedSolve) -> None:
        if solved.stopped:
            raise Stopped

    def ended(self, solved: SolvedDirection) -> None:
        self.unused_options = solved.unused_options or ()


@contextmanager
def _measured(timings: Timings) -> Iterator[dict[str, float]]:
    """Measure the seconds by phase within the context; they are in the mapping when it ends."""
    spent: dict[str, float] = {}
    seconds_before = dict(timings.seconds)
    yield spent
    spent |= {phase: timings.seconds[phase] - seconds_before.get(phase, 0.0) for phase in _PHASES}


def guess_from(solution: Solution, body: Body, equations: Equations) -> Guess | None:
    """Return a solution on another mesh of ``body`` as a guess for equations; collective.

    ``None`` if its cells are curved so strongly that Newton's method does not find a point in them.
    """
    u, p = equations.unloaded().fields
    pairs = [(u, solution.displacement)] if p is None else [(u, solution.displacement), (p, solution.pressure)]
    for new, old in pairs:
        assert old is not None
        if equations.body.source is body.source:
            interpolate(old, new)
        else:
            layers = equations.unknowns.layers if new is p else None
            given = None if layers is None else layers_of_cells(equations.job, body)
            # Coordinates of both meshes have the scale of the new one.
            with body.at(solution.mesh_nodes * (body.length_scale / equations.body.length_scale)):
                is_found = _interpolate_layers(new, old, layers, given)
            if not is_found:
                return None
        new.x.scatter_forward()
    return Guess(u.x.array, None if p is None else p.x.array, strategy="solution on another mesh")


def _interpolate_layers(new: fem.Function, old: fem.Function, layers: Ints | None, given: Ints | None) -> bool:
    """Interpolate between meshes of one body, whose coordinates have the same scale; return whether that was possible.

    Args:
        layers: number of the layer of each local cell of the new mesh.
        given: the same of the old mesh. Pressures are interpolated within a layer.
    """
    here, there = new.function_space.mesh, old.function_space.mesh
    owned = [np.arange(m.topology.index_map(3).size_local, dtype=np.int32) for m in (here, there)]
    padding = _PADDING * here.comm.allreduce(float(there.h(3, owned[1]).max(initial=0.0)), op=MPI.MAX)
    if layers is None or given is None:
        is_found = _interpolate_across(new, old, owned[0], padding)
    else:
        is_found = True
        for layer in layers_on(here.comm, given):
            cells = owned[0][layers[: len(owned[0])] == layer]
            part = _restricted(old, owned[1][given[: len(owned[1])] == layer])
            is_found = is_found and _interpolate_across(new, part, cells, padding)
    new.x.scatter_forward()
    return is_found


def _interpolate_across(new: fem.Function, old: fem.Function, cells: LocalIndices, padding: float) -> bool:
    data = fem.create_interpolation_data(new.function_space, old.function_space, cells, padding=padding)
    # A rank that fails within the interpolation would leave the others waiting.
    fails = new.function_space.mesh.comm.allreduce(_fails_at(old, data.dest_points, data.dest_cells), op=MPI.LOR)
    if not fails:
        new.interpolate_nonmatching(old, cells, data)
    return not fails


def _fails_at(function: fem.Function, points: Floats, cells: Ints) -> bool:
    """Return whether a function cannot be evaluated at points of this rank."""
    try:
        if len(points):
            function.eval(points, cells)
    except RuntimeError:  # of Newton's method for the place in a curved cell
        return True
    return False


def _restricted(function: fem.Function, cells: LocalIndices) -> fem.Function:
    """Return a function on a mesh of some owned cells, by themselves; collective."""
    mesh = function.function_space.mesh
    part, entity_map = create_submesh(mesh, 3, cells)[:2]
    restricted = fem.Function(fem.functionspace(part, function.function_space.ufl_element()))
    own = np.arange(part.topology.index_map(3).size_local, dtype=np.int32)
    restricted.interpolate(function, entity_map.sub_topology_to_topology(own, False), own)
    restricted.x.scatter_forward()
    return restricted
