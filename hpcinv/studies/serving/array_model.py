"""A job as a function of lists of numbers: its parameters, and data arrays and nodes of its mesh; collective."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import JobError
from hpcinv.job.job import Job
from hpcinv.mesh.source import Floats
from hpcinv.studies.learning.differentiable_job import SHAPE, DifferentiableJob
from hpcinv.studies.serving.question import Question, Refusal, Table


class ArrayModel:
    """A job with arrays among its inputs, or with its shape among its outputs.

    The first list of inputs has the numbers under ``sensitivities``, the first list of outputs the quantities, if
    there are some. Each array is a further list, row by row.

    Args:
        arrays: keys of inputs of `DifferentiableJob`.
        with_shape: whether the computed shape is an output.
        stop: whether this process was asked to stop.

    Raises:
        JobError, MeshError: as `DifferentiableJob`.
    """

    def __init__(
        self, job: Job, comm: MPI.Intracomm, arrays: Sequence[str], with_shape: bool, stop: Callable[[], bool]
    ) -> None:
        self._parameters = [p for p in job.differentiated if p.key not in arrays]
        numbers = [p.key for p in self._parameters]
        outputs = [*(quantity.name for quantity in job.quantities), *([SHAPE] if with_shape else [])]
        if not outputs:
            where = f"{job.path or 'job'}: quantities: is missing"
            raise JobError(f"{where}; it lists the outputs of a served job, next to the shape (--shape)")
        self._job = DifferentiableJob(job, [*numbers, *arrays], outputs, comm, stop)
        self._inputs = _sizes(self._job.input_shapes, len(numbers))
        self._outputs = _sizes(self._job.output_shapes, len(job.quantities))

    def close(self) -> None:
        """Free equations and factors."""
        self._job.close()

    def begin(self) -> tuple[Table, Table]:
        """Solve the job at its own values, and describe inputs and outputs."""
        start = _lists(self._job.start, self._inputs)
        found = _lists(self._job.evaluate(self._job.start), self._outputs)
        inputs = [(p.key, p.dimension.unit if p.dimension is not None else "") for p in self._parameters]
        outputs = [
            (name, quantity.unit)
            for quantity in self._job.job.quantities
            for name in ([f"{quantity.name}.{axis}" for axis in "xyz"] if quantity.is_vector else [quantity.name])
        ]
        return (
            _table(self._inputs, inputs, start, self._job.inputs, self._job.input_shapes),
            _table(self._outputs, outputs, found, self._job.outputs, self._job.output_shapes),
        )

    def answer(self, question: Question) -> list[Any]:
        """Return the answer of the protocol.

        Raises:
            Refusal: the question is not valid.
            JobError, MeshError, SolveError: on all ranks, if there is no solution or no derivative.
        """
        if question.level != "off":
            raise Refusal("InvalidInput", "a model of arrays has no certificate: 'config' must be empty")
        values = _parted(question.inputs, self._job.input_shapes)
        if question.kind == "Evaluate":
            return _lists(self._job.evaluate(values), self._outputs)
        if question.kind == "Gradient":
            weights = _parted(_alone(question.vector, question.output, self._outputs), self._job.output_shapes)
            return _lists(self._job.gradient(values, weights), self._inputs)[question.input]
        rates = _parted(_alone(question.vector, question.input, self._inputs), self._job.input_shapes)
        return _lists(self._job.along(values, rates), self._outputs)[question.output]


def _sizes(shapes: Sequence[tuple[int, ...]], singles: int) -> tuple[int, ...]:
    """Return the lengths of lists, the first of which has the first ``singles`` arrays, if there are some."""
    lengths = [math.prod(shape) for shape in shapes]
    return (*([sum(lengths[:singles])] if singles else []), *lengths[singles:])


def _parted(lists: Sequence[Sequence[float]], shapes: Sequence[tuple[int, ...]]) -> list[Floats]:
    """Return arrays of these shapes from their numbers in lists."""
    numbers = np.array([number for each in lists for number in each])
    ends = np.cumsum([math.prod(shape) for shape in shapes])
    return [part.reshape(shape) for part, shape in zip(np.split(numbers, ends[:-1]), shapes, strict=True)]


def _lists(arrays: Sequence[Floats], sizes: Sequence[int]) -> list[list[float]]:
    """Return the numbers of arrays in lists of these lengths."""
    numbers = np.concatenate([np.ravel(array) for array in arrays])
    return [part.tolist() for part in np.split(numbers, np.cumsum(sizes)[:-1])]


def _alone(vector: Sequence[float], place: int, sizes: Sequence[int]) -> list[Sequence[float]]:
    """Return lists that are zero but for the one at a place."""
    return [vector if number == place else [0.0] * size for number, size in enumerate(sizes)]


def _table(
    sizes: tuple[int, ...],
    singles: Sequence[tuple[str, str]],
    lists: Sequence[Sequence[float]],
    names: Sequence[str],
    shapes: Sequence[tuple[int, ...]],
) -> Table:
    """Describe lists, the first of which has the ``singles`` by name and unit, if there are some."""
    values = [f"{value:.6g}" for value in lists[0]] if singles else []
    rows = tuple((*single, value) for single, value in zip(singles, values, strict=True))
    later = len(sizes) - bool(singles)
    described = zip(names[len(names) - later :], shapes[len(shapes) - later :], strict=True)
    return Table(sizes, rows, tuple(f"{name}, {' × '.join(map(str, shape))} numbers" for name, shape in described))
