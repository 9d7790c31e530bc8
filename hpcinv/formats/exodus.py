"""Exodus II (``.e``, ``.exo``, ``.ex2``): nodes, blocks of solid elements, side sets and node sets.

The file is netCDF: classic, which SciPy reads, or version 4, which is HDF5. Source: Schoof and Yarberry, *EXODUS II: A
Finite Element Data Model* (SAND92-2137).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpcinv.base.reading.door import admitted
from hpcinv.base.reading.fault import Fault, shown
from hpcinv.base.reading.hdf5_arrays import array_in, opened
from hpcinv.base.reading.mesh_format import Later, MeshFormat
from hpcinv.base.reading.numbered_elements import Blocks, element_arrays, vertices_of

if TYPE_CHECKING:
    import numpy as np

    from hpcinv.mesh.source import Floats, MeshSource
else:
    np = Later("numpy")


class Exodus(MeshFormat):
    suffix = ".e"
    other_suffixes = (".exo", ".ex2", ".g")
    action = "exodus"
    elements = "Exodus II"
    saver = "hpcinv.formats.exodus:save_exodus"
    saves_27_nodes = "if read"


SIDES = {4: (1, 2, 3, 0), 8: (2, 3, 4, 5, 0, 1)}
"""number of the face of an element as input files count, by its side in Exodus, from 0"""
BRICK = {20: (*range(12), *range(16, 20), *range(12, 16))}
"""places of the nodes in the file: middle nodes of upright edges come before the nodes of top edges"""
BRICK[27] = (*BRICK[20], 20, 21, 22, 25, 24, 26, 23)
_KINDS = "TETRA4, TETRA10, HEX8, HEX20 and HEX27"
_SIZES = {"TET": (4, 10), "HEX": (8, 20, 27)}
_FLAT = ("TRI", "QUAD", "SHELL", "BAR", "BEAM", "TRUSS", "EDGE", "SPHERE", "CIRCLE", "POINT")


class _Variables:
    """Arrays of a netCDF file and their attributes, whatever the version."""

    def __init__(self, names: Any, array: Callable[[str], Any], attribute: Callable[[str, str], Any]) -> None:
        self.names, self.array, self._attribute = frozenset(names), array, attribute

    def text(self, name: str, attribute: str) -> str:
        value = self._attribute(name, attribute)
        return value.decode("latin-1") if isinstance(value, bytes) else str(value)

    def numbers(self, name: str) -> list[int]:
        values = self.array(name)
        if values.ndim != 1 or values.dtype.kind not in "iu":
            raise Fault(f"'{shown(name)}' is not a list of whole numbers", "Is the file complete?")
        return [int(value) for value in values]


def read_exodus(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return arrays of nodes, elements and sets; ``ignored`` are values at nodes and in elements."""
    with _variables(path) as data:
        points = _points(data)
        tags = np.array(_numbered(data, "node_num_map", len(points), "nodes"), dtype=np.int64)
        blocks, sets = Blocks(), dict[str, list[int]]()
        every, sizes = _read_blocks(data, tags, blocks, sets)
        for name, at in _named(data, "ns", "nodeset", "node_ns"):
            rows = data.array(f"node_ns{at}")
            sets[f"nodes:{name}"] = tags[_valid(rows, len(tags), f"node set '{shown(name)}'")].tolist()
        for name, at in _named(data, "els", "elemset", "elem_els"):
            rows = _valid(data.array(f"elem_els{at}"), len(every), f"element set '{shown(name)}'")
            sets[f"cells:{name}"] = [every[row] for row in rows.tolist()]
        faces = dict[str, list[tuple[int, int]]]()
        for name, at in _named(data, "ss", "sideset", "elem_ss"):
            faces.setdefault(name, []).extend(_faces(data, at, f"side set '{shown(name)}'", every, sizes))
        ignored = ["results"] if any(name.startswith(("vals_nod_var", "vals_elem_var")) for name in data.names) else []
    arrays = element_arrays(tags, points, blocks, sets, _KINDS)
    row_of = {int(tag): row for row, tag in enumerate(arrays["cell_tags"])}
    for name, pairs in faces.items():
        if pairs:
            arrays[f"faces:{name}"] = np.unique([(row_of[tag], face) for tag, face in pairs], axis=0)
    return {"ignored": ignored}, arrays


