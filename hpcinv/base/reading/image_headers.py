"""Headers of MetaImage and NRRD files: sizes of the grid, where its voxels are, and how they are written.

Sources: https://itk.org/Wiki/MetaIO/Documentation and https://teem.sourceforge.net/nrrd/format.html
"""

import gzip
import math
import os
import re
import stat
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Literal, cast

from hpcinv.base.reading.door import admitted
from hpcinv.base.reading.fault import Fault
from hpcinv.base.reading.suffix import METAIMAGE, NRRD, suffix_of

type Reals = tuple[float, ...]
type Encoding = Literal["raw", "zlib", "gzip", "bzip2", "text", "hex"]

_MOST_BYTES = 1 << 20  # of a header; larger ones take seconds to parse
_MOST_LINES = 10_000  # of a header, likewise
_MOST_FILES = 10_000  # that one header names; each of them is opened
_AGAIN = "Write the image again by the program that made it."


@dataclass(frozen=True)
class Source:
    """Where the voxels of an image are.

    Attributes:
        names: files that the header names, in the order of slices; empty if voxels follow the header.
        how: how it names them.
    """

    names: tuple[str, ...] = ()
    how: Literal["no file", "a file", "a pattern of names", "a list of names"] = "no file"


@dataclass(frozen=True)
class ImageHeader:
    """What a header says.

    Attributes:
        type: code of numbers for NumPy, with their byte order.
        spacing: of voxels along each axis of the grid.
        axes: directions of the grid's axes, one row each.
        origin: middle of the first voxel in LPS.
        skip: bytes before the voxels; -1 if these end with the file.
        skipped_lines: lines before the voxels.
        names: numbers of the segments by their names, if the format has them.
    """

    shape: tuple[int, ...]
    type: str
    spacing: Reals
    axes: tuple[Reals, ...]
    origin: Reals
    encoding: Encoding
    source: Source
    skip: int = 0
    skipped_lines: int = 0
    names: Mapping[str, int] = field(default_factory=dict)


def check_regular(path: Path) -> None:
    """Raise ``Fault`` for a pipe or a device: reading it may wait for ever, or change something."""
    if not stat.S_ISREG(path.stat().st_mode):
        raise Fault("is not a regular file", "Copy its content into a file.")


def opened(path: Path) -> IO[bytes]:
    """Open a regular file, through gzip if its name ends so."""
    check_regular(path)
    return cast("IO[bytes]", gzip.open(admitted(path))) if suffix_of(path) == ".gz" else admitted(path).open("rb")


def format_of(path: Path) -> str:
    """Suffix of the format of an image, without the one of its compression."""
    return suffix_of(path.stem) if suffix_of(path) == ".gz" else suffix_of(path)


def source_of(path: Path) -> Source:
    """Files with voxels that the header of an image names; none for formats whose files stand alone."""
    with opened(path) as file:
        if format_of(path) in METAIMAGE:
            return _metaimage_source(*_metaimage_fields(file))
        return _nrrd_source(*_nrrd_fields(file)) if format_of(path) in NRRD else Source()


def read_header(path: Path, file: IO[bytes]) -> ImageHeader:
    """Read the header of a MetaImage or NRRD file, up to its voxels."""
    return read_metaimage(file) if format_of(path) in METAIMAGE else read_nrrd(file)


def _line(file: IO[bytes], read: list[int]) -> str | None:
    """Next line of a header, ``None`` at the end of the file; ``read`` counts bytes and lines."""
    line = file.readline(_MOST_BYTES - read[0] + 1)
    read[0] += len(line)
    read[1] += 1
    if read[0] > _MOST_BYTES or read[1] > _MOST_LINES:
        raise Fault(f"its header has more than {_MOST_BYTES:,} bytes or {_MOST_LINES:,} lines", _AGAIN)
    return line.decode("latin-1").rstrip("\r\n") if line else None


def _names(lines: list[str]) -> tuple[str, ...]:
    """Names of files in their encoding by the system."""
    return tuple(os.fsdecode(line.strip().encode("latin-1")) for line in lines if line.strip())


def _rest_of_list(file: IO[bytes], read: list[int]) -> list[str]:
    lines = []
    while (line := _line(file, read)) is not None:
        lines.append(line)
    return lines


def _once(fields: dict[str, str], key: str, value: str) -> None:
    if fields.setdefault(key, value) != value:
        raise Fault(f"its header has two values of '{key}'", _AGAIN)


def _numbers(fields: Mapping[str, str], key: str, count: int | None = None) -> Reals:
    try:
        values = tuple(float(word) for word in fields[key].split())
    except ValueError:
        values = (math.nan,)
    if not all(map(math.isfinite, values)) or (count is not None and len(values) != count):
        expected = "numbers" if count is None else f"{count} numbers"
        raise Fault(f"'{key}' in its header is '{fields[key][:60]}', not {expected}", _AGAIN)
    return values


