"""Products of the derivatives of jobs as functions, next to central differences."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from hpcinv.studies.learning.differentiable_job import DifferentiableJob


def check_products(
    model: DifferentiableJob, values: Sequence[Any], direction: Sequence[Any], step: float = 1e-4, rel: float = 1e-6
) -> None:
    """Compare both products with a central difference along a direction, and with each other.

    Args:
        step: of the difference, whose error falls with its square.
        rel: bound of the relative difference.
    """
    random = np.random.default_rng(5)
    weights = [random.normal(size=shape) for shape in model.output_shapes]

    def total(sign: int) -> float:
        outputs = model.evaluate([v + sign * step * d for v, d in zip(values, direction, strict=True)])
        return _product(weights, outputs)

    difference = (total(1) - total(-1)) / (2 * step)
    slope = _product(model.gradient(values, weights), direction)
    print(f"{model.inputs}: {slope:.10g}, by differences {difference:.10g}")
    assert slope == pytest.approx(difference, rel=rel)
    assert _product(weights, model.along(values, direction)) == pytest.approx(slope, rel=1e-8)


def _product(weights: Sequence[Any], values: Sequence[Any]) -> float:
    return sum(float(np.sum(np.multiply(w, v))) for w, v in zip(weights, values, strict=True))
