"""Microseconds per unknown in each phase of a run on one rank, and the share outside of kernels, PETSc and MPI."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hpcinv.bench.bodies import beam, block
from hpcinv.bench.report import Findings
from hpcinv.bench.runs import SOLVER, median
from hpcinv.bench.strategies import sagging_beam

if TYPE_CHECKING:
    from hpcinv.bench.bench import Bench
    from hpcinv.bench.bodies import JobData

MOST = 0.05
"""Share outside of kernels, PETSc and MPI that is allowed, of `AT_LEAST` unknowns and more."""
AT_LEAST = 40_000


def phases(bench: Bench, *, size: int, repeat: int) -> Findings:
    """Both bodies of the set, inverse; the mesh of the beam is read, that of the block is made."""
    sagging, _ = sagging_beam(bench, size)
    jobs: dict[str, tuple[JobData, int]] = {"beam": (beam(size, mesh=sagging), 1), "block": (block(size), 1)}
    runs = bench.in_turns(jobs, repeat)
    order = dict.fromkeys(("mesh", "set-up", *SOLVER, "certificate"))
    names = list(order | dict.fromkeys(phase for of in runs.values() for phase in of[0].phases if phase != "compile"))
    unknowns = {name: of[0].unknowns for name, of in runs.items()}
    found = {
        name: {phase: median(of, lambda run, phase=phase: run.phase(phase)) for phase in names}  # type: ignore[misc]
        for name, of in runs.items()
    }
    outside = {name: median(of, lambda run: run.outside) for name, of in runs.items()}
    before = {name: median(of, lambda run: run.outside_before_certificate) for name, of in runs.items()}
    rows = [
        (phase, *(f"{1e6 * found[name][phase] / unknowns[name]:.2f}" for name in runs))
        for phase in names
        if any(found[name][phase] >= 1e-4 for name in runs)
    ]
    rows.append(("outside of kernels, PETSc and MPI", *(f"{share:.1%}" for share in outside.values())))
    rows.append(("the same before the certificate", *(f"{share:.1%}" for share in before.values())))
    notes = [
        f"{name}: {share:.1%} outside (at most {MOST:.0%}: {'met' if share <= MOST else 'MISSED'})"
        for name, share in outside.items()
        if unknowns[name] >= AT_LEAST
    ]
    return Findings(
        f"phases: inverse, 1 rank, medians of {repeat}",
        ("µs per unknown", *(f"{name}, {number} unknowns" for name, number in unknowns.items())),
        rows,
        notes,
        {
            "unknowns": unknowns,
            "repeat": repeat,
            "seconds": found,
            "outside": outside,
            "outside before certificate": before,
            "most": MOST,
        },
    )