def _whole_numbers(fields: Mapping[str, str], key: str, count: int | None = None) -> tuple[int, ...]:
    values = _numbers(fields, key, count)
    if any(value != int(value) or abs(value) > 1e15 for value in values):
        raise Fault(f"'{key}' in its header is '{fields[key][:60]}', not whole numbers", _AGAIN)
    return tuple(map(int, values))


def _shape(fields: Mapping[str, str], key: str, count: int) -> tuple[int, ...]:
    shape = _whole_numbers(fields, key, count)
    if not shape or min(shape) < 1:
        raise Fault(f"'{key}' in its header is '{fields[key][:60]}', not numbers of voxels", _AGAIN)
    return shape


def _needed(fields: Mapping[str, str], *keys: str) -> str:
    """The one of these keys that a header has."""
    for key in keys:
        if key in fields:
            return key
    raise Fault(f"its header does not say '{keys[0]}'", _AGAIN)


# MetaImage

_METAIMAGE_TYPES = {
    "MET_CHAR": "i1",
    "MET_UCHAR": "u1",
    "MET_SHORT": "i2",
    "MET_USHORT": "u2",
    "MET_INT": "i4",
    "MET_UINT": "u4",
    "MET_LONG": "i4",
    "MET_ULONG": "u4",
    "MET_LONG_LONG": "i8",
    "MET_ULONG_LONG": "u8",
    "MET_FLOAT": "f4",
    "MET_DOUBLE": "f8",
}


def _metaimage_fields(file: IO[bytes]) -> tuple[dict[str, str], list[str]]:
    """Fields up to the name of the data file, and the lines of a list of files."""
    fields, read = dict[str, str](), [0, 0]
    while (line := _line(file, read)) is not None:
        key, separator, value = (part.strip() for part in line.partition("="))
        if not separator and key:
            key, separator, value = (part.strip() for part in line.partition(":"))
        if not separator and key:
            raise Fault("has a line without '=' in its header: is it a MetaImage?")
        _once(fields, key, value)
        if key == "ElementDataFile":
            return fields, _rest_of_list(file, read) if value.startswith("LIST") else []
    raise Fault("its header does not say 'ElementDataFile': is it a MetaImage?", "Is the file complete?")


def _metaimage_source(fields: Mapping[str, str], more: list[str]) -> Source:
    value = fields["ElementDataFile"]
    if value.upper() == "LOCAL":
        return Source()
    if value.startswith("LIST"):
        return Source(_names(more)[:_MOST_FILES], "a list of names")
    if "%" in value:
        last = fields.get("DimSize", "").split()[-1:] or [""]
        return Source(_expanded(value.split(), ["1", *last, "1"]), "a pattern of names")
    return Source(_names([value]), "a file")


def _expanded(words: list[str], defaults: list[str]) -> tuple[str, ...]:
    """Names of files that follow a pattern of C, such as ``slice%03d.raw 1 40 1``."""
    pattern, bounds = words[0], [*words[1:], *defaults[len(words) - 1 :]]
    try:
        first, last, step = (int(word) for word in bounds[:3])
    except ValueError:
        raise Fault(f"names its files by the pattern '{pattern[:60]}' without their numbers", _AGAIN) from None
    if not re.fullmatch(r"[^%]*%0?\d{0,2}d[^%]*", pattern) or step == 0 or abs(last - first) > _MOST_FILES:
        raise Fault(f"names its files by '{' '.join(words)[:60]}', which is not a pattern of numbers", _AGAIN)
    return _names([pattern % number for number in range(first, last + (1 if step > 0 else -1), step)])


def read_metaimage(file: IO[bytes]) -> ImageHeader:
    """Read the header of a MetaImage."""
    fields, more = _metaimage_fields(file)
    count = _whole_numbers(fields, _needed(fields, "NDims"), 1)[0]
    shape = _shape(fields, _needed(fields, "DimSize"), count)
    kind = fields[_needed(fields, "ElementType")]
    if kind not in _METAIMAGE_TYPES:
        raise Fault(f"'ElementType' in its header is '{kind[:60]}', not a type of numbers", _AGAIN)
    if (channels := fields.get("ElementNumberOfChannels", "1")) != "1":
        raise Fault(f"has {channels[:20]} numbers in each voxel", "Give a segmentation, with one number in each voxel.")
    identity = [float(i % (count + 1) == 0) for i in range(count**2)]
    rows = _numbers_of(fields, ("TransformMatrix", "Rotation", "Orientation"), identity)
    order = fields.get("BinaryDataByteOrderMSB", fields.get("ElementByteOrderMSB", "False"))
    encoding: Encoding = "zlib" if _is_true(fields, "CompressedData", "False") else "raw"
    if not _is_true(fields, "BinaryData", "True"):
        encoding = "text"
    return ImageHeader(
        shape,
        (">" if _truth("BinaryDataByteOrderMSB", order) else "<") + _METAIMAGE_TYPES[kind],
        _numbers(fields, _needed(fields, "ElementSpacing", "ElementSize"), count),
        tuple(tuple(rows[i * count : (i + 1) * count]) for i in range(count)),
        _numbers_of(fields, ("Offset", "Origin", "Position"), [0.0] * count),
        encoding,
        _metaimage_source(fields, more),
        _whole_numbers(fields, "HeaderSize", 1)[0] if "HeaderSize" in fields else 0,
    )


