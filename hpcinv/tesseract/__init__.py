"""A job as a component of Tesseract, a format for simulations with derivatives (``tesseract-core[runtime]``).

A file ``tesseract_api.py`` has classes and functions with the names of the members of a `Component`, and calls these.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hpcinv.errors import JobError
from hpcinv.studies.learning import needing
from hpcinv.studies.learning.differentiable_job import SHAPE, DifferentiableJob

with needing("tesseract_core", "Tesseract", "'tesseract-core[runtime]'", "hpcinv.tesseract"):
    from pydantic import BaseModel, Field, create_model
    from tesseract_core.runtime import Array, Differentiable, Float64, ShapeDType

__all__ = ["Component"]


class Component:
    """Schemas and endpoints of a job.

    Names of arrays are keys of the job with ``_`` instead of other signs: ``effects_0_pressure`` for
    ``effects[0].pressure``.

    Args:
        job: a `DifferentiableJob`, or what it takes, with ``inputs`` and ``outputs``.

    Attributes:
        InputSchema, OutputSchema: models of pydantic with an array of doubles for each input and output.
        start: the inputs in the job, by name.

    Raises:
        JobError, MeshError: as `DifferentiableJob`; endpoints raise ``SolveError`` where there is no solution.
    """

    def __init__(
        self, job: DifferentiableJob | Any, inputs: Sequence[str] = (), outputs: Sequence[str] = (SHAPE,)
    ) -> None:
        self._model = job if isinstance(job, DifferentiableJob) else DifferentiableJob(job, inputs, outputs)
        self._inputs = _names_of(self._model.inputs)
        self._outputs = _names_of(self._model.outputs)
        self.InputSchema: Any = _schema("InputSchema", self._inputs, self._model.input_shapes)
        self.OutputSchema: Any = _schema("OutputSchema", self._outputs, self._model.output_shapes)
        self.start = dict(zip(self._inputs, self._model.start, strict=True))

    def apply(self, inputs: BaseModel) -> dict[str, Any]:
        """Return the outputs by name: numbers in SI, arrays of inputs in the unit of the job's ``data``."""
        return dict(zip(self._outputs, self._model.evaluate(self._values(inputs)), strict=True))

    def vector_jacobian_product(
        self, inputs: BaseModel, vjp_inputs: set[str], vjp_outputs: set[str], cotangent_vector: Mapping[str, Any]
    ) -> dict[str, Any]:
        """Return the gradient of ``Σ cotangent · output`` by each of ``vjp_inputs``, by one solve."""
        weights = self._filled(self._outputs, self._model.output_shapes, vjp_outputs, cotangent_vector)
        gradient = self._model.gradient(self._values(inputs), weights)
        return {name: value for name, value in zip(self._inputs, gradient, strict=True) if name in vjp_inputs}

    def jacobian_vector_product(
        self, inputs: BaseModel, jvp_inputs: set[str], jvp_outputs: set[str], tangent_vector: Mapping[str, Any]
    ) -> dict[str, Any]:
        """Return the derivative of each of ``jvp_outputs`` along the tangents of the inputs, by one solve."""
        rates = self._filled(self._inputs, self._model.input_shapes, jvp_inputs, tangent_vector)
        changes = self._model.along(self._values(inputs), rates)
        return {name: value for name, value in zip(self._outputs, changes, strict=True) if name in jvp_outputs}

    def abstract_eval(self, abstract_inputs: BaseModel) -> dict[str, ShapeDType]:
        """Return shapes and types of the outputs, which are the same for all inputs."""
        shapes = zip(self._outputs, self._model.output_shapes, strict=True)
        return {name: ShapeDType(shape=shape, dtype="float64") for name, shape in shapes}

    def _values(self, inputs: BaseModel) -> list[Any]:
        return [getattr(inputs, name) for name in self._inputs]

    @staticmethod
    def _filled(
        names: Sequence[str], shapes: Sequence[tuple[int, ...]], chosen: set[str], given: Mapping[str, Any]
    ) -> list[Any]:
        """Return arrays by their order, zero where a name is not chosen."""
        return [given[name] if name in chosen else np.zeros(shape) for name, shape in zip(names, shapes, strict=True)]


def _names_of(keys: Sequence[str]) -> list[str]:
    """Return names of arrays by the keys of a job.

    Raises:
        JobError: two keys have the same name.
    """
    names = [re.sub(r"\W+", "_", key).strip("_") for key in keys]
    for number, name in enumerate(names):
        if name in names[:number]:
            raise JobError(f"'{keys[names.index(name)]}' and '{keys[number]}' have the same name '{name}'")
    return names


def _schema(title: str, names: Sequence[str], shapes: Sequence[tuple[int, ...]]) -> type[BaseModel]:
    """Return a model of pydantic with an array of doubles for each name."""
    fields: dict[str, Any] = {
        name: (Differentiable[Array[shape, Float64]], Field()) for name, shape in zip(names, shapes, strict=True)
    }
    return create_model(title, **fields)
