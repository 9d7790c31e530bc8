"""Places of parts that contact alone holds, along the way on which such a part can be lifted off.

Where an unloaded free part is placed says nothing about its shape, except that it must not overlap what it touches. So
all its free motions stay as they are, but the one along the mean normals of its contacts.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from hpcinv.mesh.source import Floats
from hpcinv.model.interfaces.pair import SurfacePair
from hpcinv.model.interfaces.pins import Pins
from hpcinv.model.spaces import Unknowns

_WAYS = 1e-3
"""Size of a lift among free motions below which supports hold it: it is left out. Raised, oblique lifts are, too."""


class Lifts:
    """Lifts of all parts with free motions; their places are the last numbers of the interfaces.

    Attributes:
        count: number of lifts.
    """

    def __init__(self, pins: Sequence[Pins], pairs: Sequence[SurfacePair]) -> None:
        self._ways = [_way(pin, pairs) for pin in pins]
        self._begins = [np.zeros(pin.count) for pin in pins]
        self.count = sum(way is not None for way in self._ways)

    def begin(self, pins: Sequence[Pins], unknowns: Unknowns) -> Floats:
        """Take the present places of all parts; return the lifts (count,), which are zero; collective."""
        self._begins = [pin.motion(unknowns.state.x.petsc_vec) for pin in pins]
        return np.zeros(self.count)

    def put(self, values: Floats, pins: Sequence[Pins]) -> None:
        """Move the pins to the places that the numbers (n,) give; the lifts of the parts are the last of these."""
        lifts = iter(values[len(values) - self.count :])
        for pin, way, begin in zip(pins, self._ways, self._begins, strict=True):
            pin.places = begin if way is None else begin + next(lifts) * way

    def place_rates(self, count: int) -> Floats:
        """Return derivatives (b, count) of the places of all pins by all numbers of the interfaces."""
        rates = np.zeros((sum(map(len, self._begins)), count))
        first, column = 0, count - self.count
        for way, begin in zip(self._ways, self._begins, strict=True):
            if way is not None:
                rates[first : first + len(begin), column] = way
                column += 1
            first += len(begin)
        return rates

    def unit_forces(self, pins: Sequence[Pins]) -> Iterator[Floats]:
        """Yield the nodal forces (owned unknowns, scaled) of a unit of each lift."""
        for pin, way in zip(pins, self._ways, strict=True):
            if way is not None:
                yield pin.forces_of(way)


def _way(pin: Pins, pairs: Sequence[SurfacePair]) -> Floats | None:
    """Return the motion (count,) of length 1 along which a part leaves its contacts, ``None`` if supports hold it."""
    normals = [pair.given_normals[0].mean(axis=0) for pair in pairs if pin.region in pair.spec.between]
    way = pin.along(np.sum([np.zeros(3), *normals], axis=0))
    size = float(np.linalg.norm(way))
    return way / size if size > _WAYS else None
