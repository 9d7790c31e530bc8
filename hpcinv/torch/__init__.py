"""A job as a function of PyTorch, whose gradient is one linear solve (``pip install torch``)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from hpcinv.studies.learning import needing
from hpcinv.studies.learning.differentiable_job import SHAPE, DifferentiableJob

with needing("torch", "PyTorch"):
    import torch
    from torch.autograd.function import once_differentiable

__all__ = ["function"]


def function(
    job: DifferentiableJob | Any, inputs: Sequence[str] = (), outputs: Sequence[str] = (SHAPE,)
) -> Callable[..., tuple[torch.Tensor, ...]]:
    """Return a function of one tensor for each input, which returns a tensor for each output.

    The solve is in double precision on the processor; tensors are of the type and on the device of the first input.

    Args:
        job: a `DifferentiableJob`, or what it takes, with ``inputs`` and ``outputs``.

    Raises:
        JobError, MeshError: as `DifferentiableJob`; the function raises ``SolveError`` where there is no solution.
    """
    model = job if isinstance(job, DifferentiableJob) else DifferentiableJob(job, inputs, outputs)

    def solve(*tensors: torch.Tensor) -> tuple[torch.Tensor, ...]:
        results: tuple[torch.Tensor, ...] = _Solve.apply(model, *tensors)
        return results

    return solve


def _backward(ctx: Any, *weights: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
    tensors = ctx.saved_tensors
    gradient = ctx.model.gradient([_array(t) for t in tensors], [_array(weight) for weight in weights])
    return (None, *(_like(tensor, value) for tensor, value in zip(tensors, gradient, strict=True)))


class _Solve(torch.autograd.Function):  # type: ignore[misc]  # mypy skips torch
    @staticmethod
    def forward(ctx: Any, model: DifferentiableJob, *tensors: torch.Tensor) -> tuple[torch.Tensor, ...]:
        ctx.model = model
        ctx.save_for_backward(*tensors)
        return tuple(_like(tensors[0], value) for value in model.evaluate([_array(tensor) for tensor in tensors]))

    backward = staticmethod(once_differentiable(_backward))


def _array(tensor: torch.Tensor) -> Any:
    return tensor.detach().cpu().double().numpy()


def _like(tensor: torch.Tensor, values: Any) -> torch.Tensor:
    return torch.as_tensor(values, dtype=tensor.dtype, device=tensor.device)
