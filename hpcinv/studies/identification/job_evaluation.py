"""Evaluation of a job at values of its parameters, and the store that keeps each evaluation for a resumed run.

Teams of ranks may solve different states at the same time; rank 0 of all ranks collects what they predict.
"""

import hashlib
import io
import json
import time
import zipfile
from collections import ChainMap
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np

from hpcinv.base.files.atomic import output_errors, replace
from hpcinv.base.parallel.ranks import MPI, agree, on_root, wait_for_all
from hpcinv.base.reading.door import admitted
from hpcinv.driver import run
from hpcinv.errors import Interrupted, JobError, MeshError, SolveError
from hpcinv.job.fingerprint import content_key
from hpcinv.job.identification import Identification
from hpcinv.job.job import Job
from hpcinv.job.resolved_job import SectionData
from hpcinv.job.sensitivities import TIES, Parameter, stated_values
from hpcinv.mesh import reorder_to_source
from hpcinv.mesh.source import Floats
from hpcinv.output.progress import Progress
from hpcinv.output.result import Result
from hpcinv.solver.methods.method import Guess
from hpcinv.solver.workspace import Workspace
from hpcinv.studies.identification.observations import Observed, PredictedObservation, gather_rows, observations_of
from hpcinv.studies.identification.shares import StateShare
from hpcinv.version import __version__

_FOLDER = "evaluations"
_SHAPE = "shape:"  # before the names of shapes in a file


@dataclass(frozen=True)
class Evaluation:
    """Predictions of the states at values of the parameters.

    Attributes:
        differences: computed less observed values of all observations (SI), (n,).
        jacobian: their derivatives by the parameters, (n, k).
        factorizations: of all solves.
        seconds: of the run.
        quantities: computed quantities of interest by name (SI).
        shapes: nodes (n, 3) in m of each computed shape in the order of the mesh file, with single precision, if kept.
        failure: why a state was not reached; empty if all were. Then there are no numbers.
        kept: whether it was made by an earlier command.
    """

    differences: Floats
    jacobian: Floats
    factorizations: int
    seconds: float
    quantities: Mapping[str, float | list[float]] = field(default_factory=dict)
    shapes: Mapping[str, Floats] = field(default_factory=dict)
    failure: str = ""
    kept: bool = False

    def as_bytes(self) -> bytes:
        content = io.BytesIO()
        about = json.dumps([self.factorizations, self.seconds, dict(self.quantities), self.failure])
        arrays: dict[str, Any] = {_SHAPE + name: nodes for name, nodes in self.shapes.items()}
        arrays |= {"differences": self.differences, "jacobian": self.jacobian}
        np.savez_compressed(content, about=np.frombuffer(about.encode(), np.uint8), **arrays)
        return content.getvalue()

    @classmethod
    def read(cls, path: Path) -> Self | None:
        """Return a kept evaluation; ``None`` if there is none, or its file is damaged."""
        try:
            with np.load(admitted(path), allow_pickle=False) as file:
                factorizations, seconds, quantities, failure = json.loads(bytes(file["about"]))
                numbers = file["differences"], file["jacobian"]
                shapes = {key.removeprefix(_SHAPE): file[key] for key in file.files if key.startswith(_SHAPE)}
                return cls(*numbers, factorizations, seconds, quantities, shapes, failure, kept=True)
        except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile):
            return None


@dataclass(frozen=True)
class _TeamResult:
    """Results of one team: predictions by name of the observation, quantities of interest and shapes by name."""

    predictions: Mapping[str, PredictedObservation]
    quantities: Mapping[str, float | list[float]]
    shapes: Mapping[str, Floats]
    factorizations: int
    failure: str = ""


class SolveTimer(Progress):
    """A silent progress that measures the solves of a run.

    Attributes:
        solves: seconds of each solve, in order.
    """

    def __init__(self, comm: MPI.Intracomm) -> None:
        super().__init__(comm, None)
        self.solves: list[float] = []

    @contextmanager
    def phase(self, name: str, about: str = "", *, announced: bool = True) -> Iterator[None]:
        begun = time.perf_counter()
        with super().phase(name, about, announced=announced):
            yield
        if name == "solving":
            self.solves.append(time.perf_counter() - begun)


