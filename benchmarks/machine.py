"""Measure the set-up of a machine, linear solvers, and the gain of more ranks: ``python benchmarks/machine.py``.

Two bodies of silicone are solved: a cube on its clamped bottom face, and a rod 20 times as long as wide, clamped at one
end; both under their own weight, inverse, in the mixed form.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import bench_runs
from bench_runs import WITHOUT_CERTIFICATE, Bench, Findings, JobData, MeasuredRun, median

from hpcinv.base.files.atomic import output_errors
from hpcinv.cli.options import positive
from hpcinv.errors import HpcinvError, SolveError

type Bodies = Mapping[str, Callable[[int], JobData]]

SECTIONS = ("setup", "linear", "ranks")
LINEAR_SOLVERS = ("direct", "iterative")
_SIZES = {"linear": (5_000, 15_000, 50_000), "ranks": (40_000,)}
_PHASES = ("tangent", "factorization", "linear solve")
_GEOMETRY = """SetFactory("OpenCASCADE");
Box(1) = {{0, 0, 0, {length}, {width}, {width}}};
Transfinite Curve {{1:8}} = {across} + 1;
Transfinite Curve {{9:12}} = {along} + 1;
Transfinite Surface {{:}};
Transfinite Volume {{1}};
Physical Volume("silicone") = {{1}};
Physical Surface("clamp") = {{1}};
"""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sections", nargs="*", metavar="section", help=f"{', '.join(SECTIONS)} (default: all)")
    parser.add_argument(
        "--sizes",
        type=positive,
        nargs="+",
        metavar="N",
        help="unknowns, about (linear: 5000 15000 50000; ranks: 40000)",
    )
    parser.add_argument(
        "--ranks", type=positive, nargs="+", metavar="N", help="ranks that are compared (1, 2, 4 … up to the cores)"
    )
    parser.add_argument("--repeat", type=positive, default=3, metavar="N", help="rounds, for medians (3)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write all figures as JSON")
    options = parser.parse_args()
    if unknown := [name for name in options.sections if name not in SECTIONS]:
        parser.error(f"unknown section '{unknown[0]}': there are {', '.join(SECTIONS)}")
    if options.out is not None and not options.out.parent.is_dir():
        parser.error(f"--out {options.out}: no such directory")
    up_to_the_cores = [2**k for k in range(len(os.sched_getaffinity(0)).bit_length())]
    counts = sorted(set(options.ranks or up_to_the_cores))
    content: dict[str, Any] = {"machine": {"processor": platform.processor() or platform.machine()}}
    with tempfile.TemporaryDirectory(prefix="hpcinv-bench-") as directory:
        bench = Bench(Path(directory), lambda text: print(text, file=sys.stderr, flush=True))
        for name in options.sections or SECTIONS:
            sizes = sorted(set(options.sizes or _SIZES.get(name, ())))
            match name:
                case "setup":
                    findings = setup(bench, counts)
                case "linear":
                    findings = linear(bench, bodies(bench), sizes, options.repeat)
                case _:
                    findings = ranks(bench, bodies(bench), sizes, counts, options.repeat)
            findings.show()
            content[name] = findings.data
            if options.out is not None:
                with output_errors(options.out):
                    options.out.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    return 0


def bodies(bench: Bench) -> Bodies:
    """Return functions that make a job of about a number of unknowns, with its geometry in the bench's directory."""
    return {
        "cube": lambda unknowns: _body(bench, unknowns, 1.0, 1, [-9.81, 0, 0]),
        "rod": lambda unknowns: _body(bench, unknowns, 0.01, 20, [0, -9.81, 0]),
    }


def _body(bench: Bench, unknowns: int, width: float, slenderness: int, acceleration: Sequence[float]) -> JobData:
    """Return a job of a box of quadratic tetrahedra, with cells up to twice as long as wide."""

    def length_divisions(n: int) -> int:
        return math.ceil(slenderness / 2) * n

    def count(n: int) -> int:
        return 3 * (2 * n + 1) ** 2 * (2 * length_divisions(n) + 1) + (n + 1) ** 2 * (length_divisions(n) + 1)

    width_divisions = min(range(1, 100), key=lambda n: abs(count(n) - unknowns))
    file = bench.directory / f"box-{slenderness}-{width_divisions}.geo"
    file.write_text(
        _GEOMETRY.format(
            length=slenderness * width, width=width, across=width_divisions, along=length_divisions(width_divisions)
        ),
        encoding="utf-8",
    )
    return {
        "job": "bench",
        "mesh": {"file": str(file)},
        "material": {"law": "mooney-rivlin", "c1": 101709.668, "c2": 151065.460, "d1": 7.965272689e8},
        "effects": [{"effect": "gravity", "acceleration": list(acceleration), "density": 963}],
        "supports": [{"region": "clamp", "fix": ["x", "y", "z"]}],
        "checkpoint": {"every": 0},
        "output": {"fields": False, "mesh": []},
    }


