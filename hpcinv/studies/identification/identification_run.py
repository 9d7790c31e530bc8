"""Flow of an identification: evaluations and estimate, then one run of the job at the estimate.

A directory has ``identification.json``, ``sections.yaml`` (of the job, at the estimate), ``curve-NAME.png``,
``posterior-SHAPE.vtu``, ``run/`` (the run there) and ``evaluations/``. A command that was killed continues from them:
the least squares take the same steps again, and find there what was evaluated before.
"""

import dataclasses
import json
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from hpcinv.base.files.atomic import create, output_errors, replace
from hpcinv.base.files.directory_lock import DirectoryLock
from hpcinv.base.files.json_data import json_data
from hpcinv.base.files.names import check_output
from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.base.quantity.written_units import as_shown, written_units
from hpcinv.base.reading.door import admitted
from hpcinv.driver import run
from hpcinv.errors import Interrupted, OutputError
from hpcinv.job.job import Job
from hpcinv.mesh.mesh_files import save_body
from hpcinv.mesh.source import DataArray, Floats, MeshSource
from hpcinv.output.result import Result
from hpcinv.solver.workspace import Workspace
from hpcinv.studies.identification.fitted_curves import FittedCurve, fitted_curves, picture
from hpcinv.studies.identification.identification_report import as_data, changes, derivatives, sections
from hpcinv.studies.identification.job_evaluation import Evaluation, Evaluations, SolveTimer
from hpcinv.studies.identification.parameter_estimate import ParameterEstimate, Report, estimate
from hpcinv.studies.identification.shares import shares_of, teams_of

_ORIGIN, _FIGURES, _SECTIONS, _RUN = "identification-origin.json", "identification.json", "sections.yaml", "run"


@dataclass(frozen=True)
class IdentificationCost:
    """Time of an identification, with the time of earlier commands.

    Attributes:
        evaluations: number of evaluations, each of which solves all states.
        kept: how many of them earlier commands have made.
        seconds: of all evaluations.
        unit: seconds of one solve of the first state at the estimate, from the unloaded body.
        factorizations: of all evaluations, and of that one solve.
    """

    evaluations: int
    kept: int
    seconds: float
    unit: float
    factorizations: tuple[int, int]

    def __str__(self) -> str:
        kept = f" ({self.kept} of them made before)" if self.kept else ""
        return (
            f"{self.evaluations} evaluations of all states{kept} took {self.seconds:.3g} s, as long as"
            f" {self.seconds / self.unit:.3g} solves of the first state ({self.unit:.3g} s,"
            f" {self.factorizations[1]} factorizations); {self.factorizations[0]} factorizations"
        )


@dataclass(frozen=True)
class Identified:
    """Result of an identification.

    Attributes:
        result: the run of the job at the estimate; its rest shape is the one that was sought.
        shape_deviations: largest standard deviation of a node's position by computed shape, in m, with the correlations
            of the parameters; ``""`` is the one shape of a job without states.
        quantity_deviations: standard deviations of the quantities, likewise.
        curves: pressure-volume curves at the estimate.
    """

    estimate: ParameterEstimate
    job: Job
    result: Result
    cost: IdentificationCost
    shape_deviations: dict[str, float]
    quantity_deviations: dict[str, float | list[float]]
    curves: list[FittedCurve]

    @property
    def units(self) -> Mapping[str, str]:
        """SI units of the quantities by name."""
        return getattr(self.result.quantities, "units", {})

    def quantity_text(self, name: str) -> str:
        """Return a quantity with its standard deviation, in the units of the job."""
        unit, symbols = self.units.get(name, ""), written_units(self.job.data)
        value, deviation = self.result.quantities[name], self.quantity_deviations[name]
        return f"{as_shown(value, unit, symbols)} ± {as_shown(deviation, unit, symbols, 2)}"


