"""Whether files of surfaces are whole: VTK crashes on some that are cut, and passes over others."""

import re
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hpcinv.base.reading.door import admitted
from hpcinv.base.reading.fault import Fault
from hpcinv.base.reading.suffix import suffix_of

_IS_IT_COMPLETE = "Is the file complete?"
_NUMBER = rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_BLANKS = rb"[ \t]+"
_POINT = _BLANKS + _NUMBER + _BLANKS + _NUMBER + _BLANKS + _NUMBER
_STL_HEAD, _STL_TRIANGLE = 84, 50  # bytes


def check_structure(path: Path) -> int | None:
    """Raise ``Fault`` for a file that is cut or has other entries than it says; return its number of polygons."""
    check = {".stl": _check_stl, ".ply": _check_ply, ".obj": _check_obj, ".vtk": _check_vtk}.get(suffix_of(path))
    return check(admitted(path).read_bytes()) if check else None


def _check_stl(content: bytes) -> int | None:
    if len(content) >= _STL_HEAD:
        count = struct.unpack_from("<I", content, 80)[0]
        if len(content) == (expected := _STL_HEAD + _STL_TRIANGLE * count):
            return None  # degenerate ones are left out by VTK
    if not content[:512].lstrip().lower().startswith(b"solid"):
        if len(content) < _STL_HEAD:
            raise Fault("ends in its header", _IS_IT_COMPLETE)
        text = f"has {len(content):,} bytes, but its header says {count:,} triangles, which take {expected:,}"
        raise Fault(text, _IS_IT_COMPLETE)
    facets, ends = _count(rb"facet[ \t]", content), _count(rb"endfacet\s", content)
    vertices, lines = _count(rb"vertex\b", content), _count(rb"vertex" + _POINT + rb"[ \t\r]*$", content)
    if not re.search(rb"(?i)(?:^|\n)[ \t]*endsolid[^\n]*\s*\Z", content):
        raise Fault("does not end with 'endsolid'", _IS_IT_COMPLETE)
    if not facets == ends == lines / 3 == vertices / 3:
        raise Fault(f"has {facets:,} facets ({ends:,} end) and {lines:,} vertices", _IS_IT_COMPLETE)
    return None


def _count(pattern: bytes, content: bytes) -> int:
    """Number of lines that begin with a pattern."""
    return sum(1 for _ in re.finditer(rb"(?im)^[ \t]*" + pattern, content))


_OBJ_WORDS = (
    *("v", "vt", "vn", "vp", "f", "fo", "l", "p", "o", "g", "s", "mg", "usemtl", "mtllib", "usemap", "maplib"),
    *("cstype", "deg", "bmat", "step", "curv", "curv2", "surf", "parm", "trim", "hole", "scrv", "sp", "end", "con"),
    *("bevel", "c_interp", "d_interp", "lod", "shadow_obj", "trace_obj", "ctech", "stech", "call", "csh"),
)


def _check_obj(content: bytes) -> int:
    content = content.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")  # lines that go on
    words = re.findall(rb"(?m)^[ \t]*([^\s#\\]+)", content)
    if unknown := {*words} - {word.encode() for word in _OBJ_WORDS}:
        raise Fault(f"has lines that begin with '{min(unknown)[:40].decode('latin-1')}': is it an OBJ file?")
    points = sum(word == b"v" for word in words)
    whole = _count(rb"v" + _POINT + rb"(?:" + _BLANKS + _NUMBER + rb")*[ \t\r]*(?:#[^\n]*)?$", content)
    if points != whole:
        raise Fault(f"has {points:,} vertices; {points - whole:,} of them are not three numbers", _IS_IT_COMPLETE)
    return sum(word == b"f" for word in words)


_VTK_TYPES = {
    **dict.fromkeys(("char", "unsigned_char", "vtktypeint8", "vtktypeuint8"), 1),
    **dict.fromkeys(("short", "unsigned_short", "vtktypeint16", "vtktypeuint16"), 2),
    **dict.fromkeys(("int", "unsigned_int", "float", "vtktypeint32", "vtktypeuint32"), 4),
    **dict.fromkeys(("long", "unsigned_long", "double", "vtktypeint64", "vtktypeuint64", "vtkidtype"), 8),
}
"""bytes of the types of numbers"""
_VTK_BLOCK = re.compile(
    rb"(?:POINTS[ \t]+(?P<points>\d{1,12})[ \t]+(?P<type>\w+)"
    rb"|(?:VERTICES|LINES|POLYGONS|TRIANGLE_STRIPS|CELLS)[ \t]+(?P<cells>\d{1,12})[ \t]+(?P<size>\d{1,12}))[ \t\r]*\n"
)
_VTK_ARRAY = re.compile(rb"(OFFSETS|CONNECTIVITY)[ \t]+(\w+)[ \t\r]*\n")


def _check_vtk(content: bytes) -> None:
    """Check that in a binary file a line ends after the bytes of points and cells: VTK goes on anywhere."""
    head = content.split(b"\n", 4)
    if len(head) < 4 or head[2].strip().upper() != b"BINARY":
        return
    place = 0
    while block := _VTK_BLOCK.search(content, place):
        place = block.end()
        if block["points"] is not None:
            place = _block_end(content, place, 3 * int(block["points"]), block["type"])
        elif array := _VTK_ARRAY.match(content, place):  # since version 5
            for count in (int(block["cells"]), int(block["size"])):
                if array is not None:
                    place = _block_end(content, array.end(), count, array[2])
                    array = _VTK_ARRAY.match(content, place)
        else:
            place = _block_end(content, place, int(block["size"]), b"int")


