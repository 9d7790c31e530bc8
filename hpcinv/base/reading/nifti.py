"""NIfTI files, read by SimpleITK after their header and size were checked."""

import gzip
import math
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from hpcinv.base.reading.door import admitted
from hpcinv.base.reading.fault import IMAGING, Fault, PackageMissing
from hpcinv.base.reading.image_headers import opened
from hpcinv.base.reading.voxel_files import check_memory
from hpcinv.base.reading.voxels import Floats, VoxelGrid, check_frame

_CHUNK = 1 << 20
_SAME = 1e-3  # relative difference of positions, of headers in single precision
_SAME_SIZE = 0.01  # relative difference of two sizes of voxels: programs round them
_AGAIN = "Write the image again by the program that made it."


@dataclass(frozen=True)
class _Layout:
    """Where a version of the header has its fields, and their types."""

    size: int
    magic: bytes
    dims: tuple[int, str]
    kind: int
    pixel: tuple[int, str]
    begin: tuple[int, str]
    codes: tuple[int, str]
    quaternion: tuple[int, str]
    rows: tuple[int, str]
    intent: int


_BITS = {2: 8, 4: 16, 8: 32, 16: 32, 64: 64, 256: 8, 512: 16, 768: 32, 1024: 64, 1280: 64}
"""bits of the types of numbers"""
_COLOURS = {128: 3, 2304: 4, 32: 2, 1792: 2}
_VERSIONS = (
    _Layout(348, b"n+1\0", (40, "8h"), 70, (76, "8f"), (108, "f"), (252, "2h"), (256, "6f"), (280, "12f"), 344),
    _Layout(540, b"n+2\0", (16, "8q"), 12, (104, "8d"), (168, "q"), (344, "2i"), (352, "6d"), (400, "12d"), 4),
)


def read_nifti(path: Path, memory: float) -> VoxelGrid:
    """Read a NIfTI file (.nii, .nii.gz); errors are ``Fault``.

    Sources: https://nifti.nimh.nih.gov/nifti-1 and https://nifti.nimh.nih.gov/nifti-2

    Args:
        memory: bytes that are available.
    """
    try:
        with opened(path) as file:
            _check(file, memory)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise Fault(f"cannot be read as an image: {error}", "Is the file complete?") from None
    try:
        import SimpleITK
    except ImportError:
        text = "images are read by SimpleITK, which is not installed"
        raise PackageMissing(text, IMAGING) from None
    SimpleITK.ProcessObject.SetGlobalWarningDisplay(False)
    reader = SimpleITK.ImageFileReader()
    reader.SetImageIO("NiftiImageIO")
    reader.SetFileName(str(admitted(path)))
    try:
        image = reader.Execute()
    except RuntimeError as error:
        raise Fault(f"cannot be read as an image: {str(error).strip().rsplit(chr(10), 1)[-1]}") from None
    numbers = SimpleITK.GetArrayFromImage(image).transpose()
    spacing, origin = np.array(image.GetSpacing()), np.array(image.GetOrigin())
    return VoxelGrid(numbers, spacing, origin, np.array(image.GetDirection()).reshape(len(spacing), -1))


def _check(file: IO[bytes], memory: float) -> None:
    """Check the header, and that there are as many voxels as it says; read to the end, where gzip has its checksum."""
    head = file.read(_VERSIONS[1].size)
    for layout in _VERSIONS:
        for order in "<>":
            if len(head) >= layout.size and struct.unpack_from(f"{order}i", head)[0] == layout.size:
                return _check_content(head, order, layout, file, memory)
    raise Fault("cannot be read as an image: its header is not one of NIfTI")


