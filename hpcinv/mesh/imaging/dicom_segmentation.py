"""DICOM segmentations (SEG): frames of segments, put together on one grid of voxels."""

from pathlib import Path
from typing import Any

import numpy as np

from hpcinv.errors import MeshError
from hpcinv.mesh.imaging.packages import package
from hpcinv.mesh.imaging.voxel_grid import VoxelGrid
from hpcinv.mesh.source import Floats

_SEGMENTATION, _LABEL_MAP = "1.2.840.10008.5.1.4.1.1.66.4", "1.2.840.10008.5.1.4.1.1.66.7"
_SAME = 0.01  # relative difference of distances between slices


def read_segmentation(path: Path) -> VoxelGrid:
    """Read a DICOM segmentation on this process: the numbers of its segments, in mm.

    Source: DICOM PS3.3 A.51, https://dicom.nema.org/medical/dicom/current/output/html/part03.html#sect_A.51

    Raises:
        MeshError: it cannot be read, is another DICOM file, has slices at unequal distances, or segments that overlap.
        SystemPartMissing: pydicom is not installed.
    """
    pydicom = package("pydicom", "DICOM segmentations are read by pydicom", installing="pydicom")
    try:
        data = pydicom.dcmread(path)
        kind = str(data.get("SOPClassUID", ""))
        if kind not in (_SEGMENTATION, _LABEL_MAP):
            raise MeshError(f"{path}: is no DICOM segmentation (SEG)", "Give the segmentation, not the scan itself.")
        return _grid(path, data, kind == _LABEL_MAP)
    except (AttributeError, IndexError, KeyError, TypeError, ValueError, NotImplementedError, EOFError) as error:
        raise MeshError(f"{path}: cannot be read as a DICOM segmentation: {error}") from error
    except pydicom.errors.InvalidDicomError as error:
        raise MeshError(f"{path}: is no DICOM file: {error}") from error


def _grid(path: Path, data: Any, is_label_map: bool) -> VoxelGrid:
    """The voxels, from frames of any segments and slices in any order."""
    frames = np.asarray(data.pixel_array)
    frames = frames.reshape(-1, int(data.Rows), int(data.Columns))
    if str(data.get("SegmentationType", "")) == "FRACTIONAL":
        frames = frames > 0.5 * float(data.MaximumFractionalValue)
    groups = data.PerFrameFunctionalGroupsSequence
    shared = data.SharedFunctionalGroupsSequence[0]
    measures = _of(shared, groups[0], "PixelMeasuresSequence")
    along = np.array(_of(shared, groups[0], "PlaneOrientationSequence").ImageOrientationPatient, dtype=float)
    right, down = along.reshape(2, 3)  # of increasing columns, and rows
    normal = np.cross(right, down)
    positions = np.array([_of(shared, g, "PlanePositionSequence").ImagePositionPatient for g in groups], dtype=float)
    heights = positions @ normal
    step = _step(path, heights, float(measures.get("SpacingBetweenSlices", measures.get("SliceThickness", 1.0))))
    places = np.rint((heights - heights.min()) / step).astype(int)
    row_spacing, column_spacing = map(float, measures.PixelSpacing)
    origin = positions[heights.argmin()]
    straight = origin + np.outer(heights - heights.min(), normal)
    if abs(positions - straight).max() > _SAME * min(row_spacing, column_spacing):
        raise MeshError(f"{path}: its slices are not above each other", "Resample it to a straight grid.")
    numbers = np.zeros((frames.shape[2], frames.shape[1], places.max() + 1), dtype=np.int64)
    for frame, group, place in zip(frames, groups, places, strict=True):
        flat = frame.transpose().astype(np.int64)
        if not is_label_map:
            flat = (flat > 0) * int(_of(shared, group, "SegmentIdentificationSequence").ReferencedSegmentNumber)
        before = numbers[:, :, place]
        if overlap := np.count_nonzero((before > 0) & (flat > 0) & (before != flat)):
            one = next(iter(np.unique(before[(before > 0) & (flat > 0) & (before != flat)])))
            raise MeshError(
                f"{path}: the segments {one} and {flat.max()} overlap, by {overlap} voxels in one slice",
                "Write a segmentation in which each voxel belongs to one segment.",
            )
        numbers[:, :, place] = np.where(flat > 0, flat, before)
    names = {str(s.SegmentLabel): int(s.SegmentNumber) for s in data.SegmentSequence}
    spacing: Floats = np.array([column_spacing, row_spacing, step])
    return VoxelGrid(numbers, spacing, origin, np.stack([right, down, normal], axis=1), names)


def _step(path: Path, heights: Floats, stated: float) -> float:
    """Distance of slices; those without a segment may be missing."""
    distinct = np.unique(np.round(heights, 4))
    if len(distinct) < 2:
        return stated
    gaps = np.diff(distinct)
    step = float(gaps.min())
    if abs(gaps / step - np.rint(gaps / step)).max() > _SAME * len(distinct):
        raise MeshError(f"{path}: its slices have unequal distances", "Resample it to a straight grid.")
    return float((distinct[-1] - distinct[0]) / np.rint(gaps / step).sum())


def _of(shared: Any, frame: Any, key: str) -> Any:
    """A property that a frame has for itself, or all frames together."""
    return getattr(frame if key in frame else shared, key)[0]
