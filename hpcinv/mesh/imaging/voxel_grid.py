"""Voxels of a file: their numbers, and where they lie."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from hpcinv.mesh.source import Floats


@dataclass(frozen=True)
class VoxelGrid:
    """Voxels in the unit of a file, in LPS.

    Attributes:
        numbers: (nx, ny, nz).
        spacing: (3,).
        origin: the first voxel's middle, (3,).
        axes: directions of the grid as columns (3, 3).
        names: names of numbers, if the format has them.
    """

    numbers: npt.NDArray[np.number[Any]]
    spacing: Floats
    origin: Floats
    axes: Floats
    names: Mapping[str, int] = field(default_factory=dict)
