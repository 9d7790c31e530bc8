"""Segmented images: numbers of labels on a grid of voxels, and where that grid lies."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hpcinv.errors import MeshError
from hpcinv.mesh.imaging.headers import sheared
from hpcinv.mesh.imaging.image_files import read_voxels
from hpcinv.mesh.source import Floats
from hpcinv.quantity.suggestions import did_you_mean

type Labels = npt.NDArray[np.int16]
type Bools = npt.NDArray[np.bool_]

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
    """

    path: Path
    names: Sequence[str]
    voxels: Labels
    spacing: Floats
    origin: Floats
    axes: Floats
    frame: str = ""
    neighbours: Mapping[str, Bools] = field(default_factory=dict)

    def volume(self, label: int) -> float:
        """Volume (m³) of a label's voxels."""
        return float(np.count_nonzero(self.voxels == label) * self.spacing.prod())

    def positions(self, points: Floats) -> Floats:
        """Positions (m) in the image's frame of points (n, 3) that are in m along its axes, from the first voxel."""
        return self.origin + points @ self.axes.T


def read_labels(
    path: Path,
    labels: Mapping[str, Sequence[int | str]],
    unit: float,
    orientation: str = LPS,
    neighbours: Mapping[str, Sequence[int | str]] | None = None,
) -> LabelImage:
    """Read a segmented image on this process.

    Args:
        labels: numbers of voxels, or names of DICOM segments, by the name of their region.
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
    around = neighbours or {}
    if none := [name for name, of in {**labels, **around}.items() if not of]:
        raise MeshError(f"{path}: the region '{none[0]}' has no label", "Name the numbers of its voxels.")
    labels, around = _numbered(path, labels, grid.names), _numbered(path, around, grid.names)
    if numbers.ndim != 3:
        raise MeshError(
            f"{path}: has {numbers.ndim} dimensions", "Give an image of three dimensions, such as one time of a series."
        )
    found = np.unique(np.concatenate([np.unique(part) for part in numbers]))  # in parts, for large images
    if not np.array_equal(found, np.rint(found)):
        raise MeshError(f"{path}: its values are not whole numbers", "Give a segmentation, not the scan itself.")
    voxels = np.zeros(numbers.shape, dtype=np.int16)
    for name, of in {**labels, **around}.items():
        if missing := [number for number in of if number not in found]:
            known = ", ".join(f"{number:g}" for number in found[found != 0][:20]) or "none but 0"
            raise MeshError(
                f"{path}: no voxel has the label {missing[0]} ('{name}'); the labels in it are {known}",
                "Correct 'labels' in the job's section 'mesh'.",
            )
    for index, of in enumerate(labels.values(), start=1):
        for part, labelled in zip(numbers, voxels, strict=True):
            labelled[np.isin(part, list(of))] = index
    masks = {name: np.array([np.isin(part, list(of)) for part in numbers]) for name, of in around.items()}
    if sheared(grid.axes):
        raise MeshError(f"{path}: the axes of its voxels are not at right angles", "Resample it to a straight grid.")
    turn = frame_of(orientation)
    told = f" in {orientation} (x, y, z to {', '.join(_ENDS[letter] for letter in orientation)})"
    return LabelImage(
        path, tuple(labels), voxels, grid.spacing * unit, turn @ grid.origin * unit, turn @ grid.axes, told, masks
    )


def frame_of(orientation: str) -> Floats:
    """Rotation (3, 3) from LPS, the frame of DICOM, to another frame, such as RAS."""
    turn = np.zeros((3, 3))
    for row, letter in enumerate(orientation):
        turn[row, "LPSRAI".index(letter) % 3] = 1.0 if letter in LPS else -1.0
    return turn


def read_numbers(path: Path) -> Floats:
    """Return the numbers (nx, ny, nz) of an image; errors are those of `read_labels`."""
    return np.asarray(read_voxels(path).numbers)


def _numbered(
    path: Path, labels: Mapping[str, Sequence[int | str]], names: Mapping[str, int]
) -> dict[str, Sequence[int]]:
    """The labels with numbers in place of names of segments."""
    for name in (name for of in labels.values() for name in of if isinstance(name, str)):
        if not names:
            raise MeshError(f"{path}: has numbers and no names as '{name}'", "Names are those of DICOM segmentations.")
        if name not in names:
            raise MeshError(f"{path}: has no segment '{name}'.{did_you_mean(name, names)}")
    return {key: [names[name] if isinstance(name, str) else name for name in of] for key, of in labels.items()}
