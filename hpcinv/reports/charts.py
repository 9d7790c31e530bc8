"""Line charts as SVG in the colours of the page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape

from matplotlib.ticker import MaxNLocator

_LEFT, _RIGHT, _TOP, _BOTTOM = 62.0, 12.0, 10.0, 40.0


@dataclass(frozen=True)
class Curve:
    """Points (x, y) joined by lines; ``name`` goes into the legend, ``label`` of a point into its tooltip."""

    name: str
    points: Sequence[tuple[float, float]]
    labels: Sequence[str] = field(default_factory=tuple)
    breaks: frozenset[int] = frozenset()


def chart(
    curves: Sequence[Curve],
    title: str,
    across: str,
    upward: str,
    *,
    log_y: bool = False,
    size: tuple[int, int] = (640, 300),
) -> str:
    """Return a chart of curves; on a logarithmic axis values that are not positive are left out.

    Args:
        title: for readers of the page who do not see it.
        across, upward: names of the axes.
    """
    width, height = size
    kept = [_shown(curve, log=log_y) for curve in curves]
    every = [point for curve in kept for point in curve.points]
    if not every:
        return ""
    x, y = _Axis([p[0] for p in every], log=False), _Axis([p[1] for p in every], log=log_y)

    def at(point: tuple[float, float]) -> tuple[float, float]:
        px = _LEFT + x.share(point[0]) * (width - _LEFT - _RIGHT)
        py = height - _BOTTOM - y.share(point[1]) * (height - _TOP - _BOTTOM)
        return px, py

    parts = [f'<svg class="chart" viewBox="0 0 {width} {height}" role="img" aria-label="{escape(title)}">']
    for tick in y.ticks:
        _, py = at((every[0][0], tick))
        parts.append(f'<line class="grid" x1="{_LEFT}" x2="{width - _RIGHT}" y1="{py:.1f}" y2="{py:.1f}"/>')
        parts.append(f'<text x="{_LEFT - 6}" y="{py + 4:.1f}" text-anchor="end">{_number(tick)}</text>')
    for tick in x.ticks:
        px, _ = at((tick, every[0][1]))
        parts.append(f'<text x="{px:.1f}" y="{height - _BOTTOM + 16}" text-anchor="middle">{_number(tick)}</text>')
    parts.append(f'<text x="{(width + _LEFT) / 2}" y="{height - 6}" text-anchor="middle">{escape(across)}</text>')
    middle = (height - _BOTTOM + _TOP) / 2
    parts.append(f'<text transform="translate(12 {middle}) rotate(-90)" text-anchor="middle">{escape(upward)}</text>')
    for number, curve in enumerate(kept):
        places = [at(point) for point in curve.points]
        path = "".join(
            f"{'M' if i == 0 or i in curve.breaks else 'L'}{px:.1f} {py:.1f}" for i, (px, py) in enumerate(places)
        )
        parts.append(f'<path class="curve c{number % 8}" d="{path}"/>')
        for i, (px, py) in enumerate(places):
            label = curve.labels[i] if curve.labels else f"{curve.name}: {_number(curve.points[i][1])}"
            title_of_point = f"<title>{escape(label)}</title>"
            parts.append(f'<circle class="c{number % 8}" cx="{px:.1f}" cy="{py:.1f}" r="2.6">{title_of_point}</circle>')
    parts.append("</svg>")
    if len(kept) > 1:
        names = "".join(f'<li><span class="mark c{i % 8}"></span>{escape(c.name)}</li>' for i, c in enumerate(kept))
        parts.append(f'<ul class="legend">{names}</ul>')
    return "".join(parts)


def _shown(curve: Curve, *, log: bool) -> Curve:
    rows = [i for i, (_, py) in enumerate(curve.points) if math.isfinite(py) and (py > 0 or not log)]
    labels = [curve.labels[i] for i in rows] if curve.labels else ()
    breaks = frozenset(new for new, old in enumerate(rows) if old in curve.breaks)
    return Curve(curve.name, [curve.points[i] for i in rows], labels, breaks)


class _Axis:
    """An axis from the least to the largest value, with some rounding outwards."""

    def __init__(self, values: Sequence[float], *, log: bool) -> None:
        self._scaled = math.log10 if log else float
        low, high = self._scaled(min(values)), self._scaled(max(values))
        if log:
            low, high = math.floor(low), math.ceil(high)
            high += low == high
            self.ticks = [10.0**k for k in range(low, high + 1, math.ceil((high - low) / 6))]
        else:
            high = high if high > low else low + (abs(low) or 1.0)
            self.ticks = list(MaxNLocator(6, steps=[1, 2, 5, 10]).tick_values(low, high))
            low, high = self.ticks[0], self.ticks[-1]
        self._low, self._high = low, high

    def share(self, value: float) -> float:
        return (self._scaled(value) - self._low) / (self._high - self._low)


def _number(value: float) -> str:
    return f"{value:.6g}" if value == 0 or 1e-3 <= abs(value) < 1e5 else f"{value:.2g}"
