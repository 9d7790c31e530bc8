"""``*ORIENTATION`` of Abaqus and CalculiX: axes of a material. Source: *Abaqus Keywords Guide*, ``*ORIENTATION``."""

from __future__ import annotations

from math import radians

import numpy as np

from hpcinv.base.quantity.arrays import Floats
from hpcinv.base.reading.abaqus_keywords import Keyword
from hpcinv.base.reading.coordinate_frames import frame_of, rotation
from hpcinv.formats.cards.card import CardError, number
from hpcinv.formats.cards.deck import Axes, Vector

GLOBAL = Axes(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))


def axes_of(keyword: Keyword) -> Axes:
    """Return the axes; without a frame if they vary over the body.

    Raises:
        CardError: it is damaged.
    """
    parameters = keyword.options
    place = f"*ORIENTATION {parameters.get('NAME', '')}"
    system = " ".join(parameters.get("SYSTEM", "RECTANGULAR").upper().split())
    kind = parameters.get("DEFINITION", "COORDINATES").upper()
    if system not in ("R", "RECTANGULAR") or kind != "COORDINATES" or not keyword.lines:
        return Axes()
    try:
        rows = [[number(entry or "0", place) for entry in line] for line in keyword.lines]
    except CardError:  # the name of a *DISTRIBUTION
        return Axes()
    first, second, origin = np.array([*rows[0], *[0.0] * 9][:9]).reshape(3, 3)
    frame = frame_at(first - origin, second - origin, place)
    turned, *fibres = rows[1:] or [[]]
    if len(turned) > 1 and turned[0] in (1, 2, 3):  # about an axis, by degrees
        frame = frame @ rotation(frame[int(turned[0]) - 1], radians(turned[1])).T
    directions = [np.array([*entries, 0.0, 0.0][:3]) @ frame for entries in fibres]
    return Axes(tuple(map(_as_vector, frame)), tuple(map(_as_vector, directions)))


def frame_at(first: Floats, second: Floats, place: str) -> Floats:
    """Return axes (3, 3), as rows, by two vectors; raises ``CardError`` at a place of the file if they are parallel."""
    frame: Floats | None = frame_of(first, second)
    if frame is None:
        raise CardError(f"{place}: its points are on one line")
    return frame


def _as_vector(values: Floats) -> Vector:
    return tuple((values + 0.0).tolist())