def setup(bench: Bench, counts: Sequence[int]) -> Findings:
    """Check that the launcher's ranks form one communicator; measure the time of imports and the memory bandwidth."""

    bench.note("set-up: warming up")
    bench.output(bench_runs.__file__)
    probes = {}
    for count in counts:
        bench.note(f"set-up, on {count}")
        text = bench.output(bench_runs.__file__, ranks=count)
        try:
            probes[count] = json.loads(text)
        except ValueError:  # every process prints
            raise SolveError(
                f"the launcher starts {count} separate processes, not {count} ranks of one run",
                "Set HPCINV_LAUNCHER to the one of the MPI that mpi4py was built with, such as 'srun --mpi=pmi2'.",
            ) from None
    alone = probes[counts[0]]
    return Findings(
        "setup: imports and memory",
        ("ranks", "imports (s)", "memory (GB/s)", "times the first"),
        [
            (
                str(count),
                f"{probe['imports']:.2f}",
                f"{probe['bandwidth'] / 1e9:.1f}",
                f"{probe['bandwidth'] / alone['bandwidth']:.2f}",
            )
            for count, probe in probes.items()
        ],
        [
            f"{len(os.sched_getaffinity(0))} cores may be used; the ranks of each row are in one communicator",
            "Iterative solves are limited by memory: more ranks help them as far as this column rises.",
            "Where imports take longer on more ranks, read docs/how-to/start-up.md.",
        ],
        {str(count): probe for count, probe in probes.items()},
    )


def linear(bench: Bench, measured: Bodies, sizes: Sequence[int], repeat: int) -> Findings:
    """Compare direct and iterative linear solver over size on one rank: seconds, memory, and the crossover."""

    rows: list[tuple[str, ...]] = []
    notes: list[str] = []
    data = dict[str, list[dict[str, float]]]()
    for name, body in measured.items():
        jobs = [{**body(size), "certificate": WITHOUT_CERTIFICATE} for size in sizes]
        for size, job in zip(sizes, jobs, strict=True):
            runs: dict[str, list[MeasuredRun]] = {kind: [] for kind in LINEAR_SOLVERS}
            for _ in range(repeat):
                for kind, kind_runs in runs.items():
                    title = f"{name}, about {size} unknowns, {kind}"
                    kind_runs.append(bench.run(title, {**job, "solver": {"linear": kind}}))
                    if not kind_runs[-1].solved:
                        notes.append(f"{title}: {kind_runs[-1].ending}")
            figures = _figures(runs)
            data.setdefault(name, []).append(figures)
            rows.append((name, *_cells(figures)))
        notes += [f"{name}: {_crossing(figure, data[name])}" for figure in ("seconds", "bytes")]
    return Findings(
        f"linear: inverse, 1 rank, medians of {repeat}",
        ("body", "unknowns", *(f"{k} {unit}" for unit in ("s", "MB") for k in LINEAR_SOLVERS), "Krylov / Newton"),
        rows,
        notes,
        {"repeat": repeat, "series": data},
    )


def _figures(runs: Mapping[str, Sequence[MeasuredRun]]) -> dict[str, float]:
    """Return medians over the runs of each linear solver that solved all of them."""

    figures = dict[str, float]()
    for kind, kind_runs in runs.items():
        if all(run.solved for run in kind_runs):
            figures["unknowns"] = kind_runs[0].unknowns
            figures[f"{kind} seconds"] = median(kind_runs, lambda run: run.solver)
            figures[f"{kind} bytes"] = median(kind_runs, lambda run: sum(run.memory))
            figures[f"{kind} Newton iterations"] = kind_runs[0].count("newton_iterations")
            figures[f"{kind} Krylov iterations"] = kind_runs[0].count("linear.iterations")
    return figures


