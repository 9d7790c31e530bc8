"""Tractions of one interface that vary within what a given shape admits: pressures, and tangential ones of friction."""

from __future__ import annotations

import numpy as np

from hpcinv.mesh.source import Floats, Ints
from hpcinv.model.interfaces.pair import SurfacePair
from hpcinv.model.interfaces.segments import tangents_of
from hpcinv.trust.intervals.friction_cones import FrictionCones


class VariedTractions:
    """Numbers of one interface: k pressures of functions that may press, then two tangential tractions of each.

    Args:
        first: place of the first of them among the numbers of all interfaces.

    Attributes:
        count: of the numbers.
        pressures: of the pressures among them.
    """

    def __init__(self, pair: SurfacePair, first: int) -> None:
        self.pair, self.first, self._pressing = pair, first, pair.pressing
        places, normals = pair.frame
        self._places, self._normals = places[self._pressing], normals[self._pressing]
        self.pressures = len(self._pressing)
        self._tangents = tangents_of(self._normals)
        self.count = self.pressures * (3 if pair.spec.friction else 1)

    @property
    def numbers(self) -> slice:
        """Place of the numbers among the ones of all interfaces."""
        return slice(self.first, self.first + self.count)

    def present(self) -> Floats:
        """Return the numbers of the present state."""
        pressures = self.pair.pressures[self._pressing]
        if not self.pair.spec.friction:
            return pressures
        tangential = np.einsum("kai,ki->ka", self._tangents, self.pair.tangential[self._pressing])
        return np.concatenate([pressures, tangential.ravel()])

    def whole(self, values: Floats) -> tuple[Floats, Floats]:
        """Return pressures (n,) and tangential tractions (n, 3) of all functions for these numbers."""
        pressures = np.zeros(len(self.pair.areas))
        tangential = np.zeros((len(pressures), 3))
        pressures[self._pressing] = values[: self.pressures]
        if self.pair.spec.friction:
            along = values[self.pressures :].reshape(-1, 2)
            tangential[self._pressing] = np.einsum("kai,ka->ki", self._tangents, along)
        return pressures, tangential

    def unit_forces(self, number: int) -> Floats:
        """Return the nodal forces (owned unknowns, scaled) of a unit of one number; collective."""
        return self.pair.forces_of(*self.whole(np.eye(1, self.count, number)[0]))

    @property
    def areas(self) -> Floats:
        """Areas (count,), scaled, whose products with the numbers add up to the force."""
        return np.concatenate([self.pair.areas[self._pressing], np.zeros(self.count - self.pressures)])

    @property
    def lowest(self) -> Floats:
        """Lower bounds (count,) of the numbers."""
        return np.where(np.arange(self.count) < self.pressures, 0.0, -np.inf)

    def greatest(self, pressure: float | None) -> Floats:
        """Return upper bounds (count,) of the numbers for a largest pressure (scaled)."""
        bound = np.inf if pressure is None else pressure
        return np.where(np.arange(self.count) < self.pressures, bound, np.inf)

    def cones(self) -> list[FrictionCones]:
        """Return the friction cones of these numbers; none without friction."""
        if not self.pair.spec.friction:
            return []
        numbers: Ints = self.first + np.arange(self.count)
        tangential = numbers[self.pressures :].reshape(-1, 2)
        return [FrictionCones(self.pair.spec.friction, numbers[: self.pressures], tangential)]
