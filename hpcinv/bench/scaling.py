"""Scaling on paper: counts on 1 to 16 ranks, whatever they share, and what a model fitted to them says of many more."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpcinv.bench.bodies import block
from hpcinv.bench.report import Findings
from hpcinv.bench.samples import Sample, job, take

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from hpcinv.bench.bench import Bench
    from hpcinv.bench.costmodel import CostModel, Machine
    from hpcinv.bench.halo import Halo

RANKS = (1, 2, 4, 8, 16)
UNKNOWNS, MANY = 100_000_000, 1_000
"""What is predicted: so many unknowns on so many ranks."""
CALLS = 8_000
"""Of the file system by each rank until it has the job: ``strace -f -e trace=%file``, see docs/start-up.md."""
_REMEDIES = {
    "start: imports, files of all ranks from one file system": "an image or a copy of the installation on each node",
    "mesh, read and checked by one rank": "hpcinv mesh partition, once",
}


def scaling(bench: Bench, *, size: int, ranks: Sequence[int], machine: Machine, plot: Path | None) -> Findings:
    """The block's inverse analysis with the iterative solver.

    Args:
        size: unknowns per rank in the weak series; the strong one has as many as that on 8 ranks.
        ranks: of both series, 1 and 2 or more others.
        plot: where a diagram goes, ``None`` for nowhere.
    """
    bench.compile("block", job(size, "iterative"))
    series = {
        "weak": [take(bench, size * p, p) for p in ranks],
        "strong": [take(bench, size * 8, p) for p in ranks],
        "serial": [take(bench, size * p, 1) for p in ranks[2:]],
        "direct": [take(bench, size * p, 1, "direct") for p in ranks],
    }
    start, in_parts = bench.start(), _in_parts(bench, size * ranks[-1])

    from hpcinv.bench.costmodel import CostModel, Power, Start
    from hpcinv.bench.halo import halo

    halos = {p: halo(p) for p in (*ranks, MANY)}
    samples = [s for name in ("weak", "strong", "serial") for s in series[name]]
    model = CostModel.fitted(samples, halos)
    terms = model.terms(UNKNOWNS, MANY, halos[MANY], machine, Start(start, CALLS))
    better = terms | dict.fromkeys(_REMEDIES, 0.0) | {"mesh, in parts": in_parts * UNKNOWNS / MANY}
    alone = series["direct"][-3:]  # in small ones the factors are lost in what else takes memory
    unknowns, base = [s.unknowns for s in alone], model.memory.a
    factors = Power.through(unknowns, [max(s.memory - base, 1e6) for s in alone])
    seconds = Power.through(unknowns, [s.seconds["factorization"] / s.setups for s in alone])
    if plot is not None:
        from hpcinv.bench.scalingplot import draw

        draw(plot, series, model, halos, machine, Start(0.0, 0.0))
    log_n = math.log(UNKNOWNS)
    notes = [
        f"iterations {model.iterations.a:.1f} + {model.iterations.b:.2f} ln n: {model.iterations.at(log_n):.0f}"
        f" ± {model.iterations.error(log_n):.0f} (standard error of the fit) in all of {model.newton:.1f} Newton steps",
        f"an iteration, {MANY} ranks: {halos[MANY].neighbours:.0f} neighbours"
        f" × {model.exchanges['iteration'].at(log_n):.0f} exchanges,"
        f" {_surface(model, halos[MANY], 'iteration') / 1e3:.0f} kB sent,"
        f" {model.reductions['iteration']:.0f} reductions",
        f"memory: {model.memory.at(UNKNOWNS / MANY) / 1e6:.0f} MB a rank"
        f" ({model.memory.b:.0f} bytes per unknown, and {base / 1e6:.0f} MB)",
        f"direct: factors of {factors.at(UNKNOWNS) / MANY / 1e9:,.0f} GB a rank (n^{factors.q:.2f}),"
        f" {seconds.at(UNKNOWNS) / MANY:,.0f} s for each of them if it were perfectly parallel (n^{seconds.q:.2f})",
        f"assumed: latency {machine.latency * 1e6:g} µs, {machine.bandwidth / 1e9:g} GB/s for each rank,"
        f" {machine.file_operations:,.0f} calls a second for the file system",
    ]
    prediction = Findings(
        f"prediction: {UNKNOWNS:.0e} unknowns on {MANY} ranks, {sum(terms.values()):.0f} s,"
        f" or {sum(better.values()):.1f} s with the remedies",
        ("term", "s", "with remedies", "remedy"),
        [
            (name, f"{terms.get(name, 0.0):.3g}", f"{better[name]:.3g}", _REMEDIES.get(name, ""))
            for name in sorted(better, key=lambda name: -max(terms.get(name, 0.0), better[name]))
        ],
        notes,
    )
    return Findings(
        "scaling: block, inverse, iterative solver; means over ranks, of an iteration of the linear solver",
        (
            "series",
            "unknowns",
            "ranks",
            "Newton",
            "Krylov",
            "messages",
            "kB",
            "µs an unknown",
            "of a set-up: messages",
            "kB",
            "MB a rank",
        ),
        [_row(name, s) for name, of in series.items() for s in of],
        data={
            "series": {name: [asdict(s) for s in of] for name, of in series.items()},
            "halos": {p: asdict(h) for p, h in halos.items()},
            "machine": asdict(machine),
            "start": {"seconds": start, "calls": CALLS},
            "model": _plain(model),
            "prediction": {"unknowns": UNKNOWNS, "ranks": MANY, "seconds": terms, "with remedies": better},
            "direct": {"bytes": asdict(factors), "seconds": asdict(seconds)},
        },
        then=(prediction,),
    )


def _in_parts(bench: Bench, size: int) -> float:
    """Seconds per unknown to read a partitioned mesh and make it ready, on one rank."""
    mesh = bench.partitioned(block(size), parts=8)
    found = bench.must_run("block, partitioned mesh", {**job(size, "iterative"), "mesh": mesh})
    return found.phase("mesh") / found.unknowns


def _surface(model: CostModel, halo: Halo, what: str) -> float:
    size: float = (UNKNOWNS / MANY) ** (2 / 3)
    return model.surface_bytes[what] * halo.surface * size


def _row(series: str, s: Sample) -> tuple[str, ...]:
    seconds = s.seconds["linear solve"] / s.iterations / s.unknowns
    return (
        series,
        f"{s.unknowns}",
        f"{s.ranks}",
        f"{s.newton}",
        f"{s.iterations}",
        f"{s.messages_per_iteration:.0f}",
        f"{s.bytes_per_iteration / 1e3:.0f}",
        f"{seconds * 1e6:.2f}" if s.ranks == 1 else "",  # others may share cores
        f"{s.messages_per_setup:.0f}",
        f"{s.bytes_per_setup / 1e3:.0f}",
        f"{s.memory / 1e6:.0f}",
    )


def _plain(model: CostModel) -> Mapping[str, Any]:
    """The fits as JSON data, without their covariances."""
    lines = {"iterations": model.iterations, "memory": model.memory}
    lines |= {f"exchanges per {what}": line for what, line in model.exchanges.items()}
    lines |= {f"seconds of {phase}": line for phase, line in model.work.items()}
    return {
        **{name: {"a": line.a, "b": line.b} for name, line in lines.items()},
        "bytes per surface": dict(model.surface_bytes),
        "reductions": dict(model.reductions),
        "Newton iterations": model.newton,
        "set-ups": model.setups,
    }
