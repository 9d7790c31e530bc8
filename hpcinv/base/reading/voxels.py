"""Voxels of an image, and the checks that every image must pass, whatever its format."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from hpcinv.base.reading.fault import Fault

type Floats = npt.NDArray[np.float64]
type Numbers = npt.NDArray[np.number[Any]]

_SAME = 1e-3  # relative error of directions, of headers in single precision; larger: sheared bodies pass
_TABLE = 1 << 15  # range of labels that are counted in a table; larger tables take longer than sorting
_AGAIN = "Write the image again by the program that made it."


@dataclass(frozen=True)
class VoxelGrid:
    """Voxels in the unit of a file, in LPS.

    Attributes:
        numbers: (nx, ny, nz).
        spacing: (3,).
        origin: the first voxel's middle, (3,).
        axes: directions of the grid as columns (3, 3).
        names: names of numbers, if the format has them.
        labels, counts: distinct numbers, and how many voxels have them; of a checked grid.
    """

    numbers: Numbers
    spacing: Floats
    origin: Floats
    axes: Floats
    names: Mapping[str, int] = field(default_factory=dict)
    labels: Numbers = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    counts: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))


_MOST_LABELS = 2000
"""Labels of a segmentation; atlases of brains have up to 1100. Raised, more scans are taken for segmentations"""


def checked(grid: VoxelGrid) -> VoxelGrid:
    """Return the grid with its labels, in the smallest type of whole numbers; raise ``Fault`` if it is not one."""
    numbers = grid.numbers
    if numbers.ndim != 3:
        text = f"has {numbers.ndim} dimensions"
        raise Fault(text, "Give an image of three dimensions, such as one time of a series.")
    if not numbers.size:
        raise Fault("has no voxels", _AGAIN)
    check_frame(grid.spacing, grid.origin, grid.axes)
    labels, counts = _labels(numbers)
    if len(labels) > _MOST_LABELS:
        text = f"has {len(labels):,} different values, from {labels[0]:,} to {labels[-1]:,}, as a scan has"
        raise Fault(text, "Give a segmentation, not the scan itself.")
    kind = np.result_type(np.min_scalar_type(labels[0]), np.min_scalar_type(labels[-1]))
    kind = kind if kind.kind in "iu" else np.dtype(np.int64)
    return replace(grid, numbers=numbers.astype(kind), labels=labels.astype(kind), counts=counts)


def check_frame(spacing: Floats, origin: Floats, axes: Floats) -> None:
    """Check that voxels have a size, and that their axes are unit vectors at right angles."""
    if not np.isfinite(spacing).all() or spacing.min() <= 0:
        raise Fault(f"its header says voxels of {_shown(spacing, ' x ')}, which are not lengths", _AGAIN)
    if not np.isfinite(origin).all():
        raise Fault(f"its header says the origin ({_shown(origin, ', ')}), which is not a place", _AGAIN)
    if not np.isfinite(axes).all():
        raise Fault("its header says directions that are not finite numbers", _AGAIN)
    lengths = np.linalg.norm(axes, axis=0)
    if abs(lengths - 1).max() > _SAME:
        raise Fault(f"its header says directions of lengths {_shown(lengths, ', ')}, which must be 1", _AGAIN)
    if abs(axes.T @ axes - np.eye(len(lengths))).max() > _SAME:
        raise Fault("the axes of its voxels are not at right angles", "Resample it to a straight grid.")


def _counted(part: Numbers) -> tuple[Numbers, npt.NDArray[np.int64]]:
    """Distinct numbers in ascending order, and how many there are of each."""
    low, high = part.min(), part.max()
    if part.dtype.kind not in "iu" or int(high) - int(low) >= _TABLE:
        return np.unique(part, return_counts=True)
    places = np.bincount((part - low).ravel().astype(np.intp))  # ten times as fast as sorting
    values = np.flatnonzero(places)
    return values + int(low), places[values]


def _shown(values: Floats, separator: str) -> str:
    return separator.join(f"{value:g}" for value in values)


def _labels(numbers: Numbers) -> tuple[Numbers, npt.NDArray[np.int64]]:
    """Distinct numbers and how many voxels have them, slice by slice: sorting needs memory."""
    total = dict[Any, int]()
    for part in np.moveaxis(numbers, int(np.argmax(numbers.strides)), 0):  # slices that are whole in memory
        values, counts = _counted(part)
        if not np.isfinite(values).all():
            raise Fault("has voxels that are not finite numbers", _AGAIN)
        if not np.array_equal(values, np.rint(values)):
            raise Fault("its values are not whole numbers", "Give a segmentation, not the scan itself.")
        for value, count in zip(values.tolist(), counts.tolist(), strict=True):
            total[value] = total.get(value, 0) + count
    labels = sorted(total)
    if not -(2**63) <= labels[0] <= labels[-1] < 2**63:
        raise Fault("has numbers beyond 64 bits", "Give a segmentation, not the scan itself.")
    return np.array([int(label) for label in labels], dtype=np.int64), np.array([total[label] for label in labels])
