"""Solves that begin with a solution predicted from a sweep: the answer of a cold start, with fewer factorizations."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import BLOCK
from helpers.sweeps import write_sweep

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.driver import run
from hpcinv.errors import JobError
from hpcinv.job.job import Job, parse
from hpcinv.studies.sweep.radial_basis import RadialBasis
from hpcinv.studies.sweep.reduced_basis import STRATEGY
from hpcinv.studies.sweep.sweep_plan import load_sweep
from hpcinv.studies.sweep.training import train

AXES = [{"sobol": {"material.mu": ["10 kPa", "40 kPa"], "effects[0].density": [800, 1200]}, "count": 8, "seed": 1}]


def job(directory: Path, **changes: Any) -> Job:
    given = parse(BLOCK | {"certificate": "off"}, directory / "job.yaml")
    return given.with_({"material.mu": "17 kPa", "effects[0].density": 950} | changes)


@pytest.mark.parallel([2])
def test_start_of_a_sweep(run_directory: Path, comm: MPI.Intracomm) -> None:
    if comm.rank == 0:
        write_sweep(run_directory, AXES, keep_solutions=True, set={"certificate": "off"})
    comm.barrier()
    path = run_directory / "sweep.yaml"
    hpcinv.sweep(path, comm, ranks_per_case=comm.size)
    training = train(load_sweep(path), run_directory / "start", comm)
    assert training.cases == 8
    assert max(training.errors) < 0.05

    cold, warm = (run(job(run_directory, **more), comm) for more in ({}, {"solver.start": "start"}))
    first, second = cold.solutions[0], warm.solutions[0]
    assert [solve.strategy for solve in second.solves] == [STRATEGY]
    assert second.factorizations == 1 < first.factorizations
    size = comm.allreduce(np.abs(first.u).max(), op=MPI.MAX)
    assert np.abs(second.u - first.u).max() < 1e-11 * size

    beyond = run(job(run_directory, **{"solver.start": "start", "material.mu": "60 kPa"}), comm)
    assert STRATEGY not in {solve.strategy for solve in beyond.solutions[0].solves}

    for more, text in (
        ({"material": {"law": "gent", "mu": "17 kPa", "jm": 30, "kappa": "70 kPa"}}, "material"),
        ({"mesh.parameters.nz": 3}, "mesh"),
    ):
        data = job(run_directory, **{"solver.start": "start"}).data
        given = parse(data, run_directory / "job.yaml").with_(more)
        with pytest.raises(JobError, match=rf"job.yaml: solver.start: .*start is of jobs with another .*{text}"):
            run(given, comm)
    comm.barrier()
    if comm.rank == 0:
        shutil.rmtree(run_directory / "start" / "modes.bp")
    comm.barrier()
    for name, text in (("start", "is damaged"), ("nowhere", "is not a start of 'hpcinv sweep teach'")):
        with pytest.raises(JobError, match=text):
            run(job(run_directory, **{"solver.start": name}), comm)


def test_sweeps_without_enough_solutions_are_refused(tmp_path: Path, comm: MPI.Intracomm) -> None:
    path = write_sweep(tmp_path, [{"grid": {"material.mu": ["10 kPa", "20 kPa"]}}], set={"certificate": "off"})
    hpcinv.sweep(path, comm)
    with pytest.raises(JobError, match=r"2 of 2 converged cases have kept no solution: add 'keep_solutions: true'"):
        train(load_sweep(path), tmp_path / "start", comm)
    assert not (tmp_path / "start").exists()


def test_interpolation_over_dependent_numbers() -> None:
    """Smooth values of three numbers, one a function of the others; the error at points left out is the real one."""
    random = np.random.default_rng(3)

    def numbers(x: np.ndarray) -> np.ndarray:
        a, b = np.exp(x[:, 0]), 1 + x[:, 1]
        return np.stack([a, 3 * a, b, np.full(len(x), 5.0)], axis=1)

    def values(x: np.ndarray) -> np.ndarray:
        return np.stack([np.exp(x[:, 0] - x[:, 1]), np.sin(2 * x[:, 1])], axis=1)

    x, new = random.random((30, 2)), random.uniform(0.2, 0.8, (20, 2))
    basis = RadialBasis(numbers(x).tolist(), values(x))
    errors = [np.abs(basis(n) - v).max() for n, v in zip(numbers(new), values(new), strict=True)]
    assert max(errors) < 1e-3
    assert max(errors) < 10 * np.abs(basis.errors).max()
    inside, _ = numbers(new)[:2]
    assert basis.outside(inside) == 0
    assert basis.outside([*inside[:3], 5.1]) == np.inf  # it does not vary
    assert basis.outside([inside[0], 2 * inside[1], *inside[2:]]) == np.inf  # it follows from the first one
    assert basis.outside([-inside[0], *inside[1:]]) == np.inf
    assert 0.3 < basis.outside([np.exp(1.5), 3 * np.exp(1.5), *inside[2:]]) < 0.8
