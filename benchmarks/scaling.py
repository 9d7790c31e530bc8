"""Scaling on paper: what an iteration of the linear solver costs on 1 to 16 ranks, and a model for many more.

Counts of messages, bytes and iterations hold also where ranks share cores; seconds are taken from runs on one rank.
A part of a mesh has ``m = n/p`` unknowns, ``N(p)`` neighbours and a surface ``s(p) m^(2/3)``, of parts that METIS makes
of a cube. Fitted by least squares:

==========================  ==========================================================================================
work per rank               ``a + b m`` seconds of each phase, with a, b ≥ 0
messages                    ``N(p) (a + b ln n)`` with a, b ≥ 0: multigrid has about ``ln n`` levels
bytes                       ``c s(p) m^(2/3)``: coarser levels have a fixed share of the finest one's surface
reductions                  a fixed number of each iteration and set-up, in ``log₂ p`` steps each
iterations                  ``a + b ln n``
==========================  ==========================================================================================

A message takes a latency and its bytes over the bandwidth, a step of a reduction a latency. Not in the model: uneven
parts, contention in the network, waiting on the coarsest levels, where a few ranks work while the others wait.

Command: python benchmarks/scaling.py [--per-rank 2000] [--ranks 1 2 4 8 16]
"""

from __future__ import annotations

import argparse
import csv
import math
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

from bench_runs import WITHOUT_CERTIFICATE, Bench, Findings, JobData
from bodies import block, measure

# isort: split
import hpcinv.base.parallel.runtime  # noqa: F401  (its import order first)

# isort: split
import numpy as np
import yaml
from scipy import sparse
from scipy.optimize import nnls

from hpcinv.mesh.io.gmsh_model import metis

UNKNOWNS, MANY = 100_000_000, 1_000  # what is predicted: so many unknowns on so many ranks
CALLS = 8_000  # of the file system by each rank until it has the job: docs/how-to/start-up.md says how to count them
LATENCY, BANDWIDTH, FILE_OPERATIONS = 2e-6, 1e10, 2e4  # assumed: s, bytes/s of a rank, calls/s of the file system
CELLS = 384  # of a part whose surface is counted
FGMRES_REDUCTIONS = 2  # in an iteration: all inner products at once, and a norm
REDUCTIONS = ("VecDot", "VecMDot", "VecNorm", "VecTDot", "VecReduceComm")  # each is one, which PETSc does not count
WORK = {"tangent": "setups", "residual": "newton", "factorization": "setups", "linear solve": "iterations"}
LOGGED = ("Count", "Num Messages", "Message Length", "Num Reductions")
ONCE = ("set-up", "evaluation", "other")  # phases that each rank does on its part, once


@dataclass(frozen=True)
class Sample:
    """Means over the ranks of one run: messages, bytes and reductions of an iteration, and of a set-up."""

    unknowns: int
    ranks: int
    newton: int
    iterations: int
    setups: int
    messages: tuple[float, float]
    bytes: tuple[float, float]
    reductions: tuple[float, float]
    seconds: Mapping[str, float]
    memory: float  # of the fullest rank


def job(size: int, linear: str) -> JobData:
    return block(size, certificate=WITHOUT_CERTIFICATE, solver={"linear": linear})


def sample(bench: Bench, size: int, ranks: int, linear: str = "iterative") -> Sample:
    log = bench.directory / "events.csv"
    log.unlink(missing_ok=True)
    with environment(PETSC_OPTIONS=f"{os.environ.get('PETSC_OPTIONS', '')} -log_view :{log}:ascii_csv".strip()):
        run = bench.must_run(f"block, about {size} unknowns, {linear}, {ranks} ranks", job(size, linear), ranks)
    events = events_in(log)
    iterations, setups = int(events["PCApply"][0]["Count"]), run.count("factorizations")

    def mean(event: str, figure: str) -> float:
        return float(np.mean([rank[figure] for rank in events.get(event, [{figure: 0.0}])]))

    def call_means(figure: str) -> tuple[float, float]:
        return mean("KSPSolve", figure) / max(iterations, 1), mean("PCSetUp", figure) / setups

    reductions = mean("PCSetUp", "Num Reductions") + sum(mean(event, "Count") for event in REDUCTIONS)
    return Sample(
        run.unknowns,
        ranks,
        run.count("newton_iterations"),
        iterations,
        setups,
        call_means("Num Messages"),
        call_means("Message Length"),
        (FGMRES_REDUCTIONS, (reductions - FGMRES_REDUCTIONS * iterations) / setups),
        run.phases,
        max(run.memory),
    )


@contextmanager
def environment(**variables: str) -> Iterator[None]:
    variables_before = dict(os.environ)
    os.environ.update(variables)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(variables_before)


