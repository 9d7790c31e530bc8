"""Tractions of one interface that vary within what a given shape admits: pressures, and tangential ones of friction.

Where there are more than `MOST` functions, tractions vary in a coarse field: weights that are not negative, and add up
to 1, spread the numbers at some of the nodes over the nodes around them. So pressures from 0 on stay so, bounds stay
bounds, and tangential tractions stay within the friction cone. Coarse fields leave out what varies from node to node.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from hpcinv.mesh.source import Floats, Ints
from hpcinv.model.interfaces.pair import SurfacePair
from hpcinv.model.interfaces.segments import tangents_of
from hpcinv.trust.intervals.friction_cones import FrictionCones

MOST = 2000
"""Pressures of one interface above which their field is coarse. Raised, intervals of large surfaces take longer, as the
square of their number; lowered, ends lie farther inside."""
_NEIGHBOURS = 5
"""Nodes of the coarse field around a node, the farthest without weight. Raised, fields are smoother."""


class VariedTractions:
    """Numbers of one interface: k pressures of functions that may press, then two tangential tractions of each.

    Args:
        first: place of the first of them among the numbers of all interfaces.

    Attributes:
        count: of the numbers.
        pressures: of the pressures among them.
        fine: number of functions that may press; more than ``pressures`` of a coarse field.
    """

    def __init__(self, pair: SurfacePair, first: int) -> None:
        self.pair, self.first, self._pressing = pair, first, pair.pressing
        places, normals = pair.frame
        self.fine = len(self._pressing)
        self._weights = _coarse_field(places[self._pressing], MOST)
        self._areas = pair.areas[self._pressing]
        self._coarse_areas = self._weights.T @ self._areas
        self.pressures = self._weights.shape[1]
        self._tangents = tangents_of(normals[self._pressing])
        means = self._mean(normals[self._pressing])
        sizes = np.linalg.norm(means, axis=1, keepdims=True)
        self._coarse_tangents = tangents_of(means / np.where(sizes > 0, sizes, 1.0))
        self.count = self.pressures * (3 if pair.spec.friction else 1)

    @property
    def numbers(self) -> slice:
        """Place of the numbers among the ones of all interfaces."""
        return slice(self.first, self.first + self.count)

    def _mean(self, values: Floats) -> Floats:
        """Return the means by area (k, …) of values at the functions around the nodes of the field."""
        if self.fine == self.pressures:
            return values
        spread: Floats = self._weights.T @ (self._areas[:, None] * values.reshape(self.fine, -1))
        areas = np.where(self._coarse_areas > 0, self._coarse_areas, 1.0)
        return (spread / areas[:, None]).reshape(self.pressures, *values.shape[1:])

    def present(self) -> Floats:
        """Return the numbers of the present state, or the nearest ones of a coarse field."""
        pressures = self._mean(self.pair.pressures[self._pressing])
        if not self.pair.spec.friction:
            return pressures
        vectors = self._mean(self.pair.tangential[self._pressing])
        tangential = np.einsum("kai,ki->ka", self._coarse_tangents, vectors)
        return np.concatenate([pressures, tangential.ravel()])

    def whole(self, values: Floats) -> tuple[Floats, Floats]:
        """Return pressures (n,) and tangential tractions (n, 3) of all functions for these numbers."""
        pressures = np.zeros(len(self.pair.areas))
        tangential = np.zeros((len(pressures), 3))
        pressures[self._pressing] = self._weights @ values[: self.pressures]
        if self.pair.spec.friction:
            along = values[self.pressures :].reshape(-1, 2)
            vectors = self._weights @ np.einsum("kai,ka->ki", self._coarse_tangents, along)
            in_plane = np.einsum("kai,ki->ka", self._tangents, vectors)
            tangential[self._pressing] = np.einsum("kai,ka->ki", self._tangents, in_plane)
        return pressures, tangential

    def unit_forces(self, number: int) -> Floats:
        """Return the nodal forces (owned unknowns, scaled) of a unit of one number; collective."""
        return self.pair.forces_of(*self.whole(np.eye(1, self.count, number)[0]))

    @property
    def areas(self) -> Floats:
        """Areas (count,), scaled, whose products with the numbers add up to the force."""
        return np.concatenate([self._coarse_areas, np.zeros(self.count - self.pressures)])

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


def _coarse_field(places: Floats, most: int) -> csr_array:
    """Return weights (n, k) that spread numbers at k nodes over all nodes (n, 3): k is at most ``most``.

    Each of these nodes is the farthest from the ones before. The weights are Franke and Little's, of inverse distances
    (Franke, 1982, doi:10.1090/S0025-5718-1982-0637296-4), and 1 at the nodes themselves.
    """
    n = len(places)
    if n <= most:
        return csr_array((np.ones(n), (np.arange(n), np.arange(n))), shape=(n, n))
    chosen = [0]
    distances = np.linalg.norm(places - places[0], axis=1)
    while len(chosen) < most:
        chosen.append(int(distances.argmax()))
        distances = np.minimum(distances, np.linalg.norm(places - places[chosen[-1]], axis=1))
    near, columns = cKDTree(places[chosen]).query(places, k=min(_NEIGHBOURS, most))
    near, columns = near.reshape(n, -1), columns.reshape(n, -1)
    farthest = near[:, -1:]
    weights = ((farthest - near) / (near + 1e-9 * farthest)) ** 2 if most > 1 else np.ones_like(near)
    weights /= weights.sum(axis=1, keepdims=True)
    rows = np.repeat(np.arange(n), near.shape[1])
    return csr_array((weights.ravel(), (rows, columns.ravel())), shape=(n, most))
