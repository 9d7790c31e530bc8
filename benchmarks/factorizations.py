"""Factors in double and single precision, with and without blocks of low rank, and the iterative solver.

Seconds are those of the solver (wall), kernels compiled; other work on the machine lengthens them.

Command: python benchmarks/factorizations.py [--sizes 41000 160000] [--analyses inverse forward] [--repeat 1]
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

from bodies import beam, block, measure

from hpcinv.cli.bench_runs import WITHOUT_CERTIFICATE, Bench, Findings, JobData, median

SOLVERS: Mapping[str, Mapping[str, Any]] = {
    "double": {"linear": "direct", "petsc": {"pc_precision": "double"}},
    "single": {"linear": "direct", "petsc": {"pc_precision": "single", "mat_mumps_icntl_35": 0}},
    "single, low rank": {"linear": "direct", "petsc": {"pc_precision": "single", "mat_mumps_icntl_35": 2}},
    "iterative": {"linear": "iterative"},
}
FIGURES = ("tangents factorized", "corrections", "Krylov", "solver (s)", "factorizations (s)", "MB")


def factorizations(bench: Bench, options: argparse.Namespace) -> list[Findings]:
    bodies = {"beam": beam, "block": block}
    jobs: dict[str, tuple[JobData, int]] = {
        f"{name}, about {size}, {analysis}, {solver}": (
            of(size, analysis=analysis, solver=settings, certificate=WITHOUT_CERTIFICATE),
            1,
        )
        for size in options.sizes
        for name, of in bodies.items()
        if name in options.bodies
        for analysis in options.analyses
        for solver, settings in SOLVERS.items()
        if solver in options.solvers
    }
    found = {
        name: {
            "unknowns": of[0].unknowns,
            "tangents factorized": of[0].count("factorizations"),
            "corrections": of[0].count("newton_iterations"),
            "Krylov": sum(solution["linear"]["iterations"] for solution in of[0].found["solutions"]),
            "solver (s)": median(of, lambda run: run.solver),
            "factorizations (s)": median(of, lambda run: run.phases["factorization"]),
            "MB": median(of, lambda run: sum(run.memory)) / 1e6,
            "fallback": of[0].found["solutions"][0]["linear"]["fallback"] or "",
        }
        for name, of in bench.alternating(jobs, options.repeat).items()
    }
    return [
        Findings(
            f"factorizations: 1 rank, medians of {options.repeat}",
            ("body, analysis, solver", "unknowns", *FIGURES, "fallback"),
            [
                (name, f"{of['unknowns']}", *(f"{of[title]:.4g}" for title in FIGURES), of["fallback"])
                for name, of in found.items()
            ],
            data={"repeat": options.repeat, "figures": found},
        )
    ]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[41_000, 160_000], help="unknowns, about")
    parser.add_argument("--bodies", nargs="+", default=["beam", "block"])
    parser.add_argument("--analyses", nargs="+", default=["inverse", "forward"])
    parser.add_argument("--solvers", nargs="+", choices=SOLVERS, default=list(SOLVERS))
    measure(parser, factorizations)