def _faces(data: _Variables, at: int, owner: str, every: Any, sizes: list[int]) -> Iterator[tuple[int, int]]:
    """Yield numbers of the solid elements of a side set, and of their faces.

    Args:
        every, sizes: numbers of all elements and of their vertices.
    """
    rows, sides = _valid(data.array(f"elem_ss{at}"), len(every), owner), data.numbers(f"side_ss{at}")
    if len(rows) != len(sides):
        raise Fault(f"{owner} has {len(rows)} elements and {len(sides)} sides")
    for row, side in zip(rows.tolist(), sides, strict=True):
        local = SIDES.get(sizes[row], ())
        if local and not 1 <= side <= len(local):
            raise Fault(f"{owner}: element {every[row]} has no side {side}")
        if local:
            yield every[row], local[side - 1]


def _read_blocks(data: _Variables, tags: Any, blocks: Blocks, sets: dict[str, list[int]]) -> tuple[Any, list[int]]:
    """Read the elements; return number and number of vertices (0: not solid) of each in the order of the file."""
    listed = list(_named(data, "eb", "block", "connect"))
    if not listed:
        raise Fault("has no blocks of elements", f"Elements are {_KINDS}.")
    tables = [data.array(f"connect{at}") for _, at in listed]
    if any(table.ndim != 2 for table in tables):
        raise Fault("has elements of varying numbers of nodes", f"Elements are {_KINDS}.")
    count = sum(len(table) for table in tables)
    numbers = _numbered(data, "elem_num_map", count, "elements")
    sizes: list[int] = []
    start = 0
    for (name, at), table in zip(listed, tables, strict=True):
        kind = data.text(f"connect{at}", "elem_type").upper()
        own = numbers[start : start + len(table)]
        start += len(table)
        nodes = tags[_valid(table, len(tags), f"block '{shown(name)}'")].tolist()
        vertices = _vertices_of_kind(kind, table.shape[1], name)
        sizes += [vertices] * len(table)
        for tag, entry in zip(own, nodes, strict=True):
            if not vertices:
                blocks.add_facet(tag, vertices_of(entry), name)
            else:
                blocks.add(tag, [entry[i] for i in BRICK.get(len(entry), range(len(entry)))])
                sets.setdefault(f"cells:{name}", []).append(tag)
    return numbers, sizes


def _vertices_of_kind(kind: str, nodes: int, block: str) -> int:
    """Return the number of vertices of the elements of a block, 0 if they are not solid."""
    solid = next((allowed for prefix, allowed in _SIZES.items() if kind.startswith(prefix)), None)
    if solid is None and not kind.startswith(_FLAT):
        raise Fault(f"block '{shown(block)}' has elements {shown(kind)}", f"Elements are {_KINDS}.")
    if solid is not None and nodes not in solid:
        raise Fault(f"block '{shown(block)}' has elements {shown(kind)} of {nodes} nodes")
    return 0 if solid is None else solid[0]


def _points(data: _Variables) -> Any:
    names = ("coordx", "coordy", "coordz")
    if "coord" in data.names:
        points = np.asarray(data.array("coord"), dtype=np.float64).T
    else:
        columns = [np.asarray(data.array(name), dtype=np.float64) for name in names if name in data.names]
        if len({column.shape for column in columns}) > 1:
            raise Fault("has different numbers of coordinates x, y and z", "Is the file complete?")
        points = np.column_stack(columns) if columns else np.zeros((0, 0))
    if points.ndim != 2 or points.shape[1] != 3:
        raise Fault("has no coordinates in three dimensions", "Is it an Exodus file of a solid mesh?")
    return points


