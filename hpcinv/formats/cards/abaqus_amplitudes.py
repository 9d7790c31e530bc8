"""``*AMPLITUDE`` of Abaqus and CalculiX: the size of a load at the end of the step that has it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hpcinv.base.reading.abaqus_keywords import Keyword
from hpcinv.formats.cards.card import CardError, number


@dataclass(frozen=True)
class Amplitude:
    """Size at the end of a step.

    Attributes:
        is_absolute: whether it is the magnitude, which the lines of data then do not say.
    """

    size: float = 1.0
    is_absolute: bool = False

    def of(self, magnitude: float) -> float:
        """Return the value of a load by the magnitude in its line."""
        return self.size if self.is_absolute else self.size * magnitude


class Amplitudes:
    """Amplitudes of loads at the end of the step that has them."""

    def __init__(self, file: Sequence[Keyword]) -> None:
        self._tables = {k.options.get("NAME", "").lower(): k for k in file if k.name == "AMPLITUDE"}
        self._periods = [0.0]
        for keyword in file:
            if keyword.name == "STEP":
                self._periods.append(1.0)
            elif keyword.name == "STATIC" and len(self._periods) > 1 and keyword.rows and len(keyword.lines[0]) > 1:
                self._periods[-1] = number(keyword.lines[0][1] or "1", "*STATIC")

    def at_end(self, keyword: Keyword, step: int, unused: list[str]) -> Amplitude:
        """Return the amplitude of a load at the end of its step; what is not read is added to ``unused``.

        Raises:
            CardError: there is no such amplitude, or it is damaged.
        """
        name = keyword.options.get("AMPLITUDE", "")
        if not name:
            return Amplitude()
        table = self._tables.get(name.lower())
        if table is None:
            raise CardError(f"*{keyword.name}: there is no *AMPLITUDE {name}")
        end = sum(self._periods) if _is_of_total_time(table) else self._periods[step]
        kind = table.options.get("DEFINITION", "TABULAR").upper()
        value = table.options.get("VALUE", "RELATIVE").upper()
        entries = [number(entry or "0", "*AMPLITUDE") for line in table.lines for entry in line]
        points = list(zip(entries[::2], entries[1::2], strict=False))
        if kind != "TABULAR" or value not in ("RELATIVE", "ABSOLUTE") or not points or len(entries) % 2:
            unused.append(f"*AMPLITUDE {name} ({kind}) of *{keyword.name}")
            return Amplitude()
        delay = number(keyword.options.get("TIME DELAY", "0"), f"*{keyword.name}")  # of CalculiX, as the shifts
        later, higher = (number(table.options.get(name, "0"), "*AMPLITUDE") for name in ("SHIFTX", "SHIFTY"))
        return Amplitude(_interpolated(points, end - delay - later) + higher, value == "ABSOLUTE")


def _is_of_total_time(table: Keyword) -> bool:
    return "".join(table.options.get("TIME", "").upper().split()) == "TOTALTIME"


def _interpolated(points: Sequence[tuple[float, float]], time: float) -> float:
    """Return the value of a table at a time; constant outside of it."""
    before = points[0]
    if time <= before[0]:
        return before[1]
    for after in points[1:]:
        if time <= after[0]:
            share = (time - before[0]) / (after[0] - before[0])
            return before[1] + share * (after[1] - before[1])
        before = after
    return before[1]
