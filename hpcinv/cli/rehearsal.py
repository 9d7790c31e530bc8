"""Run of a job without its solves, on a few cells, which compiles every kernel that the job needs.

Kernels depend on the kind and degree of cells and spaces, on laws, effects and what is computed from them, and not on
the mesh. So the functions of a run are called as the run calls them, with a body that does not move, where each cell is
held by itself. What asks for a kernel in a run does so here, whatever it is.
"""

from collections.abc import Sequence

import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.base.quantity.keys import parse_key
from hpcinv.job.job import Job, PlannedSolve
from hpcinv.job.sections import Support
from hpcinv.mesh.body import read_anywhere, read_finer_geometry
from hpcinv.mesh.sample_mesh import HELD, sample_body
from hpcinv.mesh.source import MeshSource
from hpcinv.model.assembly.tangent import tangents_for
from hpcinv.model.fibre_directions import assume_directions
from hpcinv.results.quantities_of_interest import evaluate
from hpcinv.results.solution import Solution
from hpcinv.results.steps import StepControl, carry_out
from hpcinv.solver.equations import Equations
from hpcinv.solver.linear.iterative import Iterative
from hpcinv.solver.methods import method_for
from hpcinv.solver.methods.method import Start
from hpcinv.solver.observer import SolvedDirection
from hpcinv.solver.workspace import Workspace
from hpcinv.trust.certificate import CheckedRun, certify, two_level
from hpcinv.trust.certificate.confirmation import given_u_of, second_variation
from hpcinv.trust.certificate.discretisation_error import finer_equations
from hpcinv.trust.certificate.round_trip import opposite_direction
from hpcinv.trust.sensitivity.analysis import Sensitivities, sensitivities


def rehearse(job: Job) -> None:
    """Compile the kernels of a job on this process.

    Not known beforehand are the degrees that a search for an accuracy may go on to, and where in its cell a point lies
    at which a quantity asks for stress, energy or volume ratio, if that is on the border of two.

    Raises:
        MeshError, SystemPartMissing: as a run would.
    """
    source = read_anywhere(job.mesh, job.resolve, MPI.COMM_SELF)
    moved = [any(s.moves or s.surface for s in step.job.supports) or step.start is not None for step in job.plan]
    if moved and job.solver.start_shape is not None:
        moved[0] = True

    def compile_step(
        number: int, step: PlannedSolve, equations: Equations, start: Start, control: StepControl
    ) -> tuple[SolvedDirection, None]:
        """Compile the kernels of a solve; its solution is the body that does not move."""
        equilibrium = method_for(equations, step.direction).equilibrium
        equilibrium.system.compile()
        equilibrium.compile(prescribed_motion=moved[number])
        equations.release(equilibrium)
        return SolvedDirection(step.direction, (), 1.0, equilibrium.linear.used, False, False, None), None

    job = _job_with_all_kernels(job, source)
    finer = None
    if job.certificate.estimate and not source.is_partitioned:
        finer = read_finer_geometry(job.mesh, job.resolve(job.mesh.file), source)
    points = [np.array(q.at) for q in job.quantities if q.at is not None]
    with tangents_for(len(source.cells)), Workspace(MPI.COMM_SELF) as workspace:
        body = sample_body(source, job.regions, points, finer).raise_degree(job.discretisation.displacement)
        for name, family in job.families.items():
            if family.rule is not None:
                assume_directions(body, family.rule, name)
        held = _held(job)
        all_equations = workspace.equations(held, body, Timings())
        solutions: list[Solution] = []
        slopes: list[Sensitivities] = []
        steps = carry_out(held.plan, all_equations, StepControl(), solve=compile_step)
        for number, (step, equations, solution) in enumerate(zip(held.plan, all_equations, steps, strict=True)):
            solutions.append(solution)
            if (parameters := job.differentiated) and (number == 0 or step.job.state):
                given = (solutions[0], slopes[0]) if step.mesh is not None else None
                slopes.append(sensitivities(equations, solution, parameters, given))
        if not job.states:
            _check(all_equations[0], solutions)
        else:
            _check_states(all_equations, solutions)


def _job_with_all_kernels(job: Job, source: MeshSource) -> Job:
    """Return the job with the linear solver that has most kernels, and what a sample of its mesh can do."""
    solver = job.solver if job.solver.linear == "direct" else job.solver.model_copy(update={"linear": "iterative"})
    job = job.model_copy(update={"solver": solver})
    if source.midsurface is None:
        return job
    # A sample has no surface to be cut into four.
    return job.model_copy(update={"certificate": job.certificate.model_copy(update={"estimate": False})})


def _check_states(all_equations: Sequence[Equations], solutions: Sequence[Solution]) -> None:
    """Compile what evaluates and checks the solutions of all states, once where they share it."""
    known = set[tuple[int, str, bool]]()
    for equations, solution in zip(all_equations, solutions, strict=False):
        equations.put(solution)
        kernels = (id(equations), solution.direction, equations.has_attached)
        if kernels not in known:
            known.add(kernels)
            _check(equations, [solution])


def _check(equations: Equations, solutions: list[Solution]) -> None:
    """Compile what evaluates and checks a solution, or both of an analysis, on meshes of any size."""
    job, solution = solutions[0].job, solutions[0]
    certify(CheckedRun(equations, solutions, evaluate(job.quantities, equations.body, solution, equations)))
    if job.certificate.estimate:
        finer = finer_equations(equations, solution)
        if job.mesh.shell is None:
            two_level.correct(equations, solution.direction, finer)  # needed for large bodies
        equations.put(solution)
    if job.certificate.stability:
        second_variation(equations, given_u_of(equations))  # needed where the body is not stable
        Iterative(equations.weak_form("forward")).pressure_scale()  # needed where factors are not affordable
    if job.certificate.round_trip == "near" and len(solutions) == 1:  # needed where corrections do not settle
        equilibrium = equations.equilibrium(equations.weak_form(opposite_direction(solution)))
        equilibrium.system.compile()
        equations.release(equilibrium)


def _held(job: Job) -> Job:
    """Return the job with supports on all cells, which need no kernels."""
    supports = (Support(region=HELD, fix=("x", "y", "z")),)
    states = tuple(s if s.is_rest else s.model_copy(update={"supports": supports}) for s in job.states)
    keys = {key: entry for key, entry in job.sensitivities.items() if "supports" not in parse_key(key)}
    return job.model_copy(update={"supports": supports, "states": states, "sensitivities": keys})
