"""Run of a job without its solves, on a few cells, which compiles every kernel that the job needs.

Kernels depend on the kind and degree of cells and spaces, on laws, effects and what is computed from them, and not on
the mesh. So the functions of a run are called as the run calls them, with a body that does not move, where each cell is
held by itself. What asks for a kernel in a run does so here, whatever it is.
"""

import numpy as np

from hpcinv.assembly.tangent import as_for
from hpcinv.certificate import certify, two_level
from hpcinv.certificate.confirmation import known_displacement, second_variation
from hpcinv.certificate.estimate import in_finer_spaces
from hpcinv.certificate.round_trip import way_back
from hpcinv.job.job import Job
from hpcinv.job.sections import Support
from hpcinv.mesh.body import read_anywhere, read_finer_geometry
from hpcinv.mesh.sample_mesh import HELD, sample_body
from hpcinv.mesh.source import MeshSource
from hpcinv.methods import method_for
from hpcinv.parallel.runtime import MPI
from hpcinv.parallel.timings import Timings
from hpcinv.results.quantities_of_interest import evaluate
from hpcinv.results.solution import Solution, solution_of
from hpcinv.sensitivity.analysis import sensitivities
from hpcinv.solver.linear.iterative import Iterative
from hpcinv.solver.problem import Model


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
    body = sample_body(source, job.regions, [np.array(q.at) for q in job.quantities if q.at is not None], finer)
    model = Model(_held(job), body, Timings())
    solutions: list[Solution] = []
    for direction in model.job.directions:
        model.unknowns.state.x.array[:] = 0.0
        equilibrium = method_for(model, direction).equilibrium
        equilibrium.system.scene.parameters.set_load(1.0)
        equilibrium.compile(prescribed_motion=any(support.displacement for support in job.supports))
        solutions.append(solution_of(model, direction, model.scene(direction), ()))
        model.release(equilibrium)
    quantities = evaluate(job.quantities, body, solutions[0], model)
    sensitivities(model, solutions[0])
    certify(model, solutions, quantities)
    if job.certificate.estimate:
        with in_finer_spaces(model, solutions[0]) as finer_model:
            two_level.correct(model, solutions[0], finer_model)  # needed for large bodies
    if job.certificate.stability:
        second_variation(model, known_displacement(model))  # needed where the body is not stable
        Iterative(model.scene("forward")).pressure_scale()  # needed where factors are not affordable
    if job.certificate.round_trip == "near" and len(solutions) == 1:  # needed where corrections do not settle
        model.release(model.equilibrium(model.scene(way_back(solutions[0]))))
    model.destroy()


def _held(job: Job) -> Job:
    """Return the job with supports on all cells, which need no kernels, and the linear solver with most kernels."""
    supports = (Support(region=HELD, fix=("x", "y", "z")),)
    keys = {key: sd for key, sd in job.sensitivities.items() if not key.startswith("supports[")}
    solver = job.solver if job.solver.linear == "direct" else job.solver.model_copy(update={"linear": "iterative"})
    return job.model_copy(update={"supports": supports, "sensitivities": keys, "solver": solver})
