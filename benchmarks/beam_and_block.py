"""The sections of ``benchmarks/machine.py`` on the paper's beam and on a block, and the phases of a whole run.

Command: python benchmarks/beam_and_block.py linear|ranks|phases [--sizes N …] [--repeat 3]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from functools import partial

from bench_runs import Bench, Findings, JobData, MeasuredRun, median
from bodies import beam, block, measure, sagging_beam
from machine import linear, ranks

from hpcinv.base.parallel.timings import SOLVER, WORK

SIZES = {"linear": [5_000, 15_000, 50_000], "ranks": [41_000, 250_000], "phases": [41_000]}


def section(bench: Bench, options: argparse.Namespace) -> list[Findings]:
    sizes = sorted(options.sizes or SIZES[options.section])
    sagging: Mapping[str, Callable[[int], JobData]] = {
        "beam": lambda size: beam(size, mesh=sagging_beam(bench, size)),
        "block": block,
    }
    match options.section:
        case "linear":
            return [linear(bench, {"beam": beam, "block": block}, sizes, options.repeat)]
        case "ranks":
            return [ranks(bench, sagging, sizes, (1, 2), options.repeat)]
    jobs = {name: (body(sizes[-1]), 1) for name, body in sagging.items()}
    return [phases(bench.alternating(jobs, options.repeat), options.repeat)]


def phases(runs: dict[str, list[MeasuredRun]], repeat: int) -> Findings:
    """Microseconds per unknown in each phase, and the share outside of kernels, PETSc and MPI."""
    expected = ("mesh", "set-up", *SOLVER, "certificate")
    names = {name: None for name in expected if any(name in body_runs[0].phases for body_runs in runs.values())}
    names |= {name: None for body_runs in runs.values() for name in body_runs[0].phases if name != "programs"}
    seconds = {
        body: {name: median(body_runs, partial(_phase, name=name)) for name in names}
        for body, body_runs in runs.items()
    }
    unknowns = {body: body_runs[0].unknowns for body, body_runs in runs.items()}
    rows = [(name, *(f"{1e6 * seconds[body][name] / unknowns[body]:.2f}" for body in runs)) for name in names]
    overheads = [median(body_runs, lambda run: run.data["timings"]["overhead"]) for body_runs in runs.values()]
    earlier_shares = [median(body_runs, _overhead_without_certificate) for body_runs in runs.values()]
    return Findings(
        f"phases: inverse, 1 rank, medians of {repeat}",
        ("µs per unknown", *(f"{body}, {n} unknowns" for body, n in unknowns.items())),
        [
            *rows,
            ("outside of kernels, PETSc and MPI", *(f"{share:.1%}" for share in overheads)),
            ("the same before the certificate", *(f"{share:.1%}" for share in earlier_shares)),
        ],
        data={"unknowns": unknowns, "seconds": seconds, "outside": overheads, "before the certificate": earlier_shares},
    )


def _phase(run: MeasuredRun, name: str) -> float:
    return run.phases.get(name, 0.0)


def _overhead_without_certificate(run: MeasuredRun) -> float:
    seconds = run.phases
    return 1 - sum(seconds.get(name, 0.0) for name in WORK) / float(
        run.data["timings"]["total"] - seconds["certificate"]
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("section", choices=SIZES)
    parser.add_argument("--sizes", type=int, nargs="+", help="unknowns, about")
    measure(parser, section)