def _numbers_of(fields: Mapping[str, str], keys: Sequence[str], default: Sequence[float]) -> tuple[float, ...]:
    """Return the numbers at the first of several keys that is there, as many as in ``default``."""
    key = next((key for key in keys if key in fields), None)
    return tuple(default if key is None else _numbers(fields, key, len(default)))


def _is_true(fields: Mapping[str, str], key: str, default: str) -> bool:
    return _truth(key, fields.get(key, default))


def _truth(key: str, value: str) -> bool:
    if value[:1] not in "TtFf01" or not value:
        raise Fault(f"'{key}' in its header is '{value[:60]}', not True or False", _AGAIN)
    return value[:1] in "Tt1"


# NRRD

_NRRD_TYPES = {
    "i1": "signed char, int8, int8_t",
    "u1": "uchar, unsigned char, uint8, uint8_t",
    "i2": "short, short int, signed short, signed short int, int16, int16_t",
    "u2": "ushort, unsigned short, unsigned short int, uint16, uint16_t",
    "i4": "int, signed int, int32, int32_t",
    "u4": "uint, unsigned int, uint32, uint32_t",
    "i8": "longlong, long long, long long int, signed long long, signed long long int, int64, int64_t",
    "u8": "ulonglong, unsigned long long, unsigned long long int, uint64, uint64_t",
    "f4": "float",
    "f8": "double",
}
_NRRD_ENCODINGS: Mapping[str, Encoding] = {
    "raw": "raw",
    "gzip": "gzip",
    "gz": "gzip",
    "bzip2": "bzip2",
    "bz2": "bzip2",
    "txt": "text",
    "text": "text",
    "ascii": "text",
    "hex": "hex",
}
_FLIPS = {  # of x and y to LPS
    "right-anterior-superior": (-1.0, -1.0, 1.0),
    "ras": (-1.0, -1.0, 1.0),
    "left-anterior-superior": (1.0, -1.0, 1.0),
    "las": (1.0, -1.0, 1.0),
}


_OF_PROGRAM = ":="
"""prefix of keys that programs have added to a header"""
_SEGMENT = re.compile(re.escape(_OF_PROGRAM) + r"(Segment\d+)_Name")


def _segment_names(fields: Mapping[str, str]) -> dict[str, int]:
    """Numbers of the segments that 3D Slicer names, without names of several segments.

    Raises:
        Fault: the number of a segment is missing, or is not a whole number.
    """
    numbers = dict[str, list[int]]()
    for key, name in fields.items():
        if match := _SEGMENT.fullmatch(key):
            value = _needed(fields, f"{_OF_PROGRAM}{match[1]}_LabelValue")
            numbers.setdefault(name.strip(), []).append(_whole_numbers(fields, value, 1)[0])
    return {name: values[0] for name, values in numbers.items() if len(values) == 1}


def _nrrd_fields(file: IO[bytes]) -> tuple[dict[str, str], list[str]]:
    """Fields of the header, without blanks in their names, and the lines of a list of files."""
    fields, read = dict[str, str](), [0, 0]
    if not re.fullmatch(r"NRRD000[1-5]\s*", _line(file, read) or ""):
        raise Fault("its first line is not one of NRRD")
    while line := _line(file, read):
        if line.startswith("#"):
            continue
        if ":=" in line:  # data of programs
            key, _, value = line.partition(":=")
            fields[_OF_PROGRAM + key] = value
            continue
        key, separator, value = (part.strip() for part in line.partition(":"))
        if not separator:
            raise Fault("has a line without ':' in its header: is it NRRD?", _AGAIN)
        key = key.lower().replace(" ", "")
        _once(fields, key, value)
        if key == "datafile" and value.startswith("LIST"):
            return fields, _rest_of_list(file, read)
    return fields, []


