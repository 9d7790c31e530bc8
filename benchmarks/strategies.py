"""What the default strategy saves on the silicone beam: against the paper's own, both ways, in one run.

The paper's strategy is 10 equal load steps with full Newton steps, each until the residual is below 1e-10 N or 1e-9 of
the step's first, as in the authors' code. Kernels are compiled beforehand, and the strategies take turns, so that a
noisy machine is unfair to none.

Command: mpirun -n 1 python benchmarks/strategies.py [--size "2 mm"] [--repeat 3] [--line-searches cp nleqerr l2]
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
from pathlib import Path
from typing import Any

import hpcinv
from hpcinv.job import parse
from hpcinv.mesh import write_msh
from hpcinv.result import Result
from hpcinv.runtime import MPI

JOBS = Path(__file__).parents[1] / "jobs"
NEWTON = 2.0**19 * 0.125**2  # N in one scaled unit of the residual: stress times length squared
PAPER = {
    "strategy": "fixed",
    "steps": 10,
    "reuse_tangent": False,
    "petsc": {
        "snes_convergence_test": "default",
        "snes_rtol": 1e-9,
        "snes_atol": 1e-10 / NEWTON,
        "snes_stol": 0.0,
        "snes_max_it": 50,
    },
}
type Strategies = dict[str, dict[str, Any]]


def job(analysis: str, mesh: dict[str, Any], solver: dict[str, Any]) -> hpcinv.Job:
    data = {
        "analysis": analysis,
        "mesh": mesh,
        "material": {"law": "mooney-rivlin", "c1": 101709.668, "c2": 151065.460, "d1": 7.965272689e8},
        "effects": [{"effect": "gravity", "acceleration": [0, -9.81, 0], "density": 963}],
        "supports": [{"region": "clamp", "fix": ["x", "y", "z"]}],
        "solver": solver,
    }
    return parse(data, JOBS / "benchmark.yaml")


def solver_seconds(result: Result) -> tuple[float, float]:
    """Seconds from the first assembly to the solution, and the share of them outside assembly and linear solver."""
    phases = {name: p["max"] for name, p in result.statistics["timings"]["phases"].items()}
    work = sum(phases.get(p, 0.0) for p in ("residual", "tangent", "factorization", "linear solve"))
    other = sum(phases.get(p, 0.0) for p in ("newton", "admissibility check"))
    return work + other, other / (work + other)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="2 mm", help="size of the cells")
    parser.add_argument("--repeat", type=int, default=3, help="runs of each strategy; the median is reported")
    parser.add_argument("--line-searches", nargs="*", default=[], help="PETSc line searches to compare as well")
    options = parser.parse_args()
    strategies: Strategies = {"default": {}, "paper": PAPER}
    strategies |= {name: {"petsc": {"snes_linesearch_type": name}} for name in options.line_searches}
    comm = MPI.COMM_WORLD

    straight = {"file": "../meshes/pdms_beam.py", "parameters": {"size": options.size}, "geometry_degree": 2}
    with tempfile.TemporaryDirectory() as directory:
        sagging = comm.bcast(Path(directory) / "sagging.msh")
        first = hpcinv.run(job("forward", straight, {}), comm)
        write_msh(sagging, first.body, first.shape)
        meshes = {"inverse": {"file": str(sagging)}, "forward": straight}
        hpcinv.run(job("inverse", meshes["inverse"], {}), comm)  # compiles

        unknowns = first.statistics["mesh"]["unknowns"]
        say(comm, f"{unknowns} unknowns, {comm.size} rank(s), median of {options.repeat} runs")
        say(
            comm,
            f"{'':18}{'factorizations':>15}{'solver s':>10}{'whole run s':>13}{'outside, solver':>17}{'whole run':>11}",
        )
        for analysis, mesh in meshes.items():
            compare(analysis, mesh, strategies, options.repeat, comm)


def compare(analysis: str, mesh: dict[str, Any], strategies: Strategies, repeat: int, comm: MPI.Intracomm) -> None:
    runs: dict[str, list[Result]] = {name: [] for name in strategies}
    for _ in range(repeat):
        for name, solver in strategies.items():
            runs[name].append(hpcinv.run(job(analysis, mesh, solver), comm))
    found = {}
    for name, results in runs.items():
        seconds, outside = (statistics.median(values) for values in zip(*map(solver_seconds, results), strict=True))
        total = statistics.median(r.statistics["timings"]["total"] for r in results)
        overhead = statistics.median(r.statistics["timings"]["overhead"] for r in results)
        count = results[0].legs[0].factorizations
        found[name] = count, seconds, total
        say(
            comm,
            f"{analysis + ', ' + name:18}{count:15}{seconds:10.2f}{total:13.2f}{outside:16.1%} {overhead:10.1%}",
        )
    for name in list(strategies)[1:]:
        ratios = [theirs / ours for ours, theirs in zip(found["default"], found[name], strict=True)]
        say(comm, f"{f'  {name} / default':18}{ratios[0]:14.1f}x{ratios[1]:9.1f}x{ratios[2]:12.1f}x")


def say(comm: MPI.Intracomm, line: str) -> None:
    if comm.rank == 0:
        print(line, flush=True)


if __name__ == "__main__":
    main()
