"""What a second rank brings: on the slender body and on the chunky one, as they grow, and to what memory it gets.

The linear solver is the one that hpcinv chooses: the direct one for the beam, the iterative one for the block.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hpcinv.bench.bodies import WITHOUT_CERTIFICATE, beam, block
from hpcinv.bench.report import Findings, ratio
from hpcinv.bench.runs import SOLVER, median
from hpcinv.bench.strategies import sagging_beam

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from hpcinv.bench.bench import Bench
    from hpcinv.bench.bodies import JobData
    from hpcinv.bench.runs import Run

LEAST = 1.8
_PARTS = ("tangent", "factorization", "linear solve")
_SECONDS: Mapping[str, Callable[[Run], float]] = {
    "solver": lambda run: run.solver,
    **{name: lambda run, name=name: run.phase(name) for name in SOLVER},  # type: ignore[misc]
    "whole run": lambda run: run.total,
    "command to prompt": lambda run: run.seconds,
}


def ranks(bench: Bench, *, sizes: Sequence[int], repeat: int) -> Findings:
    """Both bodies of the set in each size, inverse, on 1 and on 2 ranks."""
    bodies: dict[str, JobData] = {}
    for size in sizes:
        sagging, _ = sagging_beam(bench, size)
        bodies[f"beam, {size}"] = beam(size, mesh=sagging, certificate=WITHOUT_CERTIFICATE)
        bodies[f"block, {size}"] = block(size, certificate=WITHOUT_CERTIFICATE)
    jobs = {f"{name}, {count}": (job, count) for name, job in bodies.items() for count in (1, 2)}
    runs = bench.in_turns(jobs, repeat)
    found = {name: {title: median(of, figure) for title, figure in _SECONDS.items()} for name, of in runs.items()}
    rows, notes = [], []
    unknowns, ratios = dict[str, int](), dict[str, dict[str, float | None]]()
    for name in bodies:
        one, two = (found[f"{name}, {count}"] for count in (1, 2))
        ratios[name] = faster = {title: one[title] / two[title] if two[title] > 1e-3 else None for title in one}
        unknowns[name] = runs[f"{name}, 1"][0].unknowns
        body = name.partition(",")[0]
        shown = (faster[title] for title in ("solver", *_PARTS, "whole run", "command to prompt"))
        rows.append(
            (
                f"{body}, {unknowns[name]}",
                f"{one['solver']:.2f}",
                f"{two['solver']:.2f}",
                *("" if value is None else f"{value:.2f}" for value in shown),
            )
        )
        notes.append(ratio(f"{body}, {unknowns[name]} unknowns, solver", faster["solver"] or 0.0, LEAST, digits=2))
    alone, together = (bench.bandwidth(count) for count in (1, 2))
    notes.append(
        f"memory: {alone / 1e9:.1f} GB/s on 1 rank, {together / 1e9:.1f} GB/s on 2: {together / alone:.2f} times"
    )
    return Findings(
        f"ranks: inverse, solver on 1 and 2 ranks (s) and how many times as fast 2 are, medians of {repeat}",
        ("unknowns", "1 rank", "2 ranks", "solver", *_PARTS, "whole run", "command to prompt"),
        rows,
        notes,
        {
            "unknowns": unknowns,
            "repeat": repeat,
            "runs": found,
            "ratios": ratios,
            "least": LEAST,
            "memory": {"1": alone, "2": together},
        },
    )