def _nrrd_source(fields: Mapping[str, str], more: list[str]) -> Source:
    value = fields.get("datafile")
    if value is None:
        return Source()
    if value.startswith("LIST"):
        return Source(_names(more)[:_MOST_FILES], "a list of names")
    if "%" in value:
        return Source(_expanded(value.split()[:4], []), "a pattern of names")
    return Source(_names([value]), "a file")


def _nrrd_numbers(fields: Mapping[str, str]) -> tuple[str, Encoding]:
    """Return numpy's code of the type of numbers, and how they are written."""
    kind = fields[_needed(fields, "type")].lower()
    code = next((code for code, names in _NRRD_TYPES.items() if kind in names.split(", ")), None)
    if code is None:
        raise Fault(f"'type' in its header is '{kind[:60]}', not a type of numbers", _AGAIN)
    encoding = fields[_needed(fields, "encoding")].lower()
    if encoding not in _NRRD_ENCODINGS:
        raise Fault(f"'encoding' in its header is '{encoding[:60]}', which is not known", _AGAIN)
    form = _NRRD_ENCODINGS[encoding]
    if code[1:] == "1" or form == "text":
        return code, form
    endian = fields[_needed(fields, "endian")].lower()
    if endian not in ("little", "big"):
        raise Fault(f"'endian' in its header is '{endian[:60]}', not little or big", _AGAIN)
    return (">" if endian == "big" else "<") + code, form


def _nrrd_axes(fields: Mapping[str, str], count: int, flip: Reals) -> tuple[Reals, tuple[Reals, ...]]:
    """Return the size of voxels along each axis, and the axes."""
    if "spacedirections" not in fields:
        spacing = _numbers(fields, _needed(fields, "spacings"), count)
        return spacing, ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    rows = [_vector(fields, "spacedirections", text) for text in _vectors(fields["spacedirections"])]
    if len(rows) != count:
        raise Fault(f"'space directions' in its header has {len(rows)} directions", _AGAIN)
    spacing = tuple(math.hypot(*row) for row in rows)
    axes = tuple(
        tuple(f * x / (length or 1.0) for f, x in zip(flip, row, strict=True))
        for row, length in zip(rows, spacing, strict=True)
    )
    return spacing, axes


def _nrrd_origin(fields: Mapping[str, str], count: int, spacing: Reals, flip: Reals) -> Reals:
    """Return the middle of the first voxel."""
    origin: Reals = (0.0, 0.0, 0.0)
    if "axismins" in fields and "nan" not in fields["axismins"].lower():
        centred = [*fields.get("centers", fields.get("centerings", "")).split(), *("cell",) * 3]
        mins = zip(_numbers(fields, "axismins", count), spacing, centred, strict=False)
        origin = tuple(low + (0.0 if where == "node" else 0.5 * size) for low, size, where in mins)
    if "spaceorigin" in fields:
        position = _vector(fields, "spaceorigin", fields["spaceorigin"])
        origin = tuple(f * x for f, x in zip(flip, position, strict=True))
    return origin


def read_nrrd(file: IO[bytes]) -> ImageHeader:
    """Read the header of a NRRD file, up to the empty line after it."""
    fields, more = _nrrd_fields(file)
    count = _whole_numbers(fields, _needed(fields, "dimension"), 1)[0]
    shape = _shape(fields, _needed(fields, "sizes"), count)
    code, form = _nrrd_numbers(fields)
    if count != 3:
        advice = "Give one number in each voxel, in three dimensions, such as one time of a series."
        if any(map(_SEGMENT.fullmatch, fields)):
            advice = "Segments overlap: export them from 3D Slicer as a label map, or remove the overlap."
        raise Fault(f"has {count} dimensions, or several numbers in each voxel", advice)
    flip = _FLIPS.get(fields.get("space", "").lower(), (1.0, 1.0, 1.0))
    spacing, axes = _nrrd_axes(fields, count, flip)
    origin = _nrrd_origin(fields, count, spacing, flip)
    bytes_skipped, lines_skipped = (
        _whole_numbers(fields, key, 1)[0] if key in fields else 0 for key in ("byteskip", "lineskip")
    )
    source, names = _nrrd_source(fields, more), _segment_names(fields)
    return ImageHeader(shape, code, spacing, axes, origin, form, source, bytes_skipped, lines_skipped, names)


def _vectors(text: str) -> list[str]:
    return re.findall(r"\([^()]*\)|none", text)


def _vector(fields: Mapping[str, str], key: str, text: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(word) for word in text.strip("()").split(","))
    except ValueError:
        x = y = z = math.nan
    if not math.isfinite(x + y + z):
        raise Fault(f"'{key}' in its header is '{fields[key][:60]}', not vectors of three numbers", _AGAIN)
    return x, y, z
