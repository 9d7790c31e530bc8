"""Faults in the headers of images that readers pass over: missing voxels, contradictory or sheared axes."""

import gzip
import struct
import zlib
from pathlib import Path
from typing import IO, cast

import numpy as np

from hpcinv.errors import MeshError
from hpcinv.mesh.source import Floats

_NIFTI_1 = 348  # bytes of its header
_CHUNK = 1 << 20
_SAME = 1e-3  # relative difference of positions, of headers in single precision


def check_nifti(path: Path) -> None:
    """Check that a NIfTI-1 file (.nii, .nii.gz) is whole and that its header says one place of the voxels.

    Source: https://nifti.nimh.nih.gov/nifti-1

    Raises:
        MeshError: voxels are missing, a voxel has no size, or qform and sform differ.
    """
    try:
        with _opened(path) as file:
            head = file.read(_NIFTI_1)
            order = "<" if head[:4] == struct.pack("<i", _NIFTI_1) else ">"
            if len(head) < _NIFTI_1 or struct.unpack_from(f"{order}i", head)[0] != _NIFTI_1:
                return  # NIfTI-2 or no NIfTI, which the reader reports
            fault = _fault(head, order) or _missing(head, order, file)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise MeshError(f"{path}: cannot be read as an image: {error}", "Is the file complete?") from None
    if fault:
        raise MeshError(f"{path}: {fault}", "Write the image again by the program that made it.")


def _opened(path: Path) -> IO[bytes]:
    return cast("IO[bytes]", gzip.open(path)) if path.suffix == ".gz" else path.open("rb")


def _missing(head: bytes, order: str, file: IO[bytes]) -> str:
    """Fault of a file without its last voxels, which readers take as 0; empty text if there is none."""
    dims = struct.unpack_from(f"{order}8h", head, 40)
    bits, begin = struct.unpack_from(f"{order}h", head, 72)[0], struct.unpack_from(f"{order}f", head, 108)[0]
    if head[344:347] == b"ni1":  # voxels are in another file
        return ""
    expected = int(begin) + int(np.prod(dims[1 : 1 + max(1, min(dims[0], 7))], dtype=object)) * bits // 8
    found = len(head)
    while found < expected and (part := file.read(_CHUNK)):
        found += len(part)
    if found < expected:
        return f"the file ends after {found:,} of {expected:,} bytes: voxels are missing"
    return ""


def _fault(head: bytes, order: str) -> str:
    """Fault of sizes and axes; empty text if there is none."""
    pixel = struct.unpack_from(f"{order}8f", head, 76)
    if not all(np.isfinite(pixel[1:4])) or min(pixel[1:4]) <= 0:
        return f"its header says voxels of {pixel[1]:g} x {pixel[2]:g} x {pixel[3]:g}, which are no lengths"
    qform, sform = struct.unpack_from(f"{order}2h", head, 252)
    if sform <= 0:
        return ""
    by_s = np.array(struct.unpack_from(f"{order}12f", head, 280)).reshape(3, 4)
    if sheared(by_s[:, :3]):
        return "the axes of its voxels (sform) are not at right angles"
    if qform <= 0:
        return ""
    b, c, d, *offset = struct.unpack_from(f"{order}6f", head, 256)
    a = np.sqrt(max(0.0, 1.0 - b * b - c * c - d * d))
    rotation = np.array(
        [
            [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
            [2 * (b * c + a * d), a * a + c * c - b * b - d * d, 2 * (c * d - a * b)],
            [2 * (b * d - a * c), 2 * (c * d + a * b), a * a + d * d - b * b - c * c],
        ]
    )
    scale = np.array([pixel[1], pixel[2], pixel[3] * (-1 if pixel[0] < 0 else 1)])
    by_q = np.column_stack([rotation * scale, offset])
    last = np.array(struct.unpack_from(f"{order}3h", head, 42)) - 1.0
    corners = np.array([[x, y, z, 1] for x in (0, last[0]) for y in (0, last[1]) for z in (0, last[2])])
    off = np.linalg.norm(corners @ (by_q - by_s).T, axis=1).max()
    # Half a voxel at a corner is rounding of the header for large images, and no other place.
    if off > max(0.5 * min(pixel[1:4]), _SAME * np.linalg.norm(last * pixel[1:4])):
        return f"its header says two places of the voxels (qform and sform), up to {off:.3g} apart"
    return ""


def sheared(axes: Floats) -> bool:
    """Return whether axes, the columns of a matrix (3, 3), are not at right angles."""
    unit = axes / np.maximum(np.linalg.norm(axes, axis=0), 1e-300)
    return bool(abs(unit.T @ unit - np.eye(3)).max() > _SAME)
