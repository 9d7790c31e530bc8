"""Coulomb's cones ``|t| ≤ μ p`` of tangential tractions, as linear inequalities.

Planes around a cone, ``d·t ≤ μ p`` for unit vectors d, leave out no traction of the cone. With 16 of them tractions may
exceed it by 2 %. A further plane at the direction of each traction that was found leaves the cone itself in the limit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from hpcinv.mesh.source import Floats, Ints

_PLANES = 16
"""Planes around each cone. Raised, linear programs take longer; lowered, more of them are needed for an end."""


@dataclass(frozen=True)
class FrictionCones:
    """Cones of the tractions of one interface.

    Attributes:
        coefficient: μ.
        pressures, tangential: numbers of the pressures (k,) and of the tangential tractions (k, 2) among all n.
    """

    coefficient: float
    pressures: Ints
    tangential: Ints

    def directions(self, values: Floats) -> Floats:
        """Return unit vectors (k, 2) along the tangential tractions of all numbers (n,); any where there are none."""
        found = values[self.tangential]
        sizes = np.linalg.norm(found, axis=1, keepdims=True)
        return np.where(sizes > 0, found / np.where(sizes > 0, sizes, 1.0), [1.0, 0.0])

    def rows(self, count: int, further: Sequence[Floats], share: float = 1.0) -> csr_array:
        """Return the matrix A (m, count) of ``A z ≤ 0`` for all numbers z.

        Args:
            further: directions (k, 2) of more planes.
            share: factor of the coefficient.
        """
        k = len(self.pressures)
        angles = 2 * np.pi * np.arange(_PLANES) / _PLANES
        around = [np.tile([np.cos(angle), np.sin(angle)], (k, 1)) for angle in angles]
        planes = np.concatenate([*around, *further])
        copies = len(planes) // k
        columns = np.column_stack([np.tile(self.pressures, copies), np.tile(self.tangential, (copies, 1))])
        entries = np.column_stack([np.full(len(planes), -share * self.coefficient), planes])
        rows = np.repeat(np.arange(len(planes)), 3)
        return csr_array((entries.ravel(), (rows, columns.ravel())), shape=(len(planes), count))
