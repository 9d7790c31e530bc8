"""Figures of diagrams: one look, as PNG and SVG.

Colours are distinguishable for colour-blind readers (Okabe & Ito, 2008); in black and white series differ by markers
and dashes.
"""

import io
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
# dotted lines are for estimates
DASHES: tuple[Any, ...] = ("-", "--", "-.", (0, (5, 1, 1, 1, 1, 1)), (0, (10, 2, 3, 2)), (0, (8, 2)), (0, (2, 1)))
STYLE: Any = {
    "svg.fonttype": "none",  # text stays text
    "svg.hashsalt": "hpcinv",  # the same diagram is the same file
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "0.92",
    "grid.linewidth": 0.6,
    "axes.titlelocation": "left",
    "axes.titlesize": 10,
    "legend.frameon": False,
    "legend.fontsize": 8,
}
FORMATS = ("png", "svg")


def style(number: int) -> tuple[str, str, Any]:
    """Return colour, marker and dashes of a series; after the last colour the combinations differ."""
    turn, i = divmod(number, len(COLOURS))
    return COLOURS[i], MARKERS[(i + turn) % len(MARKERS)], DASHES[(i + turn) % len(DASHES)]


@contextmanager
def new_figure(width: float, height: float, other: Mapping[str, Any] | None = None) -> Iterator[Figure]:
    """Yield a figure of a size in inches; the common style, with what is ``other``, holds within the context."""
    with mpl.rc_context(STYLE | dict(other or {})):
        yield Figure(figsize=(width, height), layout="constrained")


def as_files(figure: Figure) -> dict[str, bytes]:
    """Return the contents of a figure's files by format."""
    files = {}
    for form in FORMATS:
        content = io.BytesIO()
        figure.savefig(content, format=form, dpi=200, metadata={"Date": None} if form == "svg" else None)
        files[form] = content.getvalue()
    return files
