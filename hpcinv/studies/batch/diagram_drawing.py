"""Drawing of the diagrams of studies and sweeps: lines or points over one parameter, maps over two.

Failed cases are red.
"""

import math
import textwrap
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from hpcinv.base.quantity.arrays import Floats
from hpcinv.pages.pictures.figures import style

RED = "#C00000"
GREEN = "#009E73"
_CROSS: dict[str, Any] = {"linestyle": "none", "marker": "x", "markersize": 6, "markeredgewidth": 1.5}
_DIAGNOSES = (RED, "#E69F00", "#CC79A7", "#000000")


@dataclass(frozen=True)
class Scale:
    """Scale of an axis or of the colours of a map; text values are at 0, 1, …, with their texts as ``ticks``."""

    label: str
    is_log: bool = False
    ticks: Sequence[str] = ()


@dataclass(frozen=True)
class DiagramSeries:
    """Finished cases of one line or one map.

    Attributes:
        colour: number of its style; lines that differ only in a number may share one.
        values: of each case, NaN if it has none.
        statuses: "converged", or the diagnosis of each case.
        is_curve: whether the points are joined.
    """

    label: str
    colour: int
    places: Sequence[tuple[float, ...]]
    values: Sequence[float]
    statuses: Sequence[str]
    is_curve: bool

    def points(self, *, converged: bool) -> tuple[list[tuple[float, ...]], list[float]]:
        """Return places and values of the converged cases that have a value, or of the failed cases."""
        rows = zip(self.places, self.values, self.statuses, strict=True)
        kept = [(p, v) for p, v, s in rows if (s == "converged") == converged and not (converged and math.isnan(v))]
        return [p for p, _ in kept], [v for _, v in kept]


def draw_lines(axes: Axes, title: str, series: Sequence[DiagramSeries], x: Scale, value: Scale) -> None:
    """Draw the value over one parameter, with a line or points for each series; series of one label have one entry."""
    labelled: set[str] = set()
    crosses: list[float] = []
    for i, s in enumerate(series):
        colour, marker, dashes = style(s.colour)
        places, values = s.points(converged=True)
        ordered = sorted(zip((p[0] for p in places), values, strict=True))
        axes.plot(
            [p for p, _ in ordered],
            [v for _, v in ordered],
            linestyle=dashes if s.is_curve else "none",
            marker=marker,
            markersize=4,
            linewidth=1.2,
            color=colour,
            label=None if s.label in labelled else s.label,
            gid=f"series-{i}",
        )
        labelled.add(s.label)
        crosses += [p[0] for p in s.points(converged=False)[0]]
    if crosses:  # they have a place, but no value: draw them at the bottom
        bottom = axes.get_xaxis_transform()
        label = f"failed ({len(crosses)})"
        axes.plot(crosses, [0.02] * len(crosses), transform=bottom, color=RED, label=label, gid="failed", **_CROSS)
    _finish(axes, title, x, value)


def draw_maps(
    figure: Figure, title: str, series: Sequence[DiagramSeries], scales: tuple[Scale, Scale], value: Scale
) -> None:
    """Draw the value as colours over two parameters, with a map for each series."""
    every = [v for s in series for v in s.points(converged=True)[1]]
    low, high = min(every, default=0.0), max(every, default=1.0)
    norm = LogNorm(low, high) if value.is_log else Normalize(low, high)
    image: Any = None
    panels = _panels(figure, title, series, scales)
    for i, (s, axes) in enumerate(zip(series, panels, strict=True)):
        image = _coloured(axes, s, scales, norm, gid=f"series-{i}") or image
        if crosses := s.points(converged=False)[0]:
            axes.plot(*zip(*crosses, strict=True), color=RED, gid=f"failed-{i}", **_CROSS)
    if image is not None:
        figure.colorbar(image, ax=panels, label=value.label)
    if failed := sum(len(s.points(converged=False)[0]) for s in series):
        _legend(figure, [Line2D([], [], color=RED, label=f"failed ({failed})", **_CROSS)])


