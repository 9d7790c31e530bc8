"""A job as a function of JAX, whose gradient is one linear solve (``pip install jax``)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hpcinv.studies.learning import needing
from hpcinv.studies.learning.differentiable_job import SHAPE, DifferentiableJob

with needing("jax", "JAX"):
    import jax
    import jax.numpy as jnp

__all__ = ["function"]


def function(
    job: DifferentiableJob | Any, inputs: Sequence[str] = (), outputs: Sequence[str] = (SHAPE,)
) -> Callable[..., tuple[jax.Array, ...]]:
    """Return a function of one array for each input, which returns an array for each output.

    It may be used in ``jax.jit`` and ``jax.grad``. The solve is a callback in double precision; arrays have JAX's
    default precision (``jax_enable_x64``). ``vmap`` takes one case after the other.

    Args:
        job: a `DifferentiableJob`, or what it takes, with ``inputs`` and ``outputs``.

    Raises:
        JobError, MeshError: as `DifferentiableJob`. Where there is no solution, JAX raises an error with the message.
    """
    model = job if isinstance(job, DifferentiableJob) else DifferentiableJob(job, inputs, outputs)
    number = jnp.result_type(float)
    given, found = (
        tuple(jax.ShapeDtypeStruct(shape, number) for shape in shapes)
        for shapes in (model.input_shapes, model.output_shapes)
    )

    def called(method: Callable[..., Any], *groups: Sequence[Any]) -> tuple[np.ndarray, ...]:
        arrays = ([np.asarray(value, dtype=np.float64) for value in group] for group in groups)
        return tuple(np.asarray(value, dtype=number) for value in method(*arrays))

    def solved(*arrays: Any) -> tuple[jax.Array, ...]:
        results: tuple[jax.Array, ...] = jax.pure_callback(
            lambda *values: called(model.evaluate, values), found, *arrays, vmap_method="sequential"
        )
        return results

    def forward(*arrays: Any) -> tuple[tuple[jax.Array, ...], tuple[Any, ...]]:
        return solved(*arrays), arrays

    def backward(arrays: tuple[Any, ...], weights: tuple[Any, ...]) -> tuple[jax.Array, ...]:
        gradient: tuple[jax.Array, ...] = jax.pure_callback(
            lambda *groups: called(model.gradient, *groups), given, arrays, weights, vmap_method="sequential"
        )
        return gradient

    solve: Any = jax.custom_vjp(solved)
    solve.defvjp(forward, backward)
    return solve  # type: ignore[no-any-return]