def _check_content(head: bytes, order: str, layout: _Layout, file: IO[bytes], memory: float) -> None:
    magic = head[layout.intent : layout.intent + 4]
    if magic != layout.magic:
        raise Fault(f"has the mark {magic!r} in its header: its voxels are in another file", _AGAIN)
    dims = struct.unpack_from(order + layout.dims[1], head, layout.dims[0])
    if not 1 <= dims[0] <= 7 or min(shape := dims[1 : 1 + dims[0]]) < 1:
        raise Fault(f"its header says {dims[0]} dimensions of {dims[1:]} voxels", _AGAIN)
    while len(shape) > 3 and shape[-1] == 1:
        shape = shape[:-1]
    if len(shape) != 3:
        advice = "Give an image of three dimensions, such as one time of a series."
        raise Fault(f"has {len(shape)} dimensions", advice)
    kind, bits = struct.unpack_from(f"{order}2h", head, layout.kind)
    begin = float(struct.unpack_from(order + layout.begin[1], head, layout.begin[0])[0])
    if kind in _COLOURS:
        raise Fault(
            f"has {_COLOURS[kind]} numbers in each voxel", "Give a segmentation, with one number in each voxel."
        )
    if _BITS.get(kind) != bits or not begin.is_integer():
        raise Fault(f"its header says numbers of type {kind} and {bits} bits from byte {begin} on", _AGAIN)
    if begin < layout.size + 4:
        text = f"its header says that voxels begin at byte {int(begin)}, which is in the header"
        raise Fault(text, _AGAIN)
    check_memory(math.prod(shape), bits // 8, memory)
    _check_axes(head, order, layout)
    _check_length(file, len(head), int(begin) + math.prod(shape) * bits // 8)


def _check_length(file: IO[bytes], size: int, expected: int) -> None:
    """Check that a file ends where its header says, after ``size`` bytes that were read."""
    while part := file.read(_CHUNK):
        size += len(part)
        if size > expected:
            raise Fault(f"has more than the {expected:,} bytes that its header says", "Are its sizes right?")
    if size < expected:
        text = f"the file ends after {size:,} of {expected:,} bytes: voxels are missing"
        raise Fault(text, "Is the file complete?")


def _check_axes(head: bytes, order: str, layout: _Layout) -> None:
    """Check sizes and axes, and that both descriptions of the axes say the same."""
    pixel = struct.unpack_from(order + layout.pixel[1], head, layout.pixel[0])
    check_frame(np.array(pixel[1:4]), np.zeros(3), np.eye(3))
    qform, sform = struct.unpack_from(order + layout.codes[1], head, layout.codes[0])
    quaternion = struct.unpack_from(order + layout.quaternion[1], head, layout.quaternion[0])
    if not np.isfinite([pixel[0], *quaternion]).all():
        raise Fault("its header says directions (qform) that are not finite numbers", _AGAIN)
    if qform > 0 and math.hypot(*quaternion[:3]) > 1 + _SAME:
        raise Fault("its header says a rotation (qform) that is not one", _AGAIN)
    if sform <= 0:
        return
    affine = np.array(struct.unpack_from(order + layout.rows[1], head, layout.rows[0])).reshape(3, 4)
    lengths = np.linalg.norm(affine[:, :3], axis=0)
    check_frame(lengths, affine[:, 3], affine[:, :3] / np.maximum(lengths, 1e-300))
    if qform > 0:
        _check_places(affine, pixel, quaternion, struct.unpack_from(order + layout.dims[1], head, layout.dims[0]))
    if abs(lengths / pixel[1:4] - 1).max() > _SAME_SIZE:  # SimpleITK takes the size of the one, the axes of the other
        text = f"its header says two sizes of voxels, {_sizes(pixel[1:4])} and {_sizes(lengths)} (sform)"
        raise Fault(text, _AGAIN)


def _check_places(sform: Floats, pixel: Sequence[float], quaternion: Sequence[float], dims: Sequence[int]) -> None:
    """Check that both descriptions of the axes, sform and qform, give the same place to the voxels."""
    b, c, d, *offset = quaternion
    a = np.sqrt(max(0.0, 1.0 - b * b - c * c - d * d))
    rotation: Floats = np.array(
        [
            [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
            [2 * (b * c + a * d), a * a + c * c - b * b - d * d, 2 * (c * d - a * b)],
            [2 * (b * d - a * c), 2 * (c * d + a * b), a * a + d * d - b * b - c * c],
        ]
    )
    scale = np.array([pixel[1], pixel[2], pixel[3] * (-1 if pixel[0] < 0 else 1)])
    qform = np.column_stack([rotation * scale, offset])
    last = np.array(dims[1:4]) - 1.0
    corners = np.array([[x, y, z, 1] for x in (0, last[0]) for y in (0, last[1]) for z in (0, last[2])])
    off = np.linalg.norm(corners @ (qform - sform).T, axis=1).max()
    # Half a voxel at a corner is rounding of the header for large images, and not another place.
    if not off <= max(0.5 * min(pixel[1:4]), _SAME * np.linalg.norm(last * pixel[1:4])):
        raise Fault(f"its header says two places of the voxels (qform and sform), up to {off:.3g} apart", _AGAIN)


def _sizes(lengths: object) -> str:
    return " x ".join(f"{length:g}" for length in np.asarray(lengths))