def events_in(log: Path) -> dict[str, list[dict[str, float]]]:
    """Read the events of PETSc's log (``-log_view :FILE:ascii_csv``) by rank, summed over stages."""
    events: dict[str, dict[int, dict[str, float]]] = {}
    if log.exists():
        with log.open(newline="") as file:
            for row in csv.DictReader(file):
                sums = events.setdefault(row["Event Name"], {}).setdefault(int(row["Rank"]), {})
                for column in LOGGED:
                    sums[column] = sums.get(column, 0.0) + float(row[column])
    return {event: [rank_sums[rank] for rank in sorted(rank_sums)] for event, rank_sums in events.items()}


@cache
def halo(parts: int) -> tuple[float, float]:
    """Neighbours of a part of a cube, and vertices that it shares over the 2/3 power of all of its vertices; means."""
    if parts == 1:
        return 0.0, 0.0
    cells = tetrahedra(round((parts * CELLS / 6) ** (1 / 3)))
    part = metis(cells, "tetrahedron", parts)
    has = sparse.csr_array(
        (np.ones(cells.size, dtype=np.int32), (np.repeat(part, cells.shape[1]), cells.ravel())),
        shape=(parts, int(cells.max()) + 1),
    )
    has.data[:] = 1
    shared = np.asarray(has.sum(axis=0)).ravel() > 1
    surface = (has @ shared.astype(np.int64)) / np.diff(has.indptr) ** (2 / 3)
    return float((np.diff((has @ has.T).tocsr().indptr) - 1).mean()), float(surface.mean())


