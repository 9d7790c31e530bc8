"""Segmented images: numbers of labels on a grid of voxels, and where that grid lies."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hpcinv.base.quantity.arrays import Booleans
from hpcinv.base.quantity.suggestions import did_you_mean
from hpcinv.base.quantity.units import readable
from hpcinv.base.reading.voxels import Numbers, VoxelGrid
from hpcinv.errors import MeshError
from hpcinv.geometry.imaging.image_files import read_voxels
from hpcinv.mesh.source import Floats

type LabelArray = npt.NDArray[np.int16]

LPS = "LPS"
_ENDS = {"L": "left", "R": "right", "P": "back", "A": "front", "S": "head", "I": "feet"}


@dataclass(frozen=True)
class LabelImage:
    """Labels of voxels: 0 is outside, ``n`` the n-th of ``names``.

    Attributes:
        voxels: labels, (nx, ny, nz).
        spacing: of the voxels' middles, in m.
        origin: position of the first voxel's middle in m.
        axes: directions of the image's axes as columns.
        frame: description of the frame of positions, for reports.
        neighbours: voxels (nx, ny, nz) of what is around the body and not meshed, by name.
        numbers: of all voxels in the file, (nx, ny, nz), to say what is around the body.
    """

    path: Path
    names: Sequence[str]
    voxels: LabelArray
    spacing: Floats
    origin: Floats
    axes: Floats
    frame: str = ""
    neighbours: Mapping[str, Booleans] = field(default_factory=dict)
    numbers: Numbers = field(default_factory=lambda: np.zeros((0, 0, 0), dtype=np.int64))

    def volume(self, label: int) -> float:
        """Volume (m³) of a label's voxels."""
        return float(np.count_nonzero(self.voxels == label) * self.spacing.prod())

    def positions(self, points: Floats) -> Floats:
        """Positions (m) in the image's frame of points (n, 3) that are in m along its axes, from the first voxel."""
        return self.origin + points @ self.axes.T


def _mask(numbers: Numbers, members: Iterable[int]) -> Booleans:
    """Return which voxels have one of some numbers, slice by slice to save memory."""
    return np.array([np.isin(part, list(members)) for part in numbers])


def read_labels(
    path: Path,
    labels: Mapping[str, Sequence[int | str]] | None,
    unit: float,
    orientation: str = LPS,
    neighbours: Mapping[str, Sequence[int | str]] | None = None,
) -> LabelImage:
    """Read a segmented image on this process.

    Args:
        labels: numbers of voxels, or names of segments, by the name of their region; by default all but 0 as
            the region "body".
        unit: length unit (m) of spacing and origin in the file.
        orientation: of the positions' x, y and z, in letters of left or right, posterior or anterior, superior or
            inferior.
        neighbours: numbers of voxels around the body that are not meshed, by name.

    Raises:
        MeshError: it cannot be read, is not one of labels in three dimensions, or lacks a label.
        SystemPartMissing: the packages for images are not installed.
    """
    grid = read_voxels(path)
    numbers = grid.numbers
    if labels is None:
        labels = {"body": grid.labels[grid.labels != 0].tolist()}
    regions, surrounding = (_members(path, grid, given, unit) for given in (labels, neighbours or {}))
    voxels = np.zeros(numbers.shape, dtype=np.int16)
    for index, members in enumerate(regions.values(), start=1):
        for part, labelled in zip(numbers, voxels, strict=True):
            labelled[np.isin(part, list(members))] = index
    masks = {name: _mask(numbers, members) for name, members in surrounding.items()}
    turn = frame_of(orientation)
    frame = f" in {orientation} (x, y, z to {', '.join(_ENDS[letter] for letter in orientation)})"
    origin, axes = turn @ grid.origin * unit, turn @ grid.axes
    # The file's numbers are kept only where a message may need them.
    kept = {"numbers": numbers} if masks else {}
    return LabelImage(path, tuple(regions), voxels, grid.spacing * unit, origin, axes, frame, masks, **kept)


def _members(
    path: Path, grid: VoxelGrid, given: Mapping[str, Sequence[int | str]], unit: float
) -> dict[str, Sequence[int]]:
    """Return the numbers of the voxels of each region; raise an error if it has none, or one is not in the image."""
    for name, members in given.items():
        if not members:
            text = f"{path}: the region '{name}' has no label; the labels in the image are {described(grid, unit)}"
            raise MeshError(text, "Name the numbers of its voxels.")
    found = numbered(path, given, grid.names)
    for name, number in ((name, number) for name, members in found.items() for number in members):
        if number not in grid.labels:
            raise MeshError(
                f"{path}: no voxel has the label {number} ('{name}'); the labels in it are {described(grid, unit)}",
                "Correct 'labels' in the job's section 'mesh'.",
            )
    return found


def frame_of(orientation: str) -> Floats:
    """Rotation (3, 3) from LPS, the frame of DICOM, to another frame, such as RAS."""
    turn = np.zeros((3, 3))
    for row, letter in enumerate(orientation):
        turn[row, "LPSRAI".index(letter) % 3] = 1.0 if letter in LPS else -1.0
    return turn


def labels_in(path: Path, unit: float) -> str:
    """List all labels of an image; errors as in `read_labels`."""
    return described(read_voxels(path), unit)


_MOST_LISTED = 200
"""Labels that a message lists; raised, messages on scans of 256 grey values are pages long"""


def described(grid: VoxelGrid, unit: float) -> str:
    """List the labels of an image but 0 with their volumes.

    Args:
        unit: length unit (m) of the image.
    """
    voxel = float(grid.spacing.prod()) * unit**3
    names = {number: f" '{name}'" for name, number in grid.names.items()}
    every = [(label, count) for label, count in zip(grid.labels.tolist(), grid.counts.tolist(), strict=True) if label]
    texts = [
        f"{label}{names.get(label, '')} ({readable(count * voxel, 'm^3')})" for label, count in every[:_MOST_LISTED]
    ]
    more = f" and {len(every) - _MOST_LISTED:,} more" if len(every) > _MOST_LISTED else ""
    return ", ".join(texts) + more or "none but 0"


def numbered(
    path: Path, labels: Mapping[str, Sequence[int | str]], names: Mapping[str, int]
) -> dict[str, Sequence[int]]:
    """The labels with numbers instead of names of segments."""
    for name in (name for members in labels.values() for name in members if isinstance(name, str)):
        if not names:
            raise MeshError(
                f"{path}: has numbers and no names as '{name}'",
                "DICOM segmentations and 3D Slicer's .seg.nrrd have names.",
            )
        if name not in names:
            raise MeshError(f"{path}: has no segment '{name}'.{did_you_mean(name, names)}")
    return {
        key: [names[name] if isinstance(name, str) else name for name in members] for key, members in labels.items()
    }
