"""The default strategy on the silicone beam against the paper's own, inverse and forward.

The paper's strategy is 10 equal load steps with full Newton steps, each until the residual is below 1e-10 N or 1e-9 of
the step's first, as in the authors' code (Mazier et al. 2022, doi:10.1007/s00366-021-01597-z).

Command: python benchmarks/strategies.py [--size 41000] [--repeat 3] [--line-searches bt …]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from typing import Any

from bench_runs import Bench, Findings, JobData, MeasuredRun, median
from bodies import beam, measure, sagging_beam

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


def total(run: MeasuredRun) -> float:
    """Seconds of the run after the imports, without the compilation of kernels."""
    return float(run.data["timings"]["total"]) - run.phases.get("programs", 0.0)


FIGURES: Mapping[str, Callable[[MeasuredRun], float]] = {
    "factorizations": lambda run: run.count("factorizations"),
    "solver": lambda run: run.solver,
    "run without certificate": lambda run: total(run) - run.phases["certificate"],
    "whole run": total,
    "command to prompt": lambda run: run.seconds,
    "outside, solver": lambda run: (run.phases["newton"] + run.phases["admissibility check"]) / run.solver,
}


def strategies(bench: Bench, options: argparse.Namespace) -> list[Findings]:
    solvers: dict[str, Mapping[str, Any]] = {"default": {}, "paper": PAPER}
    solvers |= {name: {"petsc": {"snes_linesearch_type": name}} for name in options.line_searches}
    meshes = {"inverse": {"mesh": sagging_beam(bench, options.size)}, "forward": {}}
    jobs: dict[str, tuple[JobData, int]] = {
        f"{analysis}, {name}": (beam(options.size, analysis=analysis, solver=solver, **mesh), 1)
        for analysis, mesh in meshes.items()
        for name, solver in solvers.items()
    }
    runs = bench.alternating(jobs, options.repeat)
    seconds = {name: {title: median(of, figure) for title, figure in FIGURES.items()} for name, of in runs.items()}
    for analysis in meshes:
        of = {kind: seconds[f"{analysis}, {kind}"] for kind in ("default", "paper")}
        seconds[f"{analysis}, paper / default"] = {
            title: of["paper"][title] / of["default"][title] for title in FIGURES
        }
    unknowns = next(iter(runs.values()))[0].unknowns
    return [
        Findings(
            f"strategies: silicone beam, {unknowns} unknowns, 1 rank, medians of {options.repeat}",
            ("seconds", *FIGURES),
            [(name, *(f"{figures[title]:.3g}" for title in FIGURES)) for name, figures in seconds.items()],
            data={"unknowns": unknowns, "repeat": options.repeat, "figures": seconds},
        )
    ]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=41_000, help="unknowns, about (41000)")
    parser.add_argument("--line-searches", nargs="+", default=[], help="PETSc line searches to compare too")
    measure(parser, strategies)
