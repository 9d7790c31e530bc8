"""Bar of a round length in a rendering."""

import math
from collections.abc import Mapping
from typing import Any

from hpcinv.base.quantity.written_units import as_shown

_MOST = 0.2
"""share of the width of a rendering; raised, longer bars"""


def round_length(most: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten up to a length."""
    power = 10.0 ** math.floor(math.log10(most))
    return next(times * power for times in (5.0, 2.0, 1.0) if times * power <= most * (1 + 1e-9))


def draw_bar(axis: Any, pixel: float, size: tuple[int, int], symbols: Mapping[str, str]) -> None:
    """Draw a bar with its length in the lower right corner of a rendering.

    Args:
        axis: of Matplotlib, in pixels.
        pixel: length of a pixel in m.
        size: width and height of the rendering in pixels.
        symbols: of the units in which lengths are shown, by SI unit.
    """
    width, height = size
    length = round_length(_MOST * width * pixel)
    right, bottom = 0.97 * width, 0.97 * height
    axis.plot([right - length / pixel, right], [bottom, bottom], color="black", linewidth=2, solid_capstyle="butt")
    axis.text(
        right - length / pixel / 2, bottom - 0.01 * height, as_shown(length, "m", symbols, 3), ha="center", va="bottom"
    )
