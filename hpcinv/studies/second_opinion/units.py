"""Units of a deck, which follow from its units of length and force, and seconds."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Units:
    """What a number 1 of a deck means in SI units.

    Attributes:
        length: m.
        force: N.
    """

    length: float
    force: float = 1.0

    @property
    def stress(self) -> float:
        """Force per area, Pa."""
        return self.force / self.length**2

    @property
    def density(self) -> float:
        """Mass per volume, kg/m³."""
        return self.force / self.length**4
