"""What all diagrams have in common: sizes, colours, markers, and the formats that they are written in."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

# Told apart by colour-blind readers (Okabe & Ito, 2008), and in black and white by markers and dashes.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
DASHES: tuple[Any, ...] = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (8, 2)), (0, (2, 1)))
STYLE: Any = {
    "svg.fonttype": "none",  # text stays text
    "svg.hashsalt": "hpcinv",  # the same diagram is the same file
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
}
FORMATS = ("png", "svg")


def style(number: int) -> tuple[str, str, Any]:
    """Colour, marker and dashes; where they begin again they do so in other combinations."""
    turn, i = divmod(number, len(COLOURS))
    return COLOURS[i], MARKERS[(i + turn) % len(MARKERS)], DASHES[(i + turn) % len(DASHES)]


@contextmanager
def new_figure(width: float, height: float) -> Iterator[Figure]:
    """A figure of a size in inches, in the style of all diagrams for as long as the context lasts."""
    with mpl.rc_context(STYLE):
        yield Figure(figsize=(width, height), layout="constrained")


def as_files(figure: Figure) -> dict[str, bytes]:
    """A figure as the contents of files by their format."""
    files = {}
    for form in FORMATS:
        content = io.BytesIO()
        figure.savefig(content, format=form, dpi=200, metadata={"Date": None} if form == "svg" else None)
        files[form] = content.getvalue()
    return files
