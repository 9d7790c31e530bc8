"""The diagram of the scaling model: what was counted beside what was fitted to it, and what it predicts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpcinv.batch.diagram import COLOURS, MARKERS, new_figure

if TYPE_CHECKING:
    from hpcinv.bench.costmodel import CostModel, Machine, Start
    from hpcinv.bench.halo import Halo
    from hpcinv.bench.samples import Sample

_PREDICTED = (1e6, 1e7, 1e8, 1e9)
_LEAST = 1_000  # unknowns per rank below which nobody would go


def draw(
    path: Path,
    series: Mapping[str, Sequence[Sample]],
    model: CostModel,
    halos: Mapping[int, Halo],
    machine: Machine,
    start: Start,
) -> None:
    """Write it; the format is that of the ending.

    Args:
        halos: of the ranks of the series, and of the largest number of ranks, which stands for more.
        start: what the prediction has of the start of a run.
    """
    from matplotlib.ticker import NullFormatter

    with new_figure(9.0, 3.2) as figure:
        of_messages, of_iterations, of_seconds = figure.subplots(1, 3)
        counted = [(name, s) for name in ("weak", "strong") for s in series[name] if s.ranks > 1]
        for i, name in enumerate(("weak", "strong")):
            mine = [s for n, s in counted if n == name]
            style: Any = {"color": COLOURS[i], "marker": MARKERS[i], "linestyle": "none", "label": f"{name}, counted"}
            of_messages.plot([s.ranks for s in mine], [s.messages_per_iteration for s in mine], **style)
            fitted = [halos[s.ranks].neighbours * model.exchanges["iteration"].at(math.log(s.unknowns)) for s in mine]
            of_messages.plot([s.ranks for s in mine], fitted, color=COLOURS[i], linewidth=1.0, label=f"{name}, fitted")
            every = series[name]
            of_iterations.plot([s.unknowns for s in every], [s.iterations for s in every], **style)
        of_messages.set(xlabel="ranks", ylabel="messages of a rank in an iteration")
        of_messages.set_ylim(bottom=0.0)
        sizes = sorted({s.unknowns for of in series.values() for s in of})
        of_iterations.plot(sizes, [model.iterations.at(math.log(n)) for n in sizes], color="0.4", label="fitted")
        of_iterations.set(
            xscale="log", xlabel="unknowns", ylabel="iterations of the linear solver, in all", ylim=(0, None)
        )
        of_iterations.xaxis.set_minor_formatter(NullFormatter())  # less than a decade has no room for them
        far = halos[max(halos)]
        for i, n in enumerate(_PREDICTED):
            ranks = [2**k for k in range(5, 20) if n / 2**k >= _LEAST]
            seconds = [_solve(model.terms(n, p, far, machine, start)) for p in ranks]
            of_seconds.plot(ranks, seconds, color=COLOURS[i], label=f"{n:.0e} unknowns")
        of_seconds.set(xscale="log", yscale="log", xlabel="ranks", ylabel="s for the solve, predicted")
        for axes in (of_messages, of_iterations, of_seconds):
            axes.grid(which="major", color="0.92", linewidth=0.6)
            axes.legend(frameon=False, fontsize=7)
        figure.savefig(path, dpi=200)


def _solve(terms: Mapping[str, float]) -> float:
    """Without start and mesh."""
    return sum(seconds for name, seconds in terms.items() if not name.startswith(("start", "mesh")))
