"""Charts of Newton's method as SVG in the colours of the page."""

import io
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from html import escape
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from hpcinv.pages.pictures.figures import new_figure

# Colours that stand for the page's, which are light or dark.
_INK, _LINES, _FIRST, _SECOND = "#010001", "#010002", "#010003", "#010004"
_OF_PAGE = {_INK: "var(--soft)", _LINES: "var(--line)", _FIRST: "var(--c0)", _SECOND: "var(--c1)"}
_LOOK = {"text.color": _INK, "axes.labelcolor": _INK, "xtick.color": _INK, "ytick.color": _INK}
_LOOK |= {"axes.edgecolor": _LINES, "grid.color": _LINES}


def convergence_chart(solves: Sequence[Mapping[str, Any]], title: str) -> str:
    """Return a chart of corrections, relative to the state, and residuals after each iteration, a line for each solve.

    A new tangent is marked by a full circle, a kept one by an empty one. The text is empty without positive norms.

    Args:
        title: for readers of the page who do not see it.
    """
    iterations = [iteration for solve in solves for iteration in solve["iterations"]]
    corrections = np.array([_ratio(iteration["correction"], iteration["state"]) for iteration in iterations])
    residuals = np.array([_ratio(iteration["residual"], 1.0) for iteration in iterations])
    if not np.isfinite([corrections, residuals]).any():
        return ""
    numbers = np.arange(1, len(iterations) + 1)
    is_new = np.array([iteration["new_tangent"] for iteration in iterations])
    ends = np.cumsum([len(solve["iterations"]) for solve in solves])[:-1]
    with _axes(3.0, "iteration", "norm") as axes:
        curves = {"relative correction": (corrections, _FIRST), "residual (scaled)": (residuals, _SECOND)}
        for name, (norms, colour) in curves.items():
            for x, y in zip(np.split(numbers, ends), np.split(norms, ends), strict=True):
                axes.plot(x, y, color=colour)
            for chosen, face in ((is_new, colour), (~is_new, "none")):
                axes.plot(numbers[chosen], norms[chosen], "o", color=colour, markerfacecolor=face)
            axes.plot([], [], "o-", color=colour, label=name)
        axes.set_yscale("log")
        axes.legend()
        return _svg(axes, title)


def load_chart(solves: Sequence[Mapping[str, Any]], title: str) -> str:
    """Return a chart of the load factor of each solve; no text for one solve."""
    if len(solves) < 2:
        return ""
    with _axes(2.0, "solve", "load factor") as axes:
        axes.plot(range(1, len(solves) + 1), [solve["load"] for solve in solves], "o-", color=_FIRST)
        return _svg(axes, title)


def _ratio(value: float | None, whole: float | None) -> float:
    """Return a ratio on a logarithmic scale, NaN if it has no place there."""
    return value / whole if value and whole else np.nan


@contextmanager
def _axes(height: float, xlabel: str, upward: str) -> Iterator[Axes]:
    with new_figure(8.0, height, _LOOK | {"lines.markersize": 4, "lines.linewidth": 1.2}) as figure:
        axes = figure.subplots()
        axes.set(xlabel=xlabel, ylabel=upward)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        yield axes


def _svg(axes: Axes, title: str) -> str:
    """Return the figure of axes as an element of the page."""
    figure, content = axes.get_figure(root=True), io.StringIO()
    assert figure is not None
    nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    figure.savefig(content, format="svg", transparent=True, metadata=nothing)
    text = re.sub(r"<style.*?</style>", "", content.getvalue(), flags=re.DOTALL)  # it would hold for the whole page
    for stand_in, colour in _OF_PAGE.items():
        text = text.replace(stand_in, colour)
    name = f'class="chart" role="img" aria-label="{escape(title)}"'
    return re.sub(
        r'.*?<svg .*?(viewBox="[^"]*").*?>', lambda head: f"<svg {name} {head[1]}>", text, count=1, flags=re.DOTALL
    )
