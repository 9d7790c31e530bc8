"""What a second rank brings on the inverse beam: in the solver, and over the whole run."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hpcinv.bench.bodies import beam
from hpcinv.bench.report import Findings, ratio
from hpcinv.bench.runs import median
from hpcinv.bench.strategies import SECONDS, sagging_beam

if TYPE_CHECKING:
    from hpcinv.bench.bench import Bench
    from hpcinv.bench.bodies import JobData

LEAST = 1.8


def ranks(bench: Bench, *, size: int, repeat: int) -> Findings:
    """The inverse beam on 1 and on 2 ranks."""
    sagging, unknowns = sagging_beam(bench, size)
    job = beam(size, mesh=sagging)
    jobs: dict[str, tuple[JobData, int]] = {"1 rank": (job, 1), "2 ranks": (job, 2)}
    runs = bench.in_turns(jobs, repeat)
    phases = list(dict.fromkeys(phase for of in runs.values() for phase in of[0].phases))
    found = {
        name: {title: median(of, figure) for title, figure in SECONDS.items()}
        | {phase: median(of, lambda run, phase=phase: run.phase(phase)) for phase in phases}  # type: ignore[misc]
        for name, of in runs.items()
    }
    one, two = found.values()
    ratios = {title: one[title] / two[title] if two[title] > 1e-3 else None for title in one}
    rows = [
        (title, f"{one[title]:.3f}", f"{two[title]:.3f}", "" if (r := ratios[title]) is None else f"{r:.2f}")
        for title in sorted(one, key=lambda title: (title not in SECONDS, -one[title]))
    ]
    return Findings(
        f"ranks: silicone beam, inverse, {unknowns} unknowns, medians of {repeat}",
        ("seconds", *jobs, "times faster"),
        rows,
        [ratio("1 rank / 2 ranks, solver", ratios["solver"] or 0.0, LEAST)],
        {"unknowns": unknowns, "repeat": repeat, "runs": found, "ratios": ratios, "least": LEAST},
    )
