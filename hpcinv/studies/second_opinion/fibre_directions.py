"""Directions of fibres that are the same everywhere in the rest body."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from hpcinv.base.quantity.spatial_fields import POSITIONS
from hpcinv.job.fibres import FibreFamily
from hpcinv.mesh.source import Floats


def constant_directions(families: Mapping[str, FibreFamily]) -> Iterator[tuple[str, Floats]]:
    """Yield name and unit vector (3,) of families whose direction does not vary over the rest body."""
    for name, family in families.items():
        formulas = family.direction
        if formulas is None or family.given_on != "reference" or any(f.names & POSITIONS.keys() for f in formulas):
            continue
        vector = np.array([float(f.evaluate(**{n: family.constants[n] for n in f.names})) for f in formulas])
        yield name, vector / np.linalg.norm(vector)