def identify(
    job: Job,
    comm: MPI.Intracomm = MPI.COMM_WORLD,
    *,
    directory: Path | None = None,
    overwrite: bool = False,
    report: Report = lambda *_: None,
    stop_asked: Callable[[], bool] = lambda: False,
    workspace: Workspace | None = None,
    ranks_per_state: int | None = None,
    samples: int = 0,
) -> Identified:
    """Find the parameters in the section ``identify`` of a job, and its rest shape, on all ranks; collective.

    Args:
        directory: of results and evaluations; an identification of the same job goes on from them; ``None`` writes
            nothing.
        overwrite: whether another identification there may be replaced.
        report: called on rank 0 after each evaluation.
        stop_asked: called on every rank before each Newton iteration; true ends the run.
        workspace: body and equations of earlier runs on ``comm``.
        ranks_per_state: ranks of each team that solves some of the states; by default all ranks solve each state.
        samples: number of exact evaluations of the posterior's second stage; 0 for no posterior.

    Raises:
        JobError, MeshError, OutputError: the same on every rank.
        SolveError: with the starting values, or at the estimate, a state was not reached.
        Interrupted: ``stop_asked`` was true on some rank.
    """
    with ExitStack() as own:
        size = comm.size if ranks_per_state is None else ranks_per_state
        shares = on_root(comm, lambda: shares_of(job, teams_of(comm.size, size)))
        team_workspace = workspace = workspace or own.enter_context(Workspace(comm))
        if len(shares) > 1:
            team = cast(MPI.Intracomm, comm.Split(comm.rank // size))
            own.callback(team.Free)
            team_workspace = own.enter_context(Workspace(team))
        share = shares[comm.rank // size]
        evaluations = Evaluations(job, comm, team_workspace, share, directory, stop_asked, keeps_shapes=samples > 0)
        if directory is not None:

            def open_and_lock() -> None:
                _open(directory, job, evaluations.content, overwrite=overwrite)
                own.callback(DirectoryLock(directory, "the same command goes on after its evaluations").release)

            on_root(comm, open_and_lock)
        begun = time.perf_counter()
        try:
            estimated = estimate(evaluations, report, samples)
        except Interrupted:
            where = f"evaluations are kept in {directory}" if directory else "nothing was saved"
            raise Interrupted(f"stopped by a signal; {where}", "Start the same command again.") from None
        took, timer = time.perf_counter() - begun, SolveTimer(comm)
        best = job.with_(changes(estimated))
        result = run(
            best.with_({"sensitivities": derivatives(estimated)}),
            comm,
            workspace=workspace,
            directory=directory and directory / _RUN,
            overwrite=True,
            progress=timer,
            stop_asked=stop_asked,
        )
        cost = _cost(estimated.evaluations, took, timer.solves[0], result.solutions[0].factorizations)
        shapes, quantities = _spread(result, [p.key for p in estimated.parameters], estimated.covariance)
        curves = fitted_curves(best, result, quantities, estimated.sampled)
        identified = Identified(estimated, best, result, cost, shapes, quantities, curves)
        if directory is not None:
            source = result.body.source
            on_root(comm, lambda: _write(directory, identified, source))
        return identified


def _cost(evaluations: Sequence[Evaluation], seconds: float, unit: float, factorizations: int) -> IdentificationCost:
    """Return the cost of evaluations that took ``seconds`` now, and of one solve."""
    kept = [evaluation for evaluation in evaluations if evaluation.kept]
    total = sum(evaluation.factorizations for evaluation in evaluations)
    whole = seconds + sum(evaluation.seconds for evaluation in kept)
    return IdentificationCost(len(evaluations), len(kept), whole, unit, (total, factorizations))


def _open(directory: Path, job: Job, content: str, *, overwrite: bool) -> None:
    """Make or check the directory; ``OutputError`` if it has something else in it."""
    check_output(directory)
    origin = directory / _ORIGIN
    if directory.exists() and (not directory.is_dir() or (any(directory.iterdir()) and not origin.exists())):
        raise OutputError(f"{directory}: holds files that are not of an identification", "Choose another --output.")
    data = {"job": str(job.path and job.path.resolve()), "content": content}
    with output_errors(directory, "Choose another --output."):
        directory.mkdir(parents=True, exist_ok=True)
        if not create(origin, json.dumps(data).encode()) and _content_of(origin) != content:
            if not overwrite and (directory / _FIGURES).exists():
                raise OutputError(
                    f"{directory}: holds the identification of another job, or of this one before it was changed",
                    "Choose another directory with --output, or give --overwrite, which keeps evaluations.",
                )
            replace(origin, json.dumps(data).encode())


def _content_of(origin: Path) -> str:
    try:
        return str(json.loads(admitted(origin).read_text())["content"])
    except (ValueError, KeyError, TypeError):
        return ""


def _spread(
    result: Result, keys: Sequence[str], covariance: Floats
) -> tuple[dict[str, float], dict[str, float | list[float]]]:
    """Return standard deviations of shapes and quantities to first order, with all correlations; collective."""
    slopes = result.sensitivities
    assert slopes is not None
    comm, shapes = result.body.mesh.comm, {}
    for name, shape_slopes in (slopes.shapes or {"": slopes}).items():
        nodes = np.stack([shape_slopes.nodes[key] for key in keys], axis=2)
        variances = np.einsum("nik,kl,nil->n", nodes, covariance, nodes)
        shapes[name] = comm.allreduce(float(np.sqrt(variances.max(initial=0.0))), op=MPI.MAX)
    quantities: dict[str, float | list[float]] = {}
    for name, key_slopes in slopes.slopes.items():
        rows = np.stack([np.array(key_slopes[key], dtype=float) for key in keys], axis=-1)
        quantities[name] = np.sqrt(np.einsum("...k,kl,...l->...", rows, covariance, rows)).tolist()
    return shapes, quantities


def _write(directory: Path, identified: Identified, source: MeshSource) -> None:
    figures: dict[str, Any] = as_data(identified.estimate) | {
        "shapes": {name: {"sd": sd} for name, sd in identified.shape_deviations.items()},
        "quantities": {
            name: {
                "value": identified.result.quantities[name],
                "sd": sd,
                "unit": identified.units.get(name, ""),
                "text": identified.quantity_text(name),
            }
            for name, sd in identified.quantity_deviations.items()
        },
        "curves": [curve.as_data() for curve in identified.curves],
        "cost": {
            "evaluations": identified.cost.evaluations,
            "kept": identified.cost.kept,
            "seconds": identified.cost.seconds,
            "inverse_solves": identified.cost.seconds / identified.cost.unit,
            "factorizations": identified.cost.factorizations[0],
            "factorizations_of_one_solve": identified.cost.factorizations[1],
            "seconds_of_one_evaluation": statistics.median(
                evaluation.seconds for evaluation in identified.estimate.evaluations
            ),
        },
    }
    if (sampled := identified.estimate.sampled) is not None and not source.is_partitioned:
        for name, (mean, sd) in sampled.shapes.items():
            data = {"sd": DataArray("sd", "nodes", sd)}
            save_body(directory / f"posterior-{name or 'shape'}.vtu", dataclasses.replace(source, data=data), mean)
    with output_errors(directory):
        for curve in identified.curves:
            replace(directory / f"curve-{curve.name}.png", picture(curve))
        replace(directory / _SECTIONS, sections(identified.job, identified.estimate).encode())
        replace(directory / _FIGURES, (json.dumps(json_data(figures), indent=1, ensure_ascii=False) + "\n").encode())
