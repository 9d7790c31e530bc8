"""Factors in double and single precision, with and without blocks of low rank, and the iterative solver.

Seconds are wall time of one rank, kernels compiled: of the whole solver and of its factorizations ("factors"). The
solver includes a solve on coarser cells (nested iteration), with their mesh and the transfer of the solution from it
("nested"); tangents there are counted by themselves ("on coarse").

Command: python benchmarks/factorizations.py [--sizes 41000 160000] [--analyses inverse forward] [--repeat 1]
With and without nested iteration: python benchmarks/factorizations.py --bodies beam --solvers single --nested off on
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

from bench_runs import WITHOUT_CERTIFICATE, Bench, Findings, JobData, median
from bodies import beam, block, measure

from hpcinv.base.parallel.timings import NESTED

SOLVERS: Mapping[str, Mapping[str, Any]] = {
    "double": {"linear": "direct", "petsc": {"pc_precision": "double"}},
    "single": {"linear": "direct", "petsc": {"pc_precision": "single", "mat_mumps_icntl_35": 0}},
    "single, low rank": {"linear": "direct", "petsc": {"pc_precision": "single", "mat_mumps_icntl_35": 2}},
    "iterative": {"linear": "iterative"},
}
FIGURES = ("tangents", "on coarse", "corrections", "Krylov", "solver", "factors", "nested", "MB")


def factorizations(bench: Bench, options: argparse.Namespace) -> list[Findings]:
    bodies = {"beam": beam, "block": block}
    jobs: dict[str, tuple[JobData, int]] = {
        f"{name} {size // 1000}k {analysis}, {solver}{'' if nested == 'auto' else f', nested {nested}'}": (
            body(
                size,
                analysis=analysis,
                solver={**settings, "nested_iteration": nested},
                certificate=WITHOUT_CERTIFICATE,
            ),
            1,
        )
        for size in options.sizes
        for name, body in bodies.items()
        if name in options.bodies
        for analysis in options.analyses
        for solver, settings in SOLVERS.items()
        if solver in options.solvers
        for nested in options.nested
    }
    figures = {
        name: {
            "unknowns": measured[0].unknowns,
            "tangents": measured[0].count("factorizations"),
            "on coarse": sum(solve["factorizations"] for solve in map(_coarse, measured[0].data["solutions"])),
            "corrections": measured[0].count("newton_iterations"),
            "Krylov": sum(solution["linear"]["iterations"] for solution in measured[0].data["solutions"]),
            "solver": median(measured, lambda run: run.solver),
            "factors": median(measured, lambda run: run.phases["factorization"]),
            "nested": median(measured, lambda run: sum(run.phases.get(name, 0.0) for name in NESTED)),
            "MB": median(measured, lambda run: sum(run.memory)) / 1e6,
            "fallback": measured[0].data["solutions"][0]["linear"]["fallback"] or "",
        }
        for name, measured in bench.alternating(jobs, options.repeat).items()
    }
    return [
        Findings(
            f"factorizations: 1 rank, medians of {options.repeat}",
            ("seconds", "unknowns", *FIGURES, "fallback"),
            [
                (name, f"{row['unknowns']}", *(f"{row[title]:.4g}" for title in FIGURES), row["fallback"])
                for name, row in figures.items()
            ],
            data={"repeat": options.repeat, "figures": figures},
        )
    ]


def _coarse(solution: Mapping[str, Any]) -> Mapping[str, Any]:
    """Report of the solve on coarser cells, of none without one."""
    coarse: Mapping[str, Any] = solution.get("coarse", {"factorizations": 0})
    return coarse


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[41_000, 160_000], help="unknowns, about")
    parser.add_argument("--bodies", nargs="+", default=["beam", "block"])
    parser.add_argument("--analyses", nargs="+", default=["inverse", "forward"])
    parser.add_argument("--solvers", nargs="+", choices=SOLVERS, default=list(SOLVERS))
    parser.add_argument("--nested", nargs="+", choices=("auto", "on", "off"), default=["auto"], help="nested iteration")
    measure(parser, factorizations)