def _numbered(data: _Variables, name: str, count: int, what: str) -> Sequence[int]:
    """Return the numbers of nodes or elements, which count them if there is no list."""
    numbers = data.numbers(name) if name in data.names else range(1, count + 1)
    if len(numbers) != count:
        raise Fault(f"has {len(numbers):,} numbers of {count:,} {what}", "Is the file complete?")
    return numbers


def _named(data: _Variables, prefix: str, default: str, variable: str) -> Iterator[tuple[str, int]]:
    """Yield name and place, from 1, of each block or set that has members."""
    texts = data.array(f"{prefix}_names") if f"{prefix}_names" in data.names else np.zeros((0, 0), dtype="S1")
    numbers = data.numbers(f"{prefix}_prop1") if f"{prefix}_prop1" in data.names else []
    at = 1
    while at <= max(len(numbers), len(texts)) or f"{variable}{at}" in data.names:
        row = texts[at - 1] if at <= len(texts) else np.zeros(0, dtype="S1")
        name = b"".join(np.asarray(row, dtype="S1").ravel().tolist()).split(b"\0")[0].decode("utf-8", "replace").strip()
        if f"{variable}{at}" in data.names:
            yield shown(name) or f"{default}-{numbers[at - 1] if at <= len(numbers) else at}", at
        at += 1


def _valid(rows: Any, count: int, owner: str) -> Any:
    """Return rows from 0 of an array of rows from 1."""
    if rows.dtype.kind not in "iu":
        raise Fault(f"{owner} has entries that are not whole numbers", "Is the file complete?")
    wide = rows.astype(np.int64)
    if wide.size and (wide.min() < 1 or wide.max() > count):
        bad = wide[(wide < 1) | (wide > count)][0]
        raise Fault(f"{owner} has the entry {bad}, and there are {count:,}", "Is the file complete?")
    return wide - 1


@contextmanager
def _variables(path: Path) -> Iterator[_Variables]:
    with admitted(path).open("rb") as file:
        head = file.read(4)
    if head[:3] != b"CDF":
        with opened(path) as hdf5:
            yield _Variables(hdf5, lambda name: array_in(hdf5, name), lambda name, key: hdf5[name].attrs.get(key, ""))
        return
    if head[3] not in (1, 2):
        raise Fault(f"is netCDF of version {head[3]}", "Save it as 64-bit offset or netCDF-4.")
    from scipy.io import netcdf_file

    try:
        classic = netcdf_file(path, mmap=False)
        arrays = {name: np.array(entry[...]) for name, entry in classic.variables.items()}
    except MemoryError:
        raise
    except Exception:  # SciPy raises whatever damaged sizes cause
        raise Fault("is not a complete netCDF file", "Is the file complete?") from None

    def array(name: str) -> Any:
        if name not in arrays:
            raise Fault(f"has no array '{shown(name)}'", "Is it an Exodus file, and complete?")
        return arrays[name]

    yield _Variables(arrays, array, lambda name, key: getattr(classic.variables[name], key, ""))


_NAMES = {4: "TETRA4", 10: "TETRA10", 8: "HEX8", 20: "HEX20", 27: "HEX27"}
_VERSION = 5.1
_LINE = 81  # characters of a line, by the format