def crossover(sizes: Sequence[float], first: Sequence[float], second: Sequence[float]) -> float | None:
    """Return the size from which ``second`` is less than ``first``, interpolated in logarithms, or ``None``."""
    points = [(math.log(n), math.log(a / b)) for n, a, b in zip(sizes, first, second, strict=True)]
    for (x, f), (y, g) in pairwise(sorted(points)):
        if f <= 0 < g:
            return math.exp(x - f * (y - x) / (g - f))
    return None


def _crossing(figure: str, series: Sequence[Mapping[str, float]]) -> str:
    names = ("unknowns", *(f"{kind} {figure}" for kind in LINEAR_SOLVERS))
    known = [[figures[name] for name in names] for figures in series if all(name in figures for name in names)]
    if not known:
        return f"no {figure} to compare"
    sizes, direct, iterative = zip(*known, strict=True)
    size = crossover(sizes, direct, iterative)
    if size is not None:
        return f"the iterative solver takes fewer {figure} from {size:,.0f} unknowns on"
    less = "everywhere" if all(b < a for a, b in zip(direct, iterative, strict=True)) else "nowhere"
    return f"the iterative solver takes fewer {figure} {less} between {min(sizes):,.0f} and {max(sizes):,.0f} unknowns"


def _cells(figures: Mapping[str, float]) -> list[str]:
    def shown(name: str, unit: float = 1, digits: int = 0) -> str:
        return f"{figures[name] / unit:.{digits}f}" if name in figures else "-"

    return [
        shown("unknowns"),
        *(shown(f"{kind} seconds", digits=2) for kind in LINEAR_SOLVERS),
        *(shown(f"{kind} bytes", 1e6) for kind in LINEAR_SOLVERS),
        f"{shown('iterative Krylov iterations')} / {shown('iterative Newton iterations')}",
    ]


def ranks(bench: Bench, measured: Bodies, sizes: Sequence[int], counts: Sequence[int], repeat: int) -> Findings:
    """Measure the speed-up of more ranks, with the linear solver that hpcinv selects."""

    bodies = {
        f"{name}, {size}": {**body(size), "certificate": WITHOUT_CERTIFICATE}
        for size in sizes
        for name, body in measured.items()
    }
    jobs = {f"{name}, on {count}": (job, count) for name, job in bodies.items() for count in counts}
    runs = bench.alternating(jobs, repeat)
    seconds = {
        name: {
            "solver": median(body_runs, lambda run: run.solver),
            **{phase: median(body_runs, lambda run, phase=phase: run.phases.get(phase, 0.0)) for phase in _PHASES},  # type: ignore[misc]
            "command": median(body_runs, lambda run: run.seconds),
        }
        for name, body_runs in runs.items()
    }
    rows, notes = list[tuple[str, ...]](), list[str]()
    for name in bodies:
        alone = seconds[f"{name}, on {counts[0]}"]
        for count in counts:
            mine, body_runs = seconds[f"{name}, on {count}"], runs[f"{name}, on {count}"]
            faster = (f"{alone[title] / mine[title]:.2f}" if mine[title] > 1e-3 else "" for title in mine)
            memory = f"{median(body_runs, lambda run: max(run.memory)) / 1e6:.0f}"
            rows.append(
                (
                    name.partition(",")[0],
                    f"{body_runs[0].unknowns}",
                    str(count),
                    f"{mine['solver']:.2f}",
                    *faster,
                    memory,
                )
            )
        best = min(counts, key=lambda count: seconds[f"{name}, on {count}"]["command"])
        notes.append(f"{rows[-1][0]}, {rows[-1][1]} unknowns: fastest from command to prompt on {best}")
    return Findings(
        f"ranks: inverse, seconds of the solver, and how many times as fast as {counts[0]}, medians of {repeat}",
        ("body", "unknowns", "ranks", "s", "solver", *_PHASES, "command", "MB a rank"),
        rows,
        notes,
        {
            "repeat": repeat,
            "unknowns": {name: body_runs[0].unknowns for name, body_runs in runs.items()},
            "seconds": seconds,
        },
    )


if __name__ == "__main__":
    try:
        sys.exit(main())
    except HpcinvError as failure:
        print(failure, file=sys.stderr)
        sys.exit(2)
