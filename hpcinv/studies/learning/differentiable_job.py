"""A job as a function of numbers, data arrays and nodes, with the products of its derivatives; collective."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from types import TracebackType
from typing import Any, Self

import numpy as np

from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.base.quantity.component import Ingredient
from hpcinv.base.quantity.spatial_fields import ByData
from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.driver import run
from hpcinv.errors import JobError
from hpcinv.job.job import Job, load
from hpcinv.job.sensitivities import fault_of_setting, stated_values, tied_parameters
from hpcinv.mesh.source import Floats, MeshSource
from hpcinv.output.result import Result
from hpcinv.solver.methods.method import Guess
from hpcinv.solver.workspace import Workspace
from hpcinv.studies.learning.given_nodes import NODES, GivenNodes

SHAPE = "shape"


class DifferentiableJob:
    """A job whose inputs are numbers under ``sensitivities``, data arrays of its mesh, and the nodes of that.

    Body, equations, programs and factors are kept between evaluations, and each solve begins at the last solution.
    Where nodes move, equations are made anew. Regions keep their facets, and points of quantities move with the body.

    Args:
        job: as `hpcinv.run` takes it.
        inputs: keys: of numbers under ``sensitivities``, or of quantities that the job takes from a data array, such as
            ``material.mu``; or ``mesh.nodes``, (n, 3) in m in the order of the mesh, of a shell of its surface.
        outputs: ``shape``, and names of quantities.
        stop: whether this process was asked to stop, which ends a solve.

    Attributes:
        job: without certificate.
        start: the inputs in the job, in SI; arrays in the unit of the job's ``data``.
        input_shapes, output_shapes: shapes of the arrays; a number has ``()``, ``shape`` has (nodes, 3), of a shell
            the nodes of its cells from the inner face to the outer one.

    Raises:
        JobError, MeshError: on all ranks, for unknown inputs and outputs, and for what the job lacks.
    """

    def __init__(
        self,
        job: Job | str | PathLike[str] | Any,
        inputs: Sequence[str],
        outputs: Sequence[str] = (SHAPE,),
        comm: MPI.Intracomm = MPI.COMM_WORLD,
        stop: Callable[[], bool] = lambda: False,
    ) -> None:
        if not isinstance(job, Job):
            given = job
            job = on_root(comm, lambda: load(given))
        self.inputs, self.outputs, self._stop = tuple(inputs), tuple(outputs), stop
        self.job: Job = job.with_({"certificate": "off", "identify": None})
        self._numbers = {p.key: p for p in self.job.differentiated if p.key in self.inputs}
        self._arrays = {key: array for key, array in _arrays_of(self.job).items() if key in self.inputs}
        self._check()
        self._workspace = Workspace(comm)
        source = self._workspace.body(self.job).source
        arrays = self._arrays_in(source, comm)
        self._nodes = GivenNodes(self.job, self._workspace) if NODES in self.inputs else None
        self.start = [np.array(self._start_of(key, arrays)) for key in self.inputs]
        self.input_shapes = tuple(value.shape for value in self.start)
        nodes = int(comm.allreduce(len(source.points)))
        vectors = {quantity.name: quantity.is_vector for quantity in self.job.quantities}
        self.output_shapes = tuple((nodes, 3) if name == SHAPE else (3,) * vectors[name] for name in self.outputs)
        self._guesses: tuple[Guess, ...] = ()
        self._last: tuple[tuple[bytes, ...], Result] | None = None

    def _arrays_in(self, source: MeshSource, comm: MPI.Intracomm) -> dict[str, Floats]:
        """Return the data arrays of the mesh that inputs replace, on all ranks."""
        if source.is_partitioned and (self._arrays or NODES in self.inputs):
            raise self._error("inputs by node or by cell need a mesh in one file, not a partitioned one")
        names = set(self._arrays.values())
        arrays = {name: comm.bcast(array.values) for name, array in source.data.items() if name in names}
        if missing := [name for name in self._arrays.values() if name not in arrays]:
            raise self._error(f"the mesh has no data array '{missing[0]}'")
        return arrays

    def _start_of(self, key: str, arrays: Mapping[str, Floats]) -> Any:
        """Return the value of an input in the job; an array of one component has one axis."""
        if key in self._numbers:
            return self._numbers[key].value
        if self._nodes is not None and key == NODES:
            return self._nodes.start
        values = arrays[self._arrays[key]]
        return values[:, 0] if values.shape[1] == 1 else values

    def _error(self, text: str) -> JobError:
        return JobError(f"{self.job.path or 'job'}: {text}")

    def _check(self) -> None:
        """Refuse unknown inputs and outputs, and numbers that cannot be set."""
        known = {NODES} | {p.key for p in self.job.differentiated} | _arrays_of(self.job).keys()
        for key in self.inputs:
            if key not in known:
                need = "an input is a number under 'sensitivities', a quantity from a data array, or 'mesh.nodes'"
                raise self._error(f"unknown input '{key}': {need}.{did_you_mean(key, known)}")
        if self.job.accuracy and len(self._numbers) < len(self.inputs):
            raise self._error("inputs by node or by cell need the mesh of the job: remove 'accuracy'")
        results = {SHAPE, *(quantity.name for quantity in self.job.quantities)}
        for name in self.outputs:
            if name not in results:
                raise self._error(f"unknown output '{name}'.{did_you_mean(name, results)}")
        for number in tied_parameters([*self._numbers.values()]):
            if fault := fault_of_setting(number):
                raise self._error(f"sensitivities: {fault}")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Free equations and factors."""
        self._workspace.clear()
        self._last = None

    def evaluate(self, values: Sequence[Any]) -> list[Floats]:
        """Return the outputs at values of the inputs: numbers in SI, arrays in the unit of the job's ``data``.

        Raises:
            JobError, MeshError, SolveError: on all ranks, for wrong shapes and values, or if there is no solution.
        """
        result = self._result(self._checked(values, self.input_shapes, self.inputs))
        return [
            result.shape_in_file if name == SHAPE else np.array(result.quantities[name], dtype=np.float64)
            for name in self.outputs
        ]

    def gradient(self, values: Sequence[Any], weights: Sequence[Any]) -> list[Floats]:
        """Return the gradient of ``Σ weight · output`` by each input, by one solve at the last values.

        Raises:
            JobError, MeshError, SolveError: as `evaluate`.
        """
        given = self._checked(weights, self.output_shapes, self.outputs)
        result = self._result(self._checked(values, self.input_shapes, self.inputs))
        covector = {name: weight for name, weight in zip(self.outputs, given, strict=True) if weight.any()}
        gradient = result.vjp(covector, [key for key in self.inputs if key in self._arrays], nodes=bool(self._nodes))
        by_input: dict[str, Floats] = {key: np.array(value) for key, value in gradient.numbers.items()}
        by_input |= {key: self._factor(key) * by_array for key, by_array in gradient.fields.items()}
        if self._nodes is not None and gradient.nodes is not None:
            by_input[NODES] = self._nodes.gradient(gradient.nodes)
        return [by_input[key] for key in self.inputs]

    def along(self, values: Sequence[Any], rates: Sequence[Any]) -> list[Floats]:
        """Return the derivatives of the outputs along rates of the inputs, by one solve at the last values.

        Raises:
            JobError, MeshError, SolveError: as `evaluate`, and for outputs without a derivative.
        """
        given = self._checked(rates, self.input_shapes, self.inputs)
        result = self._result(self._checked(values, self.input_shapes, self.inputs))
        rates_by_key = dict(zip(self.inputs, given, strict=True))
        direction: dict[str, Any] = {key: float(rates_by_key[key]) for key in self._numbers}
        direction |= {key: self._factor(key) * rates_by_key[key] for key in self._arrays}
        if self._nodes is not None:
            direction["nodes"] = self._nodes.direction(rates_by_key[NODES])
        changes = result.jvp(direction)
        if missing := [name for name in self.outputs if name not in changes]:
            raise self._error(f"'{missing[0]}' has no derivative along a direction")
        return [np.array(changes[name], dtype=np.float64) for name in self.outputs]

    def _factor(self, key: str) -> float:
        """Return the SI value of the unit of an array."""
        return float(_fields_of(self.job)[key].factor)

    def _checked(self, values: Sequence[Any], shapes: Sequence[tuple[int, ...]], names: Sequence[str]) -> list[Floats]:
        if len(values) != len(names):
            raise self._error(f"{len(names)} arrays are needed ({', '.join(names)}), not {len(values)}")
        arrays = [np.array(value, dtype=np.float64) for value in values]
        for name, array, shape in zip(names, arrays, shapes, strict=True):
            if array.shape != shape:
                raise self._error(f"'{name}' must have the shape {shape}, not {array.shape}")
            if not np.isfinite(array).all():
                raise self._error(f"'{name}' has values that are not finite")
        return arrays

    def _result(self, values: Sequence[Floats]) -> Result:
        """Return the result at values of the inputs, the last one if these are its own."""
        key = tuple(value.tobytes() for value in values)
        if self._last is not None and self._last[0] == key:  # a gradient follows a value
            return self._last[1]
        given = dict(zip(self.inputs, values, strict=True))
        numbers = [*self._numbers.values()]
        job = self.job.with_(stated_values(numbers, [float(given[p.key]) for p in numbers]))
        if self._nodes is None:
            self._workspace.body(job)
        else:
            job = self._nodes.put(job, given[NODES])
        for name, array in self._arrays.items():
            self._workspace.put_array(array, given[name])
        result = run(job, self._workspace.comm, workspace=self._workspace, guesses=self._guesses, stop_asked=self._stop)
        self._guesses = tuple(solution.as_guess() for solution in result.solutions)
        self._last = key, result
        return result


def _fields_of(job: Job) -> dict[str, ByData]:
    """Return the quantities of a job from data arrays, by their keys."""
    return {
        f"{where}.{name}": value
        for where, owner in job.owners.items()
        if isinstance(owner, Ingredient)
        for name, (value, _) in owner.quantities().items()
        if isinstance(value, ByData)
    }


def _arrays_of(job: Job) -> dict[str, str]:
    """Return the names of data arrays by the keys of the quantities that have them."""
    return {key: field.array for key, field in _fields_of(job).items()}