class Evaluations:
    """Evaluations of a job with a section ``identify``; collective.

    Args:
        workspace: on the communicator of this rank's team, which is ``comm`` if all ranks solve all states.
        share: states that the team solves.
        directory: where evaluations are kept; ``None`` keeps none.
        keeps_shapes: whether evaluations have the computed shapes.

    Raises:
        MeshError: on all ranks, if an observation does not fit the mesh.
    """

    def __init__(
        self,
        job: Job,
        comm: MPI.Intracomm,
        workspace: Workspace,
        share: StateShare,
        directory: Path | None,
        stop: Callable[[], bool],
        *,
        keeps_shapes: bool = False,
    ) -> None:
        self.job, self.comm, self._keeps_shapes = job, comm, keeps_shapes
        sought = {
            key: {kind: list(getattr(self.section.sought(key), kind)) for kind in TIES}
            for key in self.section.parameters
        }
        # Without what does not count here: checks, and the section itself.
        self._base = job.with_({"certificate": "off", "sensitivities": sought, "identify": None})
        self.parameters: Sequence[Parameter] = self._base.differentiated
        self._workspace, self._share, self._stop = workspace, share, stop
        self._directory = directory and directory / _FOLDER
        first = on_root(workspace.comm, lambda: comm.rank == 0)  # whether rank 0 is in this team
        body = workspace.body(job)
        self._inputs = dict(body.source.inputs)
        self.observed: list[Observed] = observations_of(job, body)
        self._own = [observation for observation in self.observed if share.has(observation.spec, first=first)]
        self._guesses: tuple[Guess, ...] = ()
        self._known = SectionData()
        self.content = on_root(comm, self._content)

    def evaluate(self, values: Floats) -> Evaluation | None:
        """Evaluate the job at values (SI) of the parameters, or take what is kept; on rank 0, ``None`` on others.

        Raises:
            Interrupted: on all ranks, if the run was asked to stop.
        """
        try:
            job = self._base.with_(stated_values(self.parameters, values))
        except JobError as error:
            return self._failed(error.message)
        path = on_root(self.comm, lambda: self._path(job))
        known = on_root(self.comm, lambda: None if path is None else Evaluation.read(path))
        if known is not None and (known.shapes or known.failure or not self._keeps_shapes):
            return known if self.comm.rank == 0 else None
        begun = time.perf_counter()
        evaluation = self._joined(self._team_result(job), begun)
        on_root(self.comm, lambda: self._keep(evaluation, path))
        return evaluation

    def _team_result(self, job: Job) -> _TeamResult:
        """Solve the states of this team."""
        team, share = self._workspace.comm, self._share
        result: Result | None = None
        failure, stopped = "", None
        try:
            own = on_root(team, lambda: share.job(job))
            result = run(own, team, workspace=self._workspace, guesses=self._guesses, stop_asked=self._stop)
        except (SolveError, MeshError) as error:  # a field may not be admissible on the mesh
            failure = error.message
        except Interrupted as error:
            stopped = error
        self._guesses = tuple(solution.as_guess() for solution in result.solutions) if result else ()
        if self.comm.size > team.size:
            wait_for_all(self.comm)
        agree(self.comm, stopped)
        if result is None:
            return _TeamResult({}, {}, {}, 0, failure)
        predictions = self._predictions(result)
        factorizations = sum(solution.factorizations for solution in result.solutions)
        shapes: dict[str, Floats] = {}
        if self._keeps_shapes:
            for name, nodes in (result.shapes or {"": result.shape}).items():
                whole_shape = gather_rows(result.body, reorder_to_source(result.body, nodes))
                if whole_shape is not None:
                    shapes[name] = whole_shape.astype(np.float32)
        return _TeamResult(predictions, result.quantities, shapes, factorizations)

    def _predictions(self, result: Result) -> dict[str, PredictedObservation]:
        """Return the team's observations with the columns of all parameters, 0 for those that its states lack."""
        numbers = [self._share.number(p) for p in self.parameters]
        columns = [i for i, number in enumerate(numbers) if number]
        predictions: dict[str, PredictedObservation] = {}
        for observation in self._own:
            prediction = observation.predict(result, [number.key for number in numbers if number])
            if prediction is not None:
                whole = np.zeros((len(prediction.differences), len(numbers)))
                whole[:, columns] = prediction.jacobian * [number.ratio for number in numbers if number]
                predictions[observation.spec.name] = PredictedObservation(prediction.differences, whole)
        return predictions

    def _joined(self, part: _TeamResult, begun: float) -> Evaluation | None:
        """Return what all teams have found, on rank 0."""
        parts = self.comm.gather(part if self._workspace.comm.rank == 0 else None)
        if parts is None:
            return None
        teams = [entry for entry in parts if entry is not None]
        if failures := [entry.failure for entry in teams if entry.failure]:
            return self._failed(failures[0])
        known, quantities, shapes = (
            dict(ChainMap(*(getattr(entry, name) for entry in reversed(teams))))
            for name in ("predictions", "quantities", "shapes")
        )
        ordered = [known[entry.spec.name] for entry in self.observed]
        for entry, prediction in zip(self.observed, ordered, strict=True):
            if not prediction.is_finite:
                return self._failed(f"observation '{entry.spec.name}' or a derivative of it has no finite value")
        return Evaluation(
            np.concatenate([entry.differences for entry in ordered]),
            np.concatenate([entry.jacobian for entry in ordered]),
            sum(entry.factorizations for entry in teams),
            time.perf_counter() - begun,
            quantities,
            shapes,
        )

    def _keep(self, evaluation: Evaluation | None, path: Path | None) -> None:
        if evaluation is not None and path is not None:
            with output_errors(path):
                path.parent.mkdir(parents=True, exist_ok=True)
                replace(path, evaluation.as_bytes())

    def _failed(self, failure: str) -> Evaluation | None:
        return Evaluation(np.zeros(0), np.zeros((0, 0)), 0, 0.0, failure=failure) if self.comm.rank == 0 else None

    @cached_property
    def section(self) -> Identification:
        assert self.job.identify is not None
        return self.job.identify

    def _files(self) -> list[str]:
        """Return the digests of the files of observations."""
        files = (observation.file for observation in self.section.observations)
        return [self._known.digest(self.job.resolve(file)) for file in files if file is not None]

    def _circumstances(self) -> dict[str, Any]:
        return {"files": self._files(), "inputs": self._inputs, "version": __version__}

    def _content(self) -> str:
        """Return a hash of all that the estimate depends on."""
        data = self.section.model_dump(mode="json", exclude={"maximum_evaluations"})
        for observation in data["observations"]:  # a moved file is the same observation
            for kind in ("mesh", "surface", "landmarks"):
                if isinstance(observation[kind], str):
                    observation[kind] = ""
        return content_key(self._base, self._known, identify=data, **self._circumstances())

    def _path(self, job: Job) -> Path | None:
        if self._directory is None:
            return None
        data = [
            observation.model_dump(mode="json", exclude={"sd", "name"}) for observation in self.section.observations
        ]
        observed = hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()
        key = content_key(job, self._known, observed=observed, **self._circumstances())
        return self._directory / f"{key}.npz"
