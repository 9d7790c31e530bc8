"""DICOM segmentations (SEG): frames of segments, put together on one grid of voxels."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from hpcinv.base.reading.door import admitted
from hpcinv.base.reading.fault import IMAGING, Fault, PackageMissing
from hpcinv.base.reading.voxel_files import check_memory
from hpcinv.base.reading.voxels import Floats, VoxelGrid, check_frame

_SEGMENTATION, _LABEL_MAP = "1.2.840.10008.5.1.4.1.1.66.4", "1.2.840.10008.5.1.4.1.1.66.7"
_SAME = 0.01  # distance of a slice from those below it, relative to a pixel, and difference of directions
_EVEN = 0.05  # distance of a slice from its place, relative to the distance of slices; larger: uneven slices pass
_LONGEST_GAP = 10_000  # slices between two with a segment; each takes memory


def read_segmentation(path: Path, memory: float) -> VoxelGrid:
    """Read a DICOM segmentation: the numbers of its segments, in mm.

    Source: DICOM PS3.3 A.51, https://dicom.nema.org/medical/dicom/current/output/html/part03.html#sect_A.51

    Args:
        memory: bytes that are available.

    Raises:
        Fault: it cannot be read, is another DICOM file, has slices at unequal distances, or segments that overlap.
    """
    try:
        import pydicom
    except ImportError:
        text = "DICOM segmentations are read by pydicom, which is not installed"
        raise PackageMissing(text, IMAGING) from None
    try:
        data = pydicom.dcmread(admitted(path))
        kind = str(data.get("SOPClassUID", ""))
        if kind not in (_SEGMENTATION, _LABEL_MAP):
            raise Fault("is not a DICOM segmentation (SEG)", "Give the segmentation, not the scan itself.")
        return _grid(data, kind == _LABEL_MAP, memory)
    except pydicom.errors.InvalidDicomError as error:
        raise Fault(f"is not a DICOM file: {error}") from error
    except Fault:
        raise
    except MemoryError:
        raise
    except Exception as error:  # pydicom raises whatever damaged values cause
        raise Fault(f"cannot be read as a DICOM segmentation: {error}") from error


def _grid(data: Any, is_label_map: bool, memory: float) -> VoxelGrid:
    """The voxels, from frames of any segments and slices in any order."""
    rows, columns, count = int(data.Rows), int(data.Columns), int(data.NumberOfFrames)
    _check_size(data, rows * columns * count, memory)
    frames = np.asarray(data.pixel_array).reshape(-1, rows, columns)
    if str(data.get("SegmentationType", "")) == "FRACTIONAL":
        frames = frames > 0.5 * float(data.MaximumFractionalValue)
    groups = data.PerFrameFunctionalGroupsSequence
    shared = data.SharedFunctionalGroupsSequence[0]
    measures = _property(shared, groups[0], "PixelMeasuresSequence")
    orientations = np.array(
        [_property(shared, g, "PlaneOrientationSequence").ImageOrientationPatient for g in groups], dtype=float
    )
    if abs(orientations - orientations[0]).max() > _SAME:
        raise Fault("has slices in several directions", "Resample it to a straight grid.")
    right, down = orientations[0].reshape(2, 3)  # of increasing columns, and rows
    normal = np.cross(right, down)
    positions = np.array(
        [_property(shared, g, "PlanePositionSequence").ImagePositionPatient for g in groups], dtype=float
    )
    row_spacing, column_spacing = map(float, measures.PixelSpacing)
    heights = positions @ normal
    stated = float(measures.get("SpacingBetweenSlices", measures.get("SliceThickness", 1.0)))
    origin, axes = positions[heights.argmin()], np.stack([right, down, normal], axis=1)
    check_frame(np.array([column_spacing, row_spacing, 1.0]), positions.ravel(), axes)
    step, places = _places(heights, stated)
    straight = origin + np.outer(heights - heights.min(), normal)
    if abs(positions - straight).max() > _SAME * min(row_spacing, column_spacing):
        raise Fault("its slices are not above each other", "Resample it to a straight grid.")
    check_memory(rows * columns * (int(places.max()) + 1), 8, memory)
    numbers = np.zeros((columns, rows, int(places.max()) + 1), dtype=np.int64)
    written = set[tuple[int, int]]()
    for frame, group, place in zip(frames, groups, places.tolist(), strict=True):
        flat = frame.transpose().astype(np.int64)
        segment = 0
        if not is_label_map:
            segment = int(_property(shared, group, "SegmentIdentificationSequence").ReferencedSegmentNumber)
            flat = (flat > 0) * segment
        if (segment, place) in written:
            text = f"has two slices at the same place{f', of the segment {segment}' if segment else ''}"
            raise Fault(text, "Write the segmentation again: positions of its slices are lost.")
        written.add((segment, place))
        _lay_over(numbers[:, :, place], flat)
    names = {str(s.SegmentLabel): int(s.SegmentNumber) for s in data.SegmentSequence}
    return VoxelGrid(numbers, np.array([column_spacing, row_spacing, step]), origin, axes, names)


def _check_size(data: Any, voxels: int, memory: float) -> None:
    """Check that voxels fit the memory, and that the file has all of them."""
    bits = int(data.BitsAllocated)
    check_memory(voxels, math.ceil(bits / 8), memory)
    if not data.file_meta.TransferSyntaxUID.is_encapsulated:
        size, byte_count = math.ceil(voxels * bits / 8), len(data.PixelData)
        if byte_count not in (size, size + size % 2):
            text = f"has {byte_count:,} bytes of voxels, but its header says {size:,}"
            raise Fault(text, "Is the file complete?")


def _lay_over(numbers: Any, flat: Any) -> None:
    """Write the voxels of a segment into a slice; ``Fault`` if they are another segment's."""
    is_shared = (numbers > 0) & (flat > 0) & (numbers != flat)
    if overlap := np.count_nonzero(is_shared):
        raise Fault(
            f"the segments {numbers[is_shared].min()} and {flat.max()} overlap, by {overlap} voxels in one slice",
            "Write a segmentation in which each voxel belongs to one segment.",
        )
    numbers[:] = np.where(flat > 0, flat, numbers)


def _places(heights: Floats, stated: float) -> tuple[float, Any]:
    """Distance of slices, and the number of each from the lowest one; those without a segment may be missing."""
    distinct = np.unique(np.round(heights, 4))
    if len(distinct) < 2:
        return stated, np.zeros(len(heights), dtype=np.int64)
    gaps = np.diff(distinct)
    if gaps.max() > _LONGEST_GAP * gaps.min():
        raise Fault("its slices have unequal distances", "Resample it to a straight grid.")
    # The whole extent gives a better distance than the smallest gap, which is rounded.
    step = float((distinct[-1] - distinct[0]) / np.rint(gaps / gaps.min()).sum())
    places = np.rint((heights - distinct[0]) / step)
    # Where gaps of one distance are not the usual ones, one slice is out of its place, between others.
    if max(abs((heights - distinct[0]) / step - places).max(), abs(np.median(gaps) / step - 1)) > _EVEN:
        raise Fault("its slices have unequal distances", "Resample it to a straight grid.")
    return step, places.astype(np.int64)


def _property(shared: Any, frame: Any, key: str) -> Any:
    """A property that a frame has for itself, or all frames together."""
    return getattr(frame if key in frame else shared, key)[0]