def _block_end(content: bytes, place: int, count: int, kind: bytes) -> int:
    """Place after numbers and the end of the line."""
    end = place + count * _VTK_TYPES.get(kind.decode("latin-1").lower(), 0)
    if content[end : end + 1] != b"\n":
        raise Fault("has other numbers than its header says", _IS_IT_COMPLETE)
    return end + 1


_PLY_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}


@dataclass
class _Element:
    """Entries of a PLY file of one kind.

    Attributes:
        kinds: of the properties: type of a number, or types of a list's length and of its numbers.
    """

    name: str
    count: int
    names: list[str]
    kinds: list[tuple[str, ...]]


def _check_ply(content: bytes) -> int:
    head, mark, body = content.partition(b"end_header")
    begin = body.find(b"\n") + 1
    if not content.startswith(b"ply") or not mark or not begin or len(head) > 1 << 20:
        raise Fault("has no header of PLY", _IS_IT_COMPLETE)
    form, elements = _ply_header(head)
    if form not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise Fault(f"has the format '{form[:40]}', which is not one of PLY")
    named = _named_elements(elements)
    if form == "ascii":
        _check_ply_text(body[begin:], elements)
    else:
        _check_ply_bytes(memoryview(body)[begin:], elements, "<" if "little" in form else ">")
    return named["face"].count if "face" in named else 0


def _named_elements(elements: list[_Element]) -> dict[str, _Element]:
    """Return the elements by their names; ``Fault`` if they have no vertices, or contradict themselves."""
    named = {element.name: element for element in elements}
    if "vertex" not in named or not {"x", "y", "z"} <= {*named["vertex"].names}:
        raise Fault("has no vertices with x, y and z")
    if len(named) < len(elements) or min(element.count for element in elements) < 0:
        raise Fault("has a header that contradicts itself")
    return named


def _ply_header(head: bytes) -> tuple[str, list[_Element]]:
    """Return the format and the elements that a header says."""
    form, elements = "", list[_Element]()
    for line in head.decode("latin-1").splitlines()[1:]:
        words = line.split()
        try:
            match words:
                case ["format", form, _]:
                    pass
                case ["element", name, count]:
                    elements.append(_Element(name, int(count), [], []))
                case ["property", "list", length, kind, name]:
                    elements[-1].names.append(name)
                    elements[-1].kinds.append((_PLY_TYPES[length], _PLY_TYPES[kind]))
                case ["property", kind, name]:
                    elements[-1].names.append(name)
                    elements[-1].kinds.append((_PLY_TYPES[kind],))
                case [] | ["comment" | "obj_info", *_]:
                    pass
                case _:
                    raise ValueError
        except (ValueError, KeyError, IndexError):
            raise Fault(f"has the line '{line[:60]}' in its header, which is not one of PLY") from None
    return form, elements


def _check_ply_text(body: bytes, elements: list[_Element]) -> None:
    lines = [words for line in body.split(b"\n") if (words := line.split())]
    if len(lines) != (expected := sum(element.count for element in elements)):
        raise Fault(f"has {len(lines):,} lines of numbers, but its header says {expected:,}", _IS_IT_COMPLETE)
    start = 0
    for element in elements:
        for words in lines[start : start + element.count]:
            place = 0
            try:
                for kinds in element.kinds:
                    place += 1 if len(kinds) == 1 else 1 + int(words[place])
                is_whole = place == len(words) and all(map(_is_number, words))
            except (ValueError, IndexError):
                is_whole = False
            if not is_whole:
                text = b" ".join(words)[:60].decode("latin-1")
                raise Fault(f"has the line '{text}', which is not one of '{element.name}'", _IS_IT_COMPLETE)
        start += element.count


def _is_number(word: bytes) -> bool:
    """Whether it is a number, or one that is not finite: other properties than coordinates may be."""
    return re.fullmatch(_NUMBER, word) is not None or word.lower().lstrip(b"+-") in (b"nan", b"inf")


def _check_ply_bytes(body: memoryview, elements: list[_Element], order: str) -> None:
    place = 0
    for element in elements:
        kinds = [[np.dtype(order + kind) for kind in kinds] for kinds in element.kinds]
        if all(len(kind) == 1 for kind in kinds):
            place += element.count * sum(kind[0].itemsize for kind in kinds)
        else:
            place = _equal_lists_end(body, place, element.count, kinds) or _lists_end(body, place, element.count, kinds)
        if place > len(body):
            break
    if place != len(body):
        extent = "more than" if place > len(body) else "other than"
        raise Fault(f"has {len(body):,} bytes of numbers; its header says {extent} these", _IS_IT_COMPLETE)


def _equal_lists_end(body: memoryview, place: int, count: int, kinds: list[list[np.dtype[Any]]]) -> int | None:
    """Place after entries that are one list of the same length each, as triangles are; ``None`` if they are not."""
    if len(kinds) != 1 or not count or place + kinds[0][0].itemsize > len(body):
        return None
    length, number = kinds[0]
    first = int(np.frombuffer(body, length, 1, place)[0])
    size = length.itemsize + first * number.itemsize
    if first < 0 or place + count * size > len(body):
        return None
    table = np.frombuffer(body, np.uint8, count * size, place).reshape(count, size)[:, : length.itemsize]
    is_same = (np.ascontiguousarray(table).view(length) == first).all()
    return place + count * size if is_same else None


def _lists_end(body: memoryview, place: int, count: int, kinds: list[list[np.dtype[Any]]]) -> int:
    for _ in range(count):
        for kind in kinds:
            if place + kind[0].itemsize > len(body):
                return len(body) + 1
            if len(kind) == 2:
                place += int(np.frombuffer(body, kind[0], 1, place)[0]) * kind[1].itemsize
            place += kind[0].itemsize
    return place
