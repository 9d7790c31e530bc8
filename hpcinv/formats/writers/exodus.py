"""Exodus II, read and written as netCDF with 64-bit offsets."""

from pathlib import Path
from typing import Any

import numpy as np

from hpcinv.base.reading.exodus_files import BRICK, SIDES
from hpcinv.formats.readers.elements import check_numbers, disjoint_parts, elements_of, faces_of
from hpcinv.mesh.cells import vertex_count
from hpcinv.mesh.source import Floats, MeshSource

_NAMES = {4: "TETRA4", 10: "TETRA10", 8: "HEX8", 20: "HEX20", 27: "HEX27"}
_VERSION = np.float32(5.1)
_LINE = 81  # characters of a line, by the format


def save_exodus(path: Path, source: MeshSource, points: Floats) -> None:
    """Write nodes, blocks and side sets at ``points`` (n, 3); regions that overlap others are element sets.

    Elements are in the order of their blocks, with their own numbers.

    Raises:
        OSError: it cannot be written.
    """
    from scipy.io import netcdf_file

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
        file.api_version = file.version = _VERSION
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