def draw_outcomes(figure: Figure, title: str, series: Sequence[DiagramSeries], scales: tuple[Scale, Scale]) -> None:
    """Draw the outcomes of cases, converged or their diagnosis, over two parameters."""
    counts = Counter(status for s in series for status in s.statuses)
    diagnoses = [status for status, _ in counts.most_common() if status != "converged"]
    panels = _panels(figure, title, series, scales)
    handles = []
    for i, status in enumerate(["converged", *diagnoses]):
        look: dict[str, Any] = {"linestyle": "none", "color": GREEN, "marker": ".", "markersize": 4, "alpha": 0.6}
        if i > 0:  # red and contrasting colours, with another marker for each
            look = _CROSS | {
                "color": _DIAGNOSES[(i - 1) % 4],
                "marker": "xs^Dv"[(i - 1) % 5],
                "markerfacecolor": "none",
            }
        for s, axes in zip(series, panels, strict=True):
            shown = [place for place, case_status in zip(s.places, s.statuses, strict=True) if case_status == status]
            if shown:
                axes.plot(*zip(*shown, strict=True), gid=f"outcome-{i}", **look)
        handles.append(Line2D([], [], label=f"{status} ({counts[status]})", **look))
    _legend(figure, handles)


def _legend(figure: Figure, handles: Sequence[Line2D]) -> None:
    """Add a legend below all panels, with lines as long as the figure is wide."""
    characters = int(15 * figure.get_figwidth())
    labels = [textwrap.fill(str(handle.get_label()), characters) for handle in handles]
    figure.legend(handles, labels, loc="outside lower left", frameon=False, fontsize=7)


def _panels(figure: Figure, title: str, series: Sequence[DiagramSeries], scales: tuple[Scale, Scale]) -> list[Axes]:
    """Return axes for each series, three in a row, under its label."""
    columns = min(len(series), 3)
    grid = figure.subplots(math.ceil(len(series) / columns), columns, squeeze=False, sharex=True, sharey=True)
    for axes in grid.flat[len(series) :]:
        axes.set_visible(False)
    panels = list(grid.flat[: len(series)])
    for s, axes in zip(series, panels, strict=True):
        _finish(axes, s.label or title, *scales)
        if not scales[0].ticks and not scales[0].is_log:
            axes.locator_params(axis="x", nbins=5)  # more ticks would overlap in a panel
    if any(s.label for s in series):
        figure.suptitle(title, x=0.01, ha="left", fontsize=10)
    return panels


def _coloured(axes: Axes, s: DiagramSeries, scales: tuple[Scale, Scale], norm: Normalize, *, gid: str) -> Any:
    """Draw cells if the places are a grid, else points; return them, or ``None`` without places."""
    places, values = s.points(converged=True)
    if not places:
        return None
    every = dict.fromkeys(s.places, math.nan)
    x, y = (np.unique([place[i] for place in every]) for i in (0, 1))
    if min(len(x), len(y)) > 1 and len(s.places) == len(every) == len(x) * len(y):
        place_values = every | dict(zip(places, values, strict=True))
        cells = [[place_values[a, b] for a in x] for b in y]
        return axes.pcolormesh(_edges(x, scales[0]), _edges(y, scales[1]), cells, norm=norm, gid=gid)
    abscissas, ordinates = zip(*places, strict=True)
    return axes.scatter(abscissas, ordinates, c=values, norm=norm, s=16, gid=gid)


def _edges(values: Floats, scale: Scale) -> Floats:
    """Return the edges of cells: the midpoints between neighbours on the scale, and one beyond each end."""
    positions = np.log(values) if scale.is_log else values
    middle = (positions[1:] + positions[:-1]) / 2
    edges = np.concatenate([[2 * positions[0] - middle[0]], middle, [2 * positions[-1] - middle[-1]]])
    return np.exp(edges) if scale.is_log else edges


def _finish(axes: Axes, title: str, x: Scale, y: Scale) -> None:
    for scale, axis in ((x, axes.xaxis), (y, axes.yaxis)):
        if scale.ticks:
            axis.set_ticks(range(len(scale.ticks)), labels=list(scale.ticks))
    axes.set(xlabel=x.label, ylabel=y.label)
    if x.is_log:
        axes.set_xscale("log")
    if y.is_log:
        axes.set_yscale("log")
    axes.set_title(title, fontsize=9)
    axes.label_outer()
