"""Seconds of the certificate and of the solve, line by line, for beam, block and sphere.

Command: python benchmarks/certificate.py [--sizes 41000] [--bodies beam block sphere] [--ranks 1] [--level standard]
"""

import argparse
from functools import partial
from typing import Any

from bench_runs import Bench, Findings, JobData, MeasuredRun, median
from bodies import beam, block, measure, sagging_beam, sphere

BODIES = {"beam": beam, "block": block, "sphere": sphere}
CHECKS = {
    "equilibrium residual": "equilibrium",
    "discretisation error": "error estimate",
    "round trip": "round trip and stability",
    "stability": "round trip and stability",
}


def seconds(run: MeasuredRun, check: str) -> float:
    """Return the seconds of a check, or of all others for ``"others"``."""
    total = 0.0
    for line in run.data["certificate"]["lines"]:
        group = next((name for start, name in CHECKS.items() if line["name"].startswith(start)), "others")
        total += (line["seconds"] or 0.0) if group == check else 0.0
    return total


def certificates(bench: Bench, options: argparse.Namespace) -> list[Findings]:
    jobs: dict[str, tuple[JobData, int]] = {}
    for size in options.sizes:
        for name in options.bodies:
            for analysis in ("inverse", "forward"):
                changes: dict[str, Any] = {"analysis": analysis, "certificate": options.level}
                if name == "beam" and analysis == "inverse":
                    changes["mesh"] = sagging_beam(bench, size)
                for ranks in options.ranks:
                    jobs[f"{name}, {size}, {analysis}, {ranks} ranks"] = BODIES[name](size, **changes), ranks
    checks = (*dict.fromkeys(CHECKS.values()), "others")
    rows, data = [], {}
    for name, runs in bench.alternating(jobs, options.repeat).items():
        solve = median(runs, lambda run: run.solver)
        check_seconds = {check: median(runs, partial(seconds, check=check)) for check in checks}
        whole = median(runs, lambda run: run.phases["certificate"])
        data[name] = {"solve": solve, "certificate": whole, **check_seconds}
        figures = [f"{value:.2g}" for value in (solve, *check_seconds.values(), whole)]
        rows.append((f"{name}: {runs[0].unknowns} unknowns", *figures, f"{whole / solve:.2f}"))
    titles = ("seconds", "solve", *checks, "certificate", "certificate / solve")
    return [Findings(f"certificate: {options.level}, medians of {options.repeat}", titles, rows, data=data)]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[41_000], help="unknowns, about (41000)")
    parser.add_argument("--bodies", nargs="+", choices=BODIES, default=list(BODIES))
    parser.add_argument("--ranks", type=int, nargs="+", default=[1])
    parser.add_argument("--level", choices=["quick", "standard", "full"], default="standard")
    measure(parser, certificates)
