"""A job as a function: its quantities over its parameters, with exact derivatives; collective."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hpcinv.driver import run
from hpcinv.errors import JobError, SolveError
from hpcinv.job.job import Job
from hpcinv.job.sensitivities import fault_of_setting, stated_values, tied_parameters
from hpcinv.mesh.source import Floats
from hpcinv.output.result import Quantities, Result
from hpcinv.solver.methods.method import Guess
from hpcinv.solver.workspace import Workspace
from hpcinv.studies.serving.question import Question, Refusal, Table
from hpcinv.trust.certificate import Verdict


@dataclass(frozen=True)
class Linearisation:
    """Outputs and their derivatives at some inputs, in SI.

    Attributes:
        outputs: name of each value; the components of a vector are ``NAME.x``, ``NAME.y`` and ``NAME.z``.
        units: SI unit of each value, empty for pure numbers.
        values: (m,).
        jacobian: derivatives of the values by the inputs, (m, n); NaN where a quantity has no derivative.
    """

    outputs: tuple[str, ...]
    units: tuple[str, ...]
    values: Floats
    jacobian: Floats


class JobModel:
    """A job whose ``sensitivities`` are the inputs and whose ``quantities`` are the outputs.

    Args:
        job: with both sections.
        workspace: body and equations, which all evaluations share.
        stop: whether this process was asked to stop.

    Raises:
        JobError: a section is missing.
    """

    def __init__(self, job: Job, workspace: Workspace, stop: Callable[[], bool]) -> None:
        for section, meaning in (("sensitivities", "inputs"), ("quantities", "outputs")):
            if not getattr(job, section):
                raise JobError(f"{job.path or 'job'}: {section}: is missing; it lists the {meaning} of a served job")
        self.job = job.with_({"certificate": "off", "identify": None})
        self.parameters = self.job.differentiated
        for number in tied_parameters(self.parameters):
            if fault := fault_of_setting(number):
                raise JobError(f"{job.path or 'job'}: sensitivities: {fault}")
        self._workspace, self._stop = workspace, stop
        self._guesses: tuple[Guess, ...] = ()
        self._last: tuple[tuple[tuple[float, ...], str], Linearisation] | None = None

    @property
    def start(self) -> list[float]:
        """Inputs (SI) in the job."""
        return [p.value for p in self.parameters]

    def evaluate(self, inputs: Sequence[float], level: str = "off") -> Linearisation:
        """Evaluate outputs and derivatives; collective.

        Args:
            inputs: values (SI) of the parameters, (n,).
            level: of the certificate.

        Raises:
            JobError, MeshError, SolveError: on all ranks, if there is no solution, or its certificate fails.
            Interrupted: on all ranks, if a process was asked to stop.
        """
        key = tuple(inputs), level
        if self._last is not None and self._last[0] == key:  # a gradient often follows a value
            return self._last[1]
        job = self.job.with_(stated_values(self.parameters, inputs) | {"certificate": level})
        comm = self._workspace.comm
        result = run(job, comm, workspace=self._workspace, guesses=self._guesses, stop_asked=self._stop)
        self._guesses = tuple(solution.as_guess() for solution in result.solutions)
        if result.certificate.verdict is Verdict.FAIL:
            lines = [line.name for line in result.certificate.lines if line.verdict is Verdict.FAIL]
            raise SolveError(f"the certificate fails: {', '.join(lines)}")
        evaluation = _linearised(result)
        self._last = key, evaluation
        return evaluation

    def begin(self) -> tuple[Table, Table]:
        """Solve the job at its own values, and describe inputs and outputs."""
        first = self.evaluate(self.start)
        inputs = [
            (p.key, p.dimension.unit if p.dimension is not None else "", f"{value:.6g}")
            for p, value in zip(self.parameters, self.start, strict=True)
        ]
        values = [f"{value:.6g}" for value in first.values.tolist()]
        outputs = zip(first.outputs, first.units, values, strict=True)
        return Table((len(inputs),), tuple(inputs)), Table((len(values),), tuple(outputs))

    def answer(self, question: Question) -> list[Any]:
        """Return the answer of the protocol.

        Raises:
            Refusal: outputs have no value or no derivative.
            JobError, MeshError, SolveError, Interrupted: as `evaluate`.
        """
        evaluation = self.evaluate(question.inputs[0], question.level)
        values, jacobian = evaluation.values, evaluation.jacobian
        if question.kind == "Evaluate":
            _require(np.isfinite(values), evaluation.outputs, "has no finite value")
            return [values.tolist()]
        is_known = np.isfinite(jacobian).all(axis=1)
        if question.kind == "Gradient":
            weights = np.array(question.vector)
            _require(is_known | (weights == 0), evaluation.outputs, "has no derivative; give it the weight 0")
            gradient: list[Any] = (weights[weights != 0] @ jacobian[weights != 0]).tolist()
            return gradient
        _require(is_known, evaluation.outputs, "has no derivative; remove it from the job")
        change: list[Any] = (jacobian @ np.array(question.vector)).tolist()
        return change


def _require(is_right: Any, outputs: Sequence[str], fault: str) -> None:
    if not is_right.all():
        raise Refusal("UnsupportedFeature", f"output '{outputs[int(np.argmin(is_right))]}' {fault}")


def _linearised(result: Result) -> Linearisation:
    assert result.sensitivities is not None
    assert isinstance(result.quantities, Quantities)
    keys, slopes = [p.key for p in result.sensitivities.parameters], result.sensitivities.slopes
    outputs, units, values, rows = [], [], [], []
    for name, value in result.quantities.items():
        parts = np.atleast_1d(value)
        outputs += [name] if parts.size == 1 else [f"{name}.{axis}" for axis in "xyz"]
        units += [result.quantities.units.get(name, "")] * parts.size
        values.append(parts)
        known = slopes.get(name)
        if known is None:
            rows.append(np.full((parts.size, len(keys)), np.nan))
        else:
            rows.append(np.column_stack([np.atleast_1d(known[key]) for key in keys]))
    return Linearisation(tuple(outputs), tuple(units), np.concatenate(values), np.concatenate(rows))
