"""What the default strategy saves on the silicone beam: against the paper's own, both ways.

The paper's strategy is 10 equal load steps with full Newton steps, each until the residual is below 1e-10 N or 1e-9 of
the step's first, as in the authors' code (Mazier et al. 2022, doi:10.1007/s00366-021-01597-z).
"""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING, Any

from hpcinv.bench.bodies import WITHOUT_CERTIFICATE, beam
from hpcinv.bench.report import Findings, ratio
from hpcinv.bench.runs import Run, median

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from hpcinv.bench.bench import Bench
    from hpcinv.bench.bodies import JobData

NEWTON = 2.0**19 * 0.125**2  # N in one scaled unit of the residual: stress times length squared
PAPER = {
    "strategy": "fixed",
    "steps": 10,
    "reuse_tangent": False,
    "petsc": {
        "snes_convergence_test": "default",
        "snes_rtol": 1e-9,
        "snes_atol": 1e-10 / NEWTON,
        "snes_stol": 0.0,
        "snes_max_it": 50,
    },
}
LEAST = {"inverse": 6.0, "forward": 2.5}
"""Times by which the default must be faster, in the solver."""

SECONDS: Mapping[str, Callable[[Run], float]] = {
    "solver": lambda run: run.solver,
    "run without certificate": lambda run: run.total - run.phase("certificate"),
    "whole run": lambda run: run.total,
    "command to prompt": lambda run: run.seconds,
}
FIGURES: Mapping[str, Callable[[Run], float]] = {
    "factorizations": lambda run: run.factorizations,
    **SECONDS,
    "outside, solver": lambda run: run.outside_in_solver,
    "outside, whole run": lambda run: run.outside,
}


def strategies(bench: Bench, *, size: int, repeat: int, line_searches: Sequence[str] = ()) -> Findings:
    """Inverse and forward analysis of the beam by both strategies, and by the default with PETSc's line searches."""
    solvers: dict[str, Mapping[str, Any]] = {"default": {}, "paper": PAPER}
    solvers |= {name: {"petsc": {"snes_linesearch_type": name}} for name in line_searches}
    sagging, unknowns = sagging_beam(bench, size)
    jobs: dict[str, tuple[JobData, int]] = {}
    for analysis in LEAST:
        for name, solver in solvers.items():
            mesh = {"mesh": sagging} if analysis == "inverse" else {}
            jobs[f"{analysis}, {name}"] = beam(size, analysis=analysis, solver=solver, **mesh), 1
    runs = bench.in_turns(jobs, repeat)
    found = {name: {title: median(of, figure) for title, figure in FIGURES.items()} for name, of in runs.items()}
    ratios = {
        analysis: {
            title: found[f"{analysis}, paper"][title] / found[f"{analysis}, default"][title]
            for title in ("factorizations", *SECONDS)
        }
        for analysis in LEAST
    }
    return Findings(
        f"strategies: silicone beam, {unknowns} unknowns, 1 rank, medians of {repeat}",
        ("seconds", *FIGURES),
        [(name, *_cells(figures)) for name, figures in found.items()],
        [
            text
            for analysis, least in LEAST.items()
            for text in (
                ratio(f"{analysis}, paper / default, solver", ratios[analysis]["solver"], least),
                *(
                    f"{analysis}, paper / default, {name}: {ratios[analysis][name]:.1f} times"
                    for name in list(SECONDS)[1:]
                ),
            )
        ],
        {"unknowns": unknowns, "repeat": repeat, "runs": found, "ratios": ratios, "least": LEAST},
    )


def sagging_beam(bench: Bench, size: int) -> tuple[dict[str, Any], int]:
    """The mesh of the beam's loaded shape, for inverse analyses, and the number of unknowns."""
    output = {"fields": False, "mesh": ["msh"]}
    loaded = beam(size, analysis="forward", output=output, certificate=WITHOUT_CERTIFICATE)
    first = bench.must_run("the sagging beam", loaded)
    kept = bench.directory / f"sagging-{size}.msh"
    shutil.copyfile(bench.results() / "shape.msh", kept)
    return {"file": str(kept)}, first.unknowns


def _cells(figures: Mapping[str, float]) -> list[str]:
    return [
        f"{figures['factorizations']:.0f}",
        *(f"{figures[name]:.2f}" for name in SECONDS),
        *(f"{figures[name]:.1%}" for name in ("outside, solver", "outside, whole run")),
    ]
