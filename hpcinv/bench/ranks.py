"""What a second rank brings, in the solver and over the whole run: on the slender body and on the chunky one.

The linear solver is the one that hpcinv chooses: the direct one for the beam, the iterative one for the block.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hpcinv.bench.bodies import WITHOUT_CERTIFICATE, beam, block
from hpcinv.bench.report import Findings, ratio
from hpcinv.bench.runs import median
from hpcinv.bench.strategies import SECONDS, sagging_beam

if TYPE_CHECKING:
    from hpcinv.bench.bench import Bench
    from hpcinv.bench.bodies import JobData

LEAST = 1.8


def ranks(bench: Bench, *, size: int, repeat: int) -> Findings:
    """Both bodies of the set, inverse, on 1 and on 2 ranks."""
    sagging, _ = sagging_beam(bench, size)
    bodies = {
        "beam": beam(size, mesh=sagging, certificate=WITHOUT_CERTIFICATE),
        "block": block(size, certificate=WITHOUT_CERTIFICATE),
    }
    jobs: dict[str, tuple[JobData, int]] = {
        f"{name}, {count}": (job, count) for name, job in bodies.items() for count in (1, 2)
    }
    runs = bench.in_turns(jobs, repeat)
    titles = [title for title in SECONDS if title != "run without certificate"]  # there is none
    phases = list(dict.fromkeys(phase for of in runs.values() for run in of for phase in run.phases))
    found = {
        name: {title: median(of, SECONDS[title]) for title in titles}
        | {phase: median(of, lambda run, phase=phase: run.phase(phase)) for phase in phases}  # type: ignore[misc]
        for name, of in runs.items()
    }
    ratios = {
        name: {title: _ratio(found[f"{name}, 1"][title], found[f"{name}, 2"][title]) for title in (*titles, *phases)}
        for name in bodies
    }
    rows = []
    for title in (*titles, *sorted(phases, key=lambda phase: -found["beam, 1"][phase])):
        row = [title]
        for name in bodies:
            faster = ratios[name][title]
            row += [f"{found[f'{name}, {count}'][title]:.3f}" for count in (1, 2)]
            row.append("" if faster is None else f"{faster:.2f}")
        rows.append(row)
    unknowns = {name: runs[f"{name}, 1"][0].unknowns for name in bodies}
    return Findings(
        f"ranks: inverse, {', '.join(f'{name} {number}' for name, number in unknowns.items())} unknowns, "
        f"medians of {repeat}",
        ("seconds on ranks", *(title for name in bodies for title in (f"{name}, 1", f"{name}, 2", "ratio"))),
        rows,
        [ratio(f"{name}, 1 rank / 2 ranks, solver", ratios[name]["solver"] or 0.0, LEAST) for name in bodies],
        {"unknowns": unknowns, "repeat": repeat, "runs": found, "ratios": ratios, "least": LEAST},
    )


def _ratio(one: float, two: float) -> float | None:
    return one / two if two > 1e-3 else None
