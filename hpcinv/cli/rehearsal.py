"""Run of a job without its solves, on a few cells, which compiles every kernel that the job needs.

Kernels depend on the kind and degree of cells and spaces, on laws, effects and what is computed from them, and not on
the mesh. So the functions of a run are called as the run calls them, with a body that does not move, where each cell is
held by itself. What asks for a kernel in a run does so here, whatever it is.
"""

import numpy as np

from hpcinv.assembly.tangent import as_for
from hpcinv.certificate import certify, two_level
from hpcinv.certificate.confirmation import known_displacement, second_variation
from hpcinv.certificate.discretisation_error import finer_equations
from hpcinv.certificate.round_trip import way_back
from hpcinv.job.job import Job, PlannedSolve
from hpcinv.job.sections import Support
from hpcinv.mesh.body import read_anywhere, read_finer_geometry
from hpcinv.mesh.sample_mesh import HELD, sample_body
from hpcinv.mesh.source import MeshSource
from hpcinv.methods import method_for
from hpcinv.methods.method import Start
from hpcinv.parallel.runtime import MPI
from hpcinv.parallel.timings import Timings
from hpcinv.quantity.keys import parse_key
from hpcinv.results.quantities_of_interest import evaluate
from hpcinv.results.solution import Solution
from hpcinv.results.steps import StepObserver, carry_out
from hpcinv.sensitivity.analysis import Sensitivities, sensitivities
from hpcinv.solver.equations import Equations
from hpcinv.solver.linear.iterative import Iterative
from hpcinv.solver.observer import SolvedDirection
from hpcinv.solver.workspace import Workspace


def rehearse(job: Job) -> None:
    """Compile the kernels of a job on this process.

    Not known beforehand are the degrees that a search for an accuracy may go on to, and where in its cell a point lies
    at which a quantity asks for stress, energy or volume ratio, if that is on the border of two.

    Raises:
        MeshError, SystemPartMissing: as a run would.
    """
    source = read_anywhere(job.mesh, job.resolve, MPI.COMM_SELF)
    with as_for(len(source.cells)):
        _rehearse(job, source)


def _rehearse(job: Job, source: MeshSource) -> None:
    finer = None
    if job.certificate.estimate and not source.is_partitioned:
        finer = read_finer_geometry(job.mesh, job.resolve(job.mesh.file), source)
    points = [np.array(q.at) for q in job.quantities if q.at is not None]
    body = sample_body(source, job.regions, points, finer).raise_degree(job.discretisation.displacement)
    moved = [any(s.moves for s in step.job.supports) or step.start is not None for step in job.plan]

    def compile_step(
        number: int, step: PlannedSolve, equations: Equations, start: Start, observer: StepObserver
    ) -> tuple[SolvedDirection, None]:
        """Compile the kernels of a solve; its solution is the body that does not move."""
        equilibrium = method_for(equations, step.direction).equilibrium
        equilibrium.system.scene.parameters.set_load(1.0)
        equilibrium.system.compile()
        equilibrium.compile(prescribed_motion=moved[number])
        equations.release(equilibrium)
        return SolvedDirection(step.direction, (), 1.0, equilibrium.linear.used, False, False, None), None

    held = _held(job)
    with Workspace(MPI.COMM_SELF) as workspace:
        all_equations = workspace.equations(held, body, Timings())
        solutions: list[Solution] = []
        slopes: list[Sensitivities] = []
        steps = carry_out(held.plan, all_equations, StepObserver(), solve=compile_step)
        for number, (step, equations, solution) in enumerate(zip(held.plan, all_equations, steps, strict=True)):
            solutions.append(solution)
            if (parameters := job.differentiated) and (number == 0 or step.job.state):
                given = (solutions[0], slopes[0]) if step.mesh is not None else None
                slopes.append(sensitivities(equations, solution, parameters, given))
        if not job.states:
            _check(all_equations[0], solutions)
        known = set[tuple[int, str, bool]]()
        for equations, solution in zip(all_equations, solutions if job.states else (), strict=False):
            equations.put(solution)
            kernels = (id(equations), solution.direction, equations.has_attached)
            if kernels not in known:
                known.add(kernels)
                _check(equations, [solution])


def _check(equations: Equations, solutions: list[Solution]) -> None:
    """Compile what evaluates and checks a solution, or both of an analysis."""
    job, solution = solutions[0].job, solutions[0]
    certify(equations, solutions, evaluate(job.quantities, equations.body, solution, equations))
    if job.certificate.estimate:
        finer = finer_equations(equations, solution)
        two_level.correct(equations, solution.direction, finer)  # needed for large bodies
        equations.put(solution)
    if job.certificate.stability:
        second_variation(equations, known_displacement(equations))  # needed where the body is not stable
        Iterative(equations.scene("forward")).pressure_scale()  # needed where factors are not affordable
    if job.certificate.round_trip == "near" and len(solutions) == 1:  # needed where corrections do not settle
        equilibrium = equations.equilibrium(equations.scene(way_back(solution)))
        equilibrium.system.compile()
        equations.release(equilibrium)


def _held(job: Job) -> Job:
    """Return the job with supports on all cells, which need no kernels, and the linear solver with most kernels."""
    supports = (Support(region=HELD, fix=("x", "y", "z")),)
    states = tuple(s if s.is_rest else s.model_copy(update={"supports": supports}) for s in job.states)
    keys = {key: entry for key, entry in job.sensitivities.items() if "supports" not in parse_key(key)}
    solver = job.solver if job.solver.linear == "direct" else job.solver.model_copy(update={"linear": "iterative"})
    return job.model_copy(update={"supports": supports, "states": states, "sensitivities": keys, "solver": solver})
