"""Load curves of FEBio (formats 2.5 to 4.0) at the end of a model."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from functools import cached_property

import numpy as np

from hpcinv.base.quantity.arrays import Floats
from hpcinv.formats.cards.card import CardError, number

_STEPS, _STEP_SIZE = "10", "0.1"
"""Numbers of FEBio where a file does not state them."""


class LoadCurves:
    """The load curves of a model, by their numbers."""

    def __init__(self, root: ET.Element) -> None:
        self._root = root

    @cached_property
    def end(self) -> float:
        """Time at the end of the last step."""
        controls = self._root.findall("Step//Control") or self._root.findall("Control") or [self._root]
        return sum(
            number(control.findtext("time_steps", _STEPS), "time_steps")
            * number(control.findtext("step_size", _STEP_SIZE), "step_size")
            for control in controls
        )

    def at_end(self, label: str) -> float:
        """Return the value of a curve at the end.

        Raises:
            CardError: there is no such curve, or its value there is not known.
        """
        curve = self._curve(label)
        if curve.tag == "loadcurve":  # format 2.5
            kinds = curve.get("type", "linear"), curve.get("extend", "constant")
        else:
            kinds = curve.findtext("interpolate", "LINEAR"), curve.findtext("extend", "CONSTANT")
        interpolate, extend = (kind.strip().upper() for kind in kinds)
        return curve_value(self.points(label), interpolate, extend, self.end)

    def points(self, label: str) -> Floats:
        """Return times and values of a curve, (n, 2).

        Raises:
            CardError: there is no such curve, or it is not a list of points.
        """
        curve, place = self._curve(label), f"load curve {label}"
        items = [*curve.iter("pt"), *curve.iter("point")]
        rows = [[number(entry, place) for entry in (item.text or "").split(",")] for item in items]
        is_list = curve.tag == "loadcurve" or curve.get("type") == "loadcurve"
        if not rows or not is_list or any(len(row) != 2 for row in rows):
            raise CardError(f"{place} is not a list of points")
        return np.array(rows)

    def _curve(self, label: str) -> ET.Element:
        curve = next((item for item in self._root.findall("LoadData/*") if item.get("id") == label), None)
        if curve is None:
            raise CardError(f"there is no load curve {label}")
        return curve


def curve_value(points: Floats, interpolate: str, extend: str, time: float) -> float:
    """Return a load curve of points (n, 2), sorted by time, at a time.

    Raises:
        CardError: the interpolation between its points is not a straight line or a step.
    """
    times, values = points.T
    matches = np.flatnonzero(np.isclose(times, time, rtol=1e-9, atol=0))
    if len(matches):
        return float(values[matches[0]])
    if len(points) == 1:
        return float(values[0])
    if not times[0] <= time <= times[-1]:
        kind = f"beyond {extend}"
    else:
        kind = "LINEAR" if interpolate == "SMOOTH" and len(points) == 2 else interpolate
    if kind == "STEP":
        return float(values[np.searchsorted(times, time)])
    if kind in ("LINEAR", "beyond CONSTANT"):  # outside, the first or the last value
        return float(np.interp(time, times, values))
    raise CardError(f"a load curve of kind {interpolate}, {extend} is not known at time {time:g}")
