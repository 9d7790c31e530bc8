"""MetaImage and NRRD files: their voxels, which must be as many as the header says."""

import binascii
import bz2
import math
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np

from hpcinv.base.reading.door import admitted
from hpcinv.base.reading.fault import Fault, shown
from hpcinv.base.reading.image_headers import ImageHeader, check_regular, opened, read_header
from hpcinv.base.reading.suffix import suffix_of
from hpcinv.base.reading.voxels import Numbers, VoxelGrid, check_frame

_CHUNK = 1 << 20  # bytes that are read, or unpacked, at once; more memory if raised
_GZIP, _BZIP2 = b"\x1f\x8b", b"BZ"


def read_voxel_file(path: Path, memory: float) -> VoxelGrid:
    """Read a MetaImage or NRRD file; errors are ``Fault``.

    Args:
        memory: bytes that are available.
    """
    with opened(path) as file:
        header = read_header(path, file)
        frame = np.array(header.spacing), np.array(header.origin), np.array(header.axes).T
        check_frame(*frame)
        check_memory(math.prod(header.shape), np.dtype(header.type).itemsize, memory)
        names = header.source.names
        if header.source.how == "no file":
            numbers = _voxels(file, header, math.prod(header.shape), suffix_of(path) == ".gz")
        else:
            if not names or header.shape[-1] % len(names):
                raise Fault(f"names {len(names)} files for {header.shape[-1]} slices")
            each = math.prod(header.shape) // len(names)
            numbers = np.concatenate([_voxels_in(path, name, header, each) for name in names])
    return VoxelGrid(numbers.reshape(header.shape, order="F"), *frame, names=header.names)


def check_memory(voxels: int, size: int, memory: float) -> None:
    """Check that there is memory for voxels of some bytes, as read, as an array, and as labels."""
    if (needed := voxels * (2 * size + 4)) > memory:
        raise Fault(
            f"reading it takes about {needed / 1e9:.1f} GB of memory, but {memory / 1e9:.1f} GB are available",
            "Cut it to the labels, or resample it to larger voxels.",
        )


def _voxels_in(header_path: Path, name: str, header: ImageHeader, count: int) -> Numbers:
    """Voxels in a file that a header names."""
    path = header_path.parent / name
    try:
        check_regular(path)
        with admitted(path, header_path).open("rb") as file:
            return _voxels(file, header, count, is_packed=False)
    except (OSError, ValueError) as error:
        text = f"names the file '{shown(name)}', which cannot be read: {getattr(error, 'strerror', None) or error}"
        raise Fault(text, "Files are relative to the header.") from None
    except Fault as fault:
        raise Fault(f"names the file '{shown(name)}', which {fault.text}", fault.advice) from None


def _voxels(file: IO[bytes], header: ImageHeader, count: int, is_packed: bool) -> Numbers:
    """The ``count`` voxels in the rest of a file."""
    for _ in range(header.skipped_lines):
        if not file.readline(_CHUNK).endswith(b"\n"):
            raise Fault("has fewer lines than its header skips")
    kind = np.dtype(header.type)
    if header.encoding == "text":
        return _as_numbers(file, kind, count)
    expected = count * kind.itemsize
    skip = header.skip
    if skip == -1 and header.encoding == "raw" and not is_packed:
        begin = file.tell()
        if (byte_count := file.seek(0, 2) - begin) < expected:
            raise Fault(f"has {byte_count:,} of {expected:,} bytes: voxels are missing", "Is the file complete?")
        file.seek(-expected, 2)
        skip = 0
    if skip < 0:
        raise Fault(f"its header skips {skip} bytes")
    if header.encoding == "hex":
        content = b"".join(file.read(2 * expected + _CHUNK).split())
        try:
            parts = iter([binascii.unhexlify(content)])
        except binascii.Error as error:
            raise Fault(f"its hexadecimal numbers cannot be read: {error}") from None
    elif header.encoding == "raw":
        parts = iter(lambda: file.read(_CHUNK), b"")
    else:
        parts = _unpacked(file, header.encoding)
    return np.frombuffer(_exactly(parts, skip, expected), dtype=kind)


def _exactly(parts: Iterator[bytes], skip: int, expected: int) -> bytearray:
    """Content of parts after the skipped bytes; ``Fault`` unless it has the expected size."""
    content, place = bytearray(expected), -skip
    for part in parts:
        begin, end = max(place, 0), min(place + len(part), expected)
        if begin < end:
            content[begin:end] = part[begin - place : end - place]
        place += len(part)
        if place > expected:
            text = f"has more than the {expected:,} bytes of voxels that its header says"
            raise Fault(text, "Are its sizes and its type right?")
    if place < expected:
        raise Fault(f"has {max(place, 0):,} of {expected:,} bytes: voxels are missing", "Is the file complete?")
    return content


def _unpacked(file: IO[bytes], encoding: str) -> Iterator[bytes]:
    """Parts of a compressed rest of a file, checked to its end; of some streams one after the other."""
    packed = file.read(_CHUNK)
    while packed:
        stream: Any = bz2.BZ2Decompressor() if encoding == "bzip2" else zlib.decompressobj(zlib.MAX_WBITS | 32)
        while not stream.eof:
            try:
                part = stream.decompress(packed, _CHUNK)
            except (OSError, EOFError, zlib.error) as error:
                raise Fault(f"its compressed voxels are damaged: {error}", "Is the file complete?") from None
            packed = b"" if encoding == "bzip2" else stream.unconsumed_tail  # which bzip2 keeps
            needs_more = stream.needs_input if encoding == "bzip2" else not packed
            yield part
            if not stream.eof and needs_more and not (packed := file.read(_CHUNK)) and not part:
                raise Fault("its compressed voxels end too early", "Is the file complete?")
        packed = stream.unused_data or file.read(_CHUNK)
        if packed and not packed.startswith(_BZIP2 if encoding == "bzip2" else _GZIP):
            raise Fault("has other data after its compressed voxels", "Is the file complete?")


def _as_numbers(file: IO[bytes], kind: np.dtype[Any], count: int) -> Numbers:
    """Numbers in text."""
    content = file.read(32 * count + _CHUNK)  # bytes of a number with blanks, many more than it has
    words = content.split()
    if len(words) != count:
        raise Fault(f"has {len(words):,} numbers, but its header says {count:,} voxels", "Is the file complete?")
    try:
        numbers = np.array(words, dtype=np.float64)
        if kind.kind in "iu" and not (np.iinfo(kind).min <= numbers.min() <= numbers.max() <= np.iinfo(kind).max):
            raise ValueError("they are beyond their type")
    except ValueError as error:
        raise Fault(f"its numbers cannot be read: {error}") from None
    return numbers.astype(kind) if np.array_equal(numbers, np.rint(numbers)) else numbers