def tetrahedra(divisions: int) -> np.ndarray:
    """Vertices of the cells of a cube of n × n × n bricks, six around the diagonal of each, (6 n³, 4)."""
    n = divisions + 1
    stride = np.array([1, n, n * n])
    orders = ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0))
    first = np.stack(np.meshgrid(*[np.arange(divisions)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) @ stride
    paths = np.array([np.cumsum([0, *stride[list(order)]]) for order in orders])
    return np.asarray((first[:, None, None] + paths).reshape(-1, 4))


def line(x: Sequence[float], y: Sequence[float]) -> tuple[float, float]:
    """``a, b ≥ 0`` of ``a + b x``, with errors relative to y."""
    known = [(u, v) for u, v in zip(x, y, strict=True) if v > 0]
    if not known:
        return 0.0, 0.0
    (a, b), _ = nnls(np.array([[1 / v, u / v] for u, v in known]), np.ones(len(known)))
    return float(a), float(b)


def power(n: Sequence[float], y: Sequence[float]) -> tuple[float, float]:
    """``a, q`` of ``a n^q``."""
    q, log_a = np.polyfit(np.log(n), np.log(y), 1)
    return math.exp(log_a), float(q)


def predicted(samples: Sequence[Sample], n: float, p: int, start: float) -> tuple[dict[str, float], dict[str, float]]:
    """Seconds by term for n unknowns on p ranks, and further figures: iterations, their error, memory of a rank."""
    alone, apart = [s for s in samples if s.ranks == 1], [s for s in samples if s.ranks > 1]
    m, log_n, (neighbours, surface) = n / p, math.log(n), halo(p)
    newton, setups = (float(np.mean([getattr(s, name) for s in samples])) for name in ("newton", "setups"))
    logs = np.log([s.unknowns for s in samples])
    fit, covariance = np.polyfit(logs, [s.iterations for s in samples], 1, cov=True)
    iterations, there = float(np.polyval(fit, log_n)), np.array([log_n, 1.0])

    def work(phase: str, size: float) -> float:
        attribute = WORK.get(phase)
        seconds = [s.seconds.get(phase, 0.0) / (getattr(s, attribute) if attribute else 1) for s in alone]
        a, b = line([s.unknowns for s in alone], seconds)
        return a + b * size

    terms = {
        "start: imports, files of all ranks from one file system": p * CALLS / FILE_OPERATIONS,
        "start: imports, processor": start,
        "mesh, read and checked by one rank": work("mesh", n),
        "set-up and results": sum(work(phase, m) for phase in ONCE),
        "tangents": setups * work("tangent", m),
        "residuals": newton * work("residual", m),
        "preconditioner, work": setups * work("factorization", m),
        "Krylov, work": iterations * work("linear solve", m),
    }
    figures = {"iterations": iterations, "error of iterations": math.sqrt(there @ covariance @ there)}
    for i, (name, times) in enumerate((("Krylov", iterations), ("preconditioner", setups))):
        neighbour_messages = [s.messages[i] / halo(s.ranks)[0] for s in apart]
        a, b = line([math.log(s.unknowns) for s in apart], neighbour_messages)
        shared = np.array([halo(s.ranks)[1] * (s.unknowns / s.ranks) ** (2 / 3) for s in apart])
        bytes_of_surface = float(shared @ [s.bytes[i] for s in apart] / (shared @ shared))
        steps = float(np.mean([s.reductions[i] for s in samples])) * math.log2(max(p, 2))
        size = bytes_of_surface * surface * m ** (2 / 3)
        terms[f"{name}, messages"] = times * neighbours * (a + b * log_n) * LATENCY
        terms[f"{name}, bytes"] = times * size / BANDWIDTH
        terms[f"{name}, reductions"] = times * steps * LATENCY
    slope, base = np.polyfit([s.unknowns for s in alone], [s.memory for s in alone], 1)
    return terms, figures | {"memory of a rank": float(base + slope * m), "memory of no unknown": float(base)}


def scaling(bench: Bench, options: argparse.Namespace) -> list[Findings]:
    """The block's inverse analysis with the iterative solver, weak and strong series, and the prediction."""
    size, ranks = options.per_rank, sorted({1, 2, *options.ranks})
    series = {
        "weak": [sample(bench, size * p, p) for p in ranks],
        "strong": [sample(bench, size * 8, p) for p in ranks],
        "serial": [sample(bench, size * p, 1) for p in ranks[2:]],
        "direct": [sample(bench, size * p, 1, "direct") for p in ranks],
    }
    samples = [s for name in ("weak", "strong", "serial") for s in series[name]]
    begun = sum(os.times()[2:4])
    subprocess.run([sys.executable, "-c", "import hpcinv.job.job, hpcinv.driver"], check=True)
    terms, figures = predicted(samples, UNKNOWNS, MANY, sum(os.times()[2:4]) - begun)
    parts_file = bench.directory / "block.bp"
    file = bench.directory / "job.yaml"
    file.write_text(yaml.safe_dump(dict(job(size * ranks[-1], "iterative")), sort_keys=False), encoding="utf-8")
    bench.output("hpcinv", "mesh", "partition", file, parts_file, "--parts", 8)
    run = bench.must_run("block in parts", {**job(size, "iterative"), "mesh": {"file": str(parts_file)}})
    better = {name: seconds for name, seconds in terms.items() if "of all ranks" not in name and "by one" not in name}
    better["mesh, in parts"] = run.phases["mesh"] / run.unknowns * UNKNOWNS / MANY
    alone = series["direct"][-3:]  # in small ones the factors are lost in what else takes memory
    n = [s.unknowns for s in alone]
    a, q = power(n, [max(s.memory - figures["memory of no unknown"], 1e6) for s in alone])
    b, r = power(n, [s.seconds["factorization"] / s.setups for s in alone])
    notes = [
        f"{figures['iterations']:.0f} ± {figures['error of iterations']:.0f} iterations (standard error of the fit),"
        f" {figures['memory of a rank'] / 1e6:.0f} MB a rank",
        f"remedies: an image or a copy of the installation on each node; hpcinv mesh partition, once:"
        f" {sum(better.values()):.1f} s",
        f"direct: factors of {a * UNKNOWNS**q / MANY / 1e9:,.0f} GB a rank (n^{q:.2f}), {b * UNKNOWNS**r / MANY:,.0f} s"
        f" for each of them if it were perfectly parallel (n^{r:.2f})",
        f"assumed: latency {LATENCY * 1e6:g} µs, {BANDWIDTH / 1e9:g} GB/s a rank, {FILE_OPERATIONS:g} calls/s of files",
    ]
    every: dict[str, float] = {name: terms.get(name, better.get(name, 0.0)) for name in {**terms, **better}}
    data: dict[str, Any] = {name: [asdict(s) for s in samples_of_series] for name, samples_of_series in series.items()}
    columns = ("unknowns", "ranks", "Newton", "Krylov", "messages", "kB", "µs an unknown", "set-up: messages", "kB")
    return [
        Findings(
            "scaling: block, inverse, iterative solver; means over ranks, of an iteration of the linear solver",
            ("series", *columns, "MB a rank"),
            [_row(name, s) for name, samples_of_series in series.items() for s in samples_of_series],
            data=data,
        ),
        Findings(
            f"prediction: {UNKNOWNS:.0e} unknowns on {MANY} ranks, {sum(terms.values()):.0f} s",
            ("term", "s"),
            [(name, f"{seconds:.3g}") for name, seconds in sorted(every.items(), key=lambda item: -item[1])],
            notes,
            {"seconds": terms, "with remedies": better, **figures},
        ),
    ]


def _row(series: str, s: Sample) -> tuple[str, ...]:
    seconds = s.seconds["linear solve"] / s.iterations / s.unknowns
    return (
        series,
        *(str(count) for count in (s.unknowns, s.ranks, s.newton, s.iterations)),
        f"{s.messages[0]:.0f}",
        f"{s.bytes[0] / 1e3:.0f}",
        f"{seconds * 1e6:.2f}" if s.ranks == 1 else "",  # others may share cores
        f"{s.messages[1]:.0f}",
        f"{s.bytes[1] / 1e3:.0f}",
        f"{s.memory / 1e6:.0f}",
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--per-rank", type=int, default=2_000, help="unknowns of a rank (2000)")
    parser.add_argument("--ranks", type=int, nargs="+", default=[1, 2, 4, 8, 16])
    measure(parser, scaling)
