"""Jobs as functions, and products of their derivatives next to central differences."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hpcinv
from helpers.moved_meshes import write_block
from helpers.verification import job
from hpcinv.base.parallel.runtime import MPI
from hpcinv.studies.learning.differentiable_job import DifferentiableJob

PACKAGES = {"torch": "torch==2.15.0", "jax": "jax==0.12.0.1"}
LOAD = "effects[0].pressure"
MODULI = "material.mu"


def posed(comm: MPI.Intracomm, directory: Path, moduli: np.ndarray | None = None) -> hpcinv.Job:
    """A block under pressure with a modulus (kPa) for each cell, by default 20."""
    file = directory / "block.vtu"
    _, middles = write_block(comm, file)
    values = np.full(len(middles), 20.0) if moduli is None else moduli
    write_block(comm, file, arrays={"mu": values})
    return job(
        analysis="inverse",
        mesh={"file": str(file)},
        material={"law": "neo-hookean", "mu": {"data": "mu", "unit": "kPa"}, "lam": "30 kPa"},
        effects=[{"effect": "pressure", "region": "x1", "pressure": 900}],
        supports=[{"region": "x0", "fix": ["x", "y", "z"]}],
        discretisation={"displacement": 1, "formulation": "displacement"},
        solver={"tolerance": 1e-13},
        quantities=[{"name": "tip", "of": "displacement", "at": [2, 1, 1]}],
        sensitivities=[LOAD],
    )


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
