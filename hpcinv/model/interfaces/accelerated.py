"""Updates of multipliers, each accelerated by the updates before it."""

from __future__ import annotations

import numpy as np

from hpcinv.base.quantity.arrays import Booleans
from hpcinv.mesh.source import Floats

_MEMORY = 12
"""Updates whose differences accelerate the next one: nodes that supports hold leave multipliers that hardly move a gap,
which would settle by a tenth in each update. Raised, rounding errors of small differences are added."""


class AcceleratedUpdates:
    """Anderson's acceleration of a fixed point, which begins anew where the set of active constraints changes.

    Source: Anderson (1965), doi:10.1145/321296.321305.
    """

    def __init__(self) -> None:
        self._active: Booleans = np.zeros(0, dtype=np.bool_)
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        self._updates = list[tuple[Floats, Floats]]()

    def have(self, active: Booleans) -> bool:
        """Return whether the same constraints as at the last update are active."""
        return np.array_equal(active, self._active)

    def after(self, values: Floats, change: Floats, active: Booleans) -> Floats:
        """Return the next values, for the change that a plain update would make."""
        if not self.have(active):
            self.forget()
        self._active = active
        self._updates = [*self._updates[-_MEMORY:], (values, change)]
        kept, changes = (np.array(part) for part in zip(*self._updates, strict=True))
        after: Floats = values + change
        if len(kept) > 1:
            steps, differences = np.diff(kept, axis=0), np.diff(changes, axis=0)
            shares = np.linalg.lstsq(differences.T, change, rcond=1e-10)[0]
            after = after - shares @ (steps + differences)
        return after
