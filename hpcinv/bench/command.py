"""Command line of the benchmark, ``python -m hpcinv bench``: a table for each section asked for, and a JSON file."""

from __future__ import annotations

import argparse
import json
import platform
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpcinv.errors import OutputError

if TYPE_CHECKING:
    from hpcinv.bench.bench import Bench
    from hpcinv.bench.report import Findings

SECTIONS = ("strategies", "ranks", "phases", "linear", "scaling")


_MACHINE = (
    ("latency", 2e-6, "assumed seconds of a message"),
    ("bandwidth", 1e10, "assumed bytes per second of a rank"),
    ("file-operations", 2e4, "assumed calls per second of the file system"),
)


def add_bench(commands: Any) -> None:
    """Add the command ``bench`` to a parser's."""
    bench = commands.add_parser("bench", help="measure: strategies, ranks, linear solvers, phases, scaling (no mpirun)")
    bench.add_argument("sections", nargs="*", metavar="section", help=f"{', '.join(SECTIONS)} (default: all)")
    bench.add_argument(
        "--size", type=_whole, default=41_000, metavar="N", help="unknowns in strategies, phases (about; 41000)"
    )
    bench.add_argument(
        "--line-searches",
        nargs="+",
        default=[],
        metavar="TYPE",
        help="PETSc line searches to compare too, in strategies",
    )
    bench.add_argument("--repeat", type=_whole, default=3, metavar="N", help="runs of each kind, in turns; medians (3)")
    bench.add_argument(
        "--sizes",
        type=_whole,
        nargs="+",
        metavar="N",
        help="unknowns in ranks (about; 41000 250000) and in linear (5000 15000 50000)",
    )
    bench.add_argument(
        "--per-rank", type=_whole, default=2_000, metavar="N", help="unknowns of a rank in scaling (about; 2000)"
    )
    bench.add_argument(
        "--ranks", type=_whole, nargs="+", default=[1, 2, 4, 8, 16], metavar="N", help="ranks in scaling (1 2 4 8 16)"
    )
    for name, value, text in _MACHINE:
        bench.add_argument(f"--{name}", type=float, default=value, metavar="X", help=f"{text} ({value:g}), in scaling")
    bench.add_argument("--plot", type=Path, metavar="FILE", help="diagram of scaling")
    bench.add_argument("--out", type=Path, metavar="FILE", help="all figures as JSON")
    bench.set_defaults(command=_bench)


def _whole(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError("must be 1 or more")
    return number


def _bench(options: argparse.Namespace) -> int:
    if unknown := [name for name in options.sections if name not in SECTIONS]:
        raise OutputError(f"bench: unknown section '{unknown[0]}'", f"There are {', '.join(SECTIONS)}.")
    if options.out is not None and not options.out.parent.is_dir():
        raise OutputError(f"--out {options.out}: no such directory")

    from hpcinv.bench.bench import Bench
    from hpcinv.bench.report import show

    found: dict[str, Any] = {"machine": {"processor": platform.processor() or platform.machine()}}
    with tempfile.TemporaryDirectory(prefix="hpcinv-bench-") as directory:
        bench = Bench(Path(directory), lambda text: print(text, file=sys.stderr, flush=True))
        for name, section in _sections(options).items():
            if options.sections and name not in options.sections:
                continue
            findings = section(bench)
            show(findings)
            found[name] = findings.data
            if options.out is not None:
                options.out.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    return 0


def _sections(options: argparse.Namespace) -> dict[str, Callable[[Bench], Findings]]:
    from hpcinv.bench.costmodel import Machine
    from hpcinv.bench.linear import linear
    from hpcinv.bench.phases import phases
    from hpcinv.bench.ranks import ranks
    from hpcinv.bench.scaling import scaling
    from hpcinv.bench.strategies import strategies

    one_size = {"size": options.size, "repeat": options.repeat}
    return {
        "strategies": partial(strategies, **one_size, line_searches=options.line_searches),
        "ranks": partial(ranks, sizes=sorted(options.sizes or (41_000, 250_000)), repeat=options.repeat),
        "phases": partial(phases, **one_size),
        "linear": partial(linear, sizes=sorted(options.sizes or (5_000, 15_000, 50_000)), repeat=options.repeat),
        "scaling": partial(
            scaling,
            size=options.per_rank,
            ranks=sorted({1, *options.ranks}),
            machine=Machine(options.latency, options.bandwidth, options.file_operations),
            plot=options.plot,
        ),
    }
