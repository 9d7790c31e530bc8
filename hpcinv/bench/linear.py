"""Direct against iterative linear solver over size, on a chunky and on a slender body: seconds, memory, crossover."""

from __future__ import annotations

import math
import statistics
from itertools import pairwise
from typing import TYPE_CHECKING

from hpcinv.bench.bodies import BODIES, WITHOUT_CERTIFICATE
from hpcinv.bench.report import Findings

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from hpcinv.bench.bench import Bench
    from hpcinv.bench.runs import Run

PRESETS = ("direct", "iterative")


def linear(bench: Bench, *, sizes: Sequence[int], repeat: int) -> Findings:
    """Inverse analyses without certificates, on one rank."""
    rows: list[tuple[str, ...]] = []
    notes: list[str] = []
    data = dict[str, list[dict[str, float | None]]]()
    for name, body in BODIES.items():
        bench.compile(name, body(max(sizes), certificate=WITHOUT_CERTIFICATE, solver={"linear": "iterative"}))
        for size in sizes:
            jobs = {p: body(size, certificate=WITHOUT_CERTIFICATE, solver={"linear": p}) for p in PRESETS}
            runs: dict[str, list[Run]] = {preset: [] for preset in PRESETS}
            for _ in range(repeat):
                for preset, job in jobs.items():
                    bench.note(f"{name}, about {size} unknowns, {preset}")
                    runs[preset].append(bench.run(job, log=True))
            found = figures(runs)
            data.setdefault(name, []).append(found)
            rows.append((name, *_cells(found)))
            notes += [
                f"{name}, about {size} unknowns, {preset}: {run.ending}"
                for preset, of in runs.items()
                for run in of
                if not run.solved
            ]
        for figure in ("seconds", "bytes"):
            notes.append(f"{name}: {_crossing(figure, data[name])}")
    return Findings(
        f"linear: inverse, 1 rank, medians of {repeat}",
        ("body", "unknowns", *(f"{preset} {unit}" for unit in ("s", "MB") for preset in PRESETS), "Krylov / Newton"),
        rows,
        notes,
        {"repeat": repeat, "series": data},
    )


def figures(runs: Mapping[str, Sequence[Run]]) -> dict[str, float | None]:
    """Medians over the runs of each preset; ``None`` where one was not solved."""
    found: dict[str, float | None] = {}
    for preset, of in runs.items():
        solved = [run for run in of if run.solved]
        complete = bool(solved) and len(solved) == len(of)
        found[f"{preset} seconds"] = statistics.median(run.solver for run in solved) if complete else None
        found[f"{preset} bytes"] = statistics.median(run.peak_memory for run in solved) if complete else None
        if solved:
            found["unknowns"] = solved[0].unknowns
            found[f"{preset} Newton iterations"] = solved[0].newton_iterations
            found[f"{preset} Krylov iterations"] = solved[0].krylov_iterations
    return found


def crossover(sizes: Sequence[float], one: Sequence[float], other: Sequence[float]) -> float | None:
    """Size at which ``other`` becomes less than ``one``, interpolated in logarithms; ``None`` if it does nowhere."""
    points = [(math.log(n), math.log(a / b)) for n, a, b in zip(sizes, one, other, strict=True)]
    for (x, f), (y, g) in pairwise(sorted(points)):
        if f <= 0 < g:
            return math.exp(x - f * (y - x) / (g - f))
    return None


def _crossing(figure: str, series: Sequence[Mapping[str, float | None]]) -> str:
    names = ("unknowns", *(f"{preset} {figure}" for preset in PRESETS))
    known = [tuple(entry.get(name) for name in names) for entry in series]
    columns = list(zip(*(entry for entry in known if None not in entry), strict=True))
    if not columns:
        return f"no {figure} to compare"
    sizes, one, other = ([float(v) for v in column if v is not None] for column in columns)
    at = crossover(sizes, one, other)
    if at is not None:
        return f"the iterative solver takes fewer {figure} from {at:,.0f} unknowns on"
    less = "everywhere" if all(b < a for a, b in zip(one, other, strict=True)) else "nowhere"
    return f"the iterative solver takes fewer {figure} {less} between {min(sizes):,.0f} and {max(sizes):,.0f} unknowns"


def _cells(found: Mapping[str, float | None]) -> list[str]:
    def shown(name: str, unit: float, digits: int) -> str:
        value = found.get(name)
        return "-" if value is None else f"{value / unit:.{digits}f}"

    iterations = f"{shown('iterative Krylov iterations', 1, 0)} / {shown('iterative Newton iterations', 1, 0)}"
    return [
        shown("unknowns", 1, 0),
        *(shown(f"{preset} seconds", 1, 2) for preset in PRESETS),
        *(shown(f"{preset} bytes", 1e6, 0) for preset in PRESETS),
        iterations,
    ]