def save_exodus(path: Path, source: MeshSource, points: Floats) -> None:
    """Write nodes, blocks and side sets at ``points`` (n, 3); regions that overlap others are element sets.

    Elements are in the order of their blocks, with their own numbers.

    Raises:
        OSError: it cannot be written.
    """
    from scipy.io import netcdf_file

    from hpcinv.formats.readers.elements import check_numbers, disjoint_parts, elements_of, faces_of
    from hpcinv.mesh.cells import vertex_count

    check_numbers(source)
    elements = elements_of(source, has_27=True)
    used = np.unique(elements)
    row = np.searchsorted(used, elements) + 1
    part, blocks, others = disjoint_parts(source)
    names = [*(group.name for group in blocks), *["unnamed"] * bool((part < 0).any())]
    part = np.where(part < 0, len(blocks), part)
    order = np.argsort(part, kind="stable")
    place = np.argsort(order) + 1
    inverse = np.argsort(BRICK.get(elements.shape[1], range(elements.shape[1])))  # our order to the order of the file
    surfaces = [group for group in source.groups if group.dim == 2]
    with netcdf_file(path, "w", version=2) as file:
        file.api_version = file.version = np.float32(_VERSION)
        file.floating_point_word_size, file.file_size = np.int32(8), np.int32(1)
        file.title = "Written by hpcinv"
        longest = max(33, *(len(group.name.encode()) + 1 for group in source.groups), 0)
        file.createDimension("time_step", None)  # first, since it has no size
        for name, size in (("len_string", 33), ("len_line", _LINE), ("four", 4), ("len_name", longest), ("num_dim", 3)):
            file.createDimension(name, size)
        file.createVariable("time_whole", "d", ("time_step",))
        _add(file, "node_num_map", source.node_tags[used], ("num_nodes",))
        for axis, name in enumerate(("coordx", "coordy", "coordz")):
            _add(file, name, points[used, axis], ("num_nodes",))
        _add(file, "elem_num_map", source.cell_tags[order], ("num_elem",))
        _add_names(file, "eb", names, "num_el_blk", longest)
        for at in range(len(names)):
            rows = row[part == at][:, inverse]
            variable = _add(file, f"connect{at + 1}", rows, (f"num_el_in_blk{at + 1}", f"num_nod_per_el{at + 1}"))
            variable.elem_type = _NAMES[elements.shape[1]]
        _add_names(file, "ss", [group.name for group in surfaces], "num_side_sets", longest)
        sides = np.argsort(SIDES[vertex_count(source.kind)])
        for at, group in enumerate(surfaces, 1):
            pairs = np.array(list(faces_of(source, group, elements)), dtype=np.int64).reshape(-1, 2)
            _add(file, f"elem_ss{at}", place[pairs[:, 0]], (f"num_side_ss{at}",))
            _add(file, f"side_ss{at}", sides[pairs[:, 1]] + 1, (f"num_side_ss{at}",))
        _add_names(file, "els", [group.name for group in others], "num_elem_sets", longest)
        for at, group in enumerate(others, 1):
            _add(file, f"elem_els{at}", place[group.members], (f"num_ele_els{at}",))


def _add(file: Any, name: str, values: Any, dimensions: tuple[str, ...]) -> Any:
    """Add a variable with dimensions of its sizes, of 32-bit integers or doubles."""
    for dimension, size in zip(dimensions, values.shape, strict=True):
        if dimension not in file.dimensions:
            file.createDimension(dimension, size)
    variable = file.createVariable(name, "d" if values.dtype.kind == "f" else "i", dimensions)
    variable[:] = values if values.dtype.kind == "f" else values.astype(np.int32)
    return variable


def _add_names(file: Any, prefix: str, names: list[str], dimension: str, longest: int) -> None:
    if not names:
        return
    numbers = np.arange(1, len(names) + 1)
    _add(file, f"{prefix}_status", np.ones(len(names), dtype=np.int64), (dimension,))
    _add(file, f"{prefix}_prop1", numbers, (dimension,)).name = "ID"
    texts = np.zeros((len(names), longest), dtype="S1")
    for row, name in enumerate(names):
        content = name.encode()
        texts[row, : len(content)] = np.frombuffer(content, dtype="S1")
    variable = file.createVariable(f"{prefix}_names", "c", (dimension, "len_name"))
    variable[:] = texts
