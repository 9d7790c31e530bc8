"""Solves of new cases from the unloaded body, by power series, and from solutions predicted by a reduced basis.

The body is the ventricle of `jobs/ventricle.yaml`, whose rest shape is sought from 6 to 12 mmHg; four numbers vary, of
which three are of its law. All runs are of one process, which has mesh, kernels and equations from a first case that is
not counted. Processor seconds are of the solve, without mesh, kernels, checks and files; reading the start has a column
of its own. The last column is the largest relative difference from the unloaded start's displacements.

Command: mpirun -n 1 python benchmarks/reduced_basis.py [--size "6 mm"] [--cases 48] [--new 5] [--linear direct]
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml
from bench_runs import Findings

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.parallel.timings import Timings
from hpcinv.driver import run
from hpcinv.job.job import Job, load
from hpcinv.output.progress import Progress
from hpcinv.results.solution import Solution
from hpcinv.solver.workspace import Workspace
from hpcinv.studies.sweep.reduced_basis import predicted_guesses
from hpcinv.studies.sweep.sweep_plan import load_sweep
from hpcinv.studies.sweep.training import train

JOB = Path(__file__).parents[1] / "jobs" / "ventricle.yaml"
RANGES = {
    "material.c": ["0.3 kPa", "1 kPa"],
    "material.b_f": [10, 30],
    "material.b_t": [4, 12],
    "effects[0].pressure": ["6 mmHg", "12 mmHg"],
}
WAYS: dict[str, dict[str, str]] = {
    "unloaded": {},
    "series": {"solver.continuation": "series"},
    "sweep's start": {"solver.start": "start"},
}
KEYS = ("mesh", "let", "fibres", "material", "supports")


class SolveSeconds(Progress):
    """A silent progress that adds up the processor seconds of solves."""

    def __init__(self) -> None:
        super().__init__(MPI.COMM_WORLD, None)
        self.seconds = 0.0

    @contextmanager
    def phase(self, name: str, about: str = "", *, announced: bool = True) -> Iterator[None]:
        begun = time.process_time()
        with super().phase(name, about, announced=announced):
            yield
        if name == "solving":
            self.seconds += time.process_time() - begun


def job_data(size: str, linear: str) -> dict[str, Any]:
    """Return the ventricle at the end of filling, as content of a job file."""
    ventricle = load(JOB)
    data = {key: ventricle.data[key] for key in KEYS}
    mesh = {**data["mesh"], "file": str((JOB.parent / data["mesh"]["file"]).resolve()), "parameters": {"size": size}}
    effects = ventricle.data["states"][0]["effects"]
    solver = {"linear": linear}
    return data | {"mesh": mesh, "effects": effects, "certificate": "off", "solver": solver, "job": "lv"}


def measured(job: Job, workspace: Workspace) -> tuple[hpcinv.Result, float]:
    """Return the result of a run, and processor seconds of its solve."""
    progress = SolveSeconds()
    return run(job, MPI.COMM_WORLD, workspace=workspace, progress=progress), progress.seconds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="6 mm")
    parser.add_argument("--cases", type=int, default=48, help="cases of the sweep")
    parser.add_argument("--new", type=int, default=5, help="new cases")
    parser.add_argument("--linear", default="auto", choices=("auto", "direct", "iterative"))
    options = parser.parse_args()
    comm, random = MPI.COMM_WORLD, np.random.default_rng(11)
    with tempfile.TemporaryDirectory() as name, Workspace(comm) as workspace:
        home = Path(comm.bcast(name))
        data = job_data(options.size, options.linear)
        if comm.rank == 0:
            (home / "lv.yaml").write_text(yaml.safe_dump(data, sort_keys=False))
            axis = {"sobol": RANGES, "count": options.cases, "seed": 1}
            sweep = {"job": "lv.yaml", "store": "store", "keep_solutions": True, "axes": [axis]}
            (home / "sweep.yaml").write_text(yaml.safe_dump(sweep, sort_keys=False))
        comm.barrier()
        begun = time.process_time()
        hpcinv.sweep(home / "sweep.yaml", comm, ranks_per_case=comm.size)
        swept = time.process_time() - begun
        begun = time.process_time()
        training = train(load_sweep(home / "sweep.yaml"), home / "start", comm)
        if comm.rank == 0:
            print(
                f"sweep of {training.cases} cases {swept:.0f} s, training {time.process_time() - begun:.1f} s of a rank"
            )
            print("\n".join(training.lines()))
        plan = load_sweep({"job": "lv.yaml", "axes": [{"sobol": RANGES, "count": 2 * options.new, "seed": 5}]}, home)
        chosen = [plan.job(plan.cases[i]) for i in random.permutation(len(plan.cases))[: options.new + 1]]
        figures: dict[str, list[list[float]]] = {way: [] for way in WAYS}
        for given in chosen:
            solutions: list[Solution] = []
            for way, solver in WAYS.items():
                job = given.with_(solver)
                equations = workspace.equations(job, workspace.body(job), Timings())
                begun = time.process_time()
                predicted_guesses(job, equations, print)
                reading = time.process_time() - begun
                result, seconds = measured(job, workspace)
                solutions += result.solutions
                cold, last = solutions[0], solutions[-1]
                difference = np.abs(last.u - cold.u).max() / np.abs(cold.u).max()
                figures[way].append([last.factorizations, seconds, reading, difference])
        spaces = [field.function_space.dofmap for field in cold.fields if field is not None]
        unknowns = sum(space.index_map.size_global * space.index_map_bs for space in spaces)
        Findings(
            f"{options.new} new cases of a ventricle of {unknowns:,} unknowns: processor seconds of a rank",
            ("begins", "factorizations", "solve, median", "most", "reading", "difference"),
            [row(way, np.array(values[1:])) for way, values in figures.items()],
        ).show()


def row(way: str, values: npt.NDArray[np.float64]) -> list[str]:
    """Return the figures of one way to begin."""
    factorizations, seconds, reading, difference = values.T
    counts = f"{factorizations.min():.0f} to {factorizations.max():.0f}"
    middle, most = np.median(seconds), seconds.max()
    return [way, counts, f"{middle:.2f}", f"{most:.2f}", f"{np.median(reading):.2f}", f"{difference.max():.1e}"]


if __name__ == "__main__":
    main()
