"""MED files of Salome and code_aster (``.med``, HDF5): nodes, solid cells, and groups of cells, facets and nodes.

Solid cells have the opposite orientation of other programs. Source: *MED file format*, version 3 and 4; node orders:
*Salome MED documentation*, "Numbering of the connectivity".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpcinv.base.reading.fault import Fault, shown
from hpcinv.base.reading.hdf5_arrays import array_in, group_in, opened
from hpcinv.base.reading.mesh_format import Later, MeshFormat
from hpcinv.base.reading.numbered_elements import Blocks, element_arrays, vertices_of

if TYPE_CHECKING:
    import numpy as np

    from hpcinv.mesh.source import Floats, Ints, MeshSource
else:
    np = Later("numpy")


class Med(MeshFormat):
    suffix = ".med"
    action = "med"
    elements = "MED"
    saver = "hpcinv.formats.med:save_med"
    saves_27_nodes = "never"


MIRRORED = {
    4: (0, 2, 1, 3),
    10: (0, 2, 1, 3, 6, 5, 4, 7, 9, 8),
    8: (0, 3, 2, 1, 4, 7, 6, 5),
    20: (0, 3, 2, 1, 4, 7, 6, 5, 11, 10, 9, 8, 15, 14, 13, 12, 16, 19, 18, 17),
}
"""places of the nodes of a cell, and of a mirrored one"""
_COMPLETE = (*MIRRORED[20], 26, 20, 25, 24, 23, 22, 21)
"""the same of 27 nodes: bottom, sides by the edges of the bottom, top and centre, read as centre and faces S1 to S6"""
_SOLIDS = {"TE4": 4, "T10": 10, "HE8": 8, "H20": 20, "H27": 27}
_FLAT = {"TR3": 3, "TR6": 6, "TR7": 7, "QU4": 4, "QU8": 8, "QU9": 9}
_OTHERS = ("PE6", "P15", "PY5", "P13", "P18", "POE")
_KINDS = "TETRA4, TETRA10, HEXA8, HEXA20 and HEXA27"


def read_med(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return arrays of nodes, cells and groups; ``ignored`` are fields."""
    with opened(path) as file:
        meshes = group_in(file, "ENS_MAA")
        if len(meshes) != 1:
            raise Fault(f"has {len(meshes)} meshes", "Save one mesh in a file.")
        (name,) = meshes
        steps = group_in(meshes, name)
        step = group_in(steps, min(steps, default=""))
        families = group_in(group_in(file, "FAS"), name) if "FAS" in file and name in file["FAS"] else {}
        nodes = group_in(step, "NOE")
        points = _points(nodes, int(steps.attrs.get("REP", 0)))
        tags = array_in(nodes, "NUM") if "NUM" in nodes else np.arange(1, len(points) + 1)
        blocks, sets = Blocks(), dict[str, list[int]]()
        names = _names(families, "NOEUD")
        if "FAM" in nodes:
            for tag, family in zip(tags.tolist(), array_in(nodes, "FAM").tolist(), strict=False):
                for group in names.get(family, ()):
                    sets.setdefault(f"nodes:{group}", []).append(tag)
        _read_cells(step, tags, _names(families, "ELEME"), blocks, sets)
        ignored = ["fields"] if "CHA" in file and len(file["CHA"]) else []
        ignored += [f"further steps of the mesh ({len(steps) - 1:,})"] if len(steps) > 1 else []
    return {"ignored": ignored}, element_arrays(tags, points, blocks, sets, _KINDS)


def _points(nodes: Any, system: int) -> Any:
    """Return the places of the nodes (n, 3); ``Fault`` in another system of coordinates than 0, the Cartesian one."""
    if system != 0:
        kind = {1: "cylindrical", 2: "spherical"}.get(system, "unknown")
        raise Fault(f"its coordinates are {kind} (REP={system})", "Save the mesh in Cartesian coordinates.")
    flat = array_in(nodes, "COO")
    if flat.ndim != 1 or flat.size % 3:
        raise Fault("its coordinates are not in three dimensions")
    return flat.reshape(3, -1).T


def _read_cells(step: Any, tags: Any, names: dict[int, list[str]], blocks: Blocks, sets: dict[str, list[int]]) -> None:
    kinds = group_in(step, "MAI")
    first = 1
    if other := next((kind for kind in _OTHERS if kind in kinds), None):
        advice = f"Cells are {_KINDS}; mesh by tetrahedra alone or by hexahedra alone."
        raise Fault(f"has cells of the kind {other}", advice)
    for kind, size in (_SOLIDS | _FLAT).items():
        if kind not in kinds:
            continue
        cells = group_in(kinds, kind)
        rows = _nodes_of_cells(array_in(cells, "NOD"), kind, size, len(tags))
        own = _listed(cells, "NUM", range(first, first + len(rows)))
        family = _listed(cells, "FAM", [0] * len(rows))
        if not len(own) == len(family) == len(rows):
            raise Fault(f"cells {kind} and their numbers or families differ in number", "Is the file complete?")
        first += len(rows)
        for tag, member, nodes in zip(own, family, tags[rows - 1].tolist(), strict=True):
            groups = names.get(member, [])
            if kind in _FLAT:
                for group in groups:
                    blocks.skins.setdefault(group, []).append(vertices_of(nodes))
                continue
            blocks.add(tag, [nodes[i] for i in (_COMPLETE if size == 27 else MIRRORED[size])])
            for group in groups:
                sets.setdefault(f"cells:{group}", []).append(tag)


def _listed(cells: Any, name: str, default: Sequence[int]) -> Sequence[int]:
    numbers: Sequence[int] = array_in(cells, name).tolist() if name in cells else default
    return numbers


def _nodes_of_cells(flat: Any, kind: str, size: int, count: int) -> Any:
    """Return the rows of nodes, from 1, of the cells of a kind (m, size)."""
    if flat.ndim != 1 or flat.size % size:
        raise Fault(f"its cells {kind} do not have {size} nodes each", "Is the file complete?")
    if flat.size and not (flat.dtype.kind in "iu" and flat.min() >= 1 and flat.max() <= count):
        raise Fault(f"cells {kind} have nodes that are not defined; there are {count:,}", "Is it complete?")
    return flat.reshape(size, -1).T


def _names(families: Any, kind: str) -> dict[int, list[str]]:
    """Return the names of the groups of each family, by the number of the family."""
    names: dict[int, list[str]] = {}
    part = group_in(families, kind) if kind in families else {}
    for name in part:
        family = group_in(part, name)
        attributes = family.attrs
        if "NUM" not in attributes or "GRO" not in family:
            continue
        rows = array_in(group_in(family, "GRO"), "NOM")
        texts = [bytes(np.asarray(row, dtype=np.uint8)).split(b"\0")[0].decode("utf-8", "replace") for row in rows]
        names[int(attributes["NUM"])] = [shown(text.strip()) for text in texts if text.strip()]
    return names


_NAMES = {4: "TE4", 10: "T10", 8: "HE8", 20: "H20"}
_FLAT_NAMES = {3: "TR3", 6: "TR6", 4: "QU4", 8: "QU8"}
_GEOMETRIES = {"TE4": 304, "T10": 310, "HE8": 308, "H20": 320, "TR3": 203, "TR6": 206, "QU4": 204, "QU8": 208}
_VERSION = (4, 1, 0)
_PROFILE = b"MED_NO_PROFILE_INTERNAL"
_STEP = "-0000000000000000001-0000000000000000001"
_LONGEST = 80  # bytes of the name of a group, by the format
_MESH = "mesh"


def save_med(path: Path, source: MeshSource, points: Floats) -> None:
    """Write nodes, cells and groups at ``points`` (n, 3); facets of groups are cells of the surface.

    Raises:
        OSError: it cannot be written.
    """
    import h5py

    from hpcinv.formats.readers.elements import check_names, check_numbers, elements_of, facets_of

    content = BytesIO()  # HDF5 crashes on a full disk
    check_names(source, rf"[^\n/]{{1,{_LONGEST}}}", f"Names have up to {_LONGEST} characters; rename the region.")
    check_numbers(source)
    elements = elements_of(source)
    used = np.unique(elements)
    row = np.searchsorted(used, elements) + 1
    facets = np.searchsorted(used, facets_of(source, elements)) + 1
    facet_tags = source.cell_tags.max() + 1 + np.arange(len(facets))
    families: dict[tuple[str, ...], int] = {(): 0}
    with h5py.File(content, "w") as file:
        info = file.create_group("INFOS_GENERALES", track_order=True)
        info.attrs.update({name: np.int32(value) for name, value in zip(("MAJ", "MIN", "REL"), _VERSION, strict=True)})
        mesh = file.create_group("ENS_MAA", track_order=True).create_group(_MESH, track_order=True)
        texts = {"NOM": b"x".ljust(16) + b"y".ljust(16) + b"z".ljust(16), "UNI": b" " * 48, "DES": b"Written by hpcinv"}
        mesh.attrs.update({name: np.bytes_(text) for name, text in (texts | {"UNT": b""}).items()})
        mesh.attrs.update(
            {name: np.int32(value) for name, value in {"DIM": 3, "ESP": 3, "REP": 0, "SRT": 1, "TYP": 0}.items()}
        )
        step = mesh.create_group(_STEP, track_order=True)
        step.attrs.update({name: np.int32(-1) for name in ("NDT", "NOR", "NXI", "NXT", "PDT", "NXX")})
        step.attrs.update({"CGT": np.int32(1), "PDT": 0.0})
        nodes = _part(step, "NOE", {"CGT": 1, "CGS": 1})
        _store(nodes, "COO", points[used].T.ravel())
        _store(nodes, "NUM", source.node_tags[used])
        _store(nodes, "FAM", np.zeros(len(used)))
        cells = _part(step, "MAI", {"CGT": 1})
        for dim, kind, tags, rows in (
            (3, _NAMES[row.shape[1]], source.cell_tags, row[:, MIRRORED[row.shape[1]]]),
            (2, _FLAT_NAMES[facets.shape[1]], facet_tags, facets),
        ):
            if len(rows):
                part = _part(cells, kind, {"CGT": 1, "CGS": 1, "GEO": _GEOMETRIES[kind]})
                _store(part, "NOD", rows.T.ravel(), len(rows))
                _store(part, "NUM", tags)
                _store(part, "FAM", _families_of(source, dim, families))
        _write_families(file, families)
    path.write_bytes(content.getbuffer())


def _families_of(source: MeshSource, dim: int, families: dict[tuple[str, ...], int]) -> Ints:
    """Return the family of each cell or facet: a negative number for each set of groups."""
    groups = [(at, group) for at, group in enumerate(source.groups) if group.dim == dim]
    is_member = np.zeros((len(source.cells if dim == 3 else source.facets), max(1, len(groups))), dtype=bool)
    for column, (_, group) in enumerate(groups):
        is_member[group.members, column] = True
    distinct, place = np.unique(is_member, axis=0, return_inverse=True)
    numbers = []
    for row in distinct:
        names = tuple(group.name for (_, group), has in zip(groups, row, strict=False) if has)
        numbers.append(families.setdefault(names, -len(families)))
    return np.array(numbers, dtype=np.int64)[place.ravel()]


def _write_families(file: Any, families: Mapping[tuple[str, ...], int]) -> None:
    root = file.create_group("FAS", track_order=True).create_group(_MESH, track_order=True)
    root.create_group("FAMILLE_ZERO", track_order=True).attrs["NUM"] = np.int32(0)
    part = root.create_group("ELEME", track_order=True)
    for names, number in families.items():
        if number:
            family = part.create_group(f"FAM_{number}", track_order=True)
            family.attrs["NUM"] = np.int32(number)
            group = family.create_group("GRO", track_order=True)
            group.attrs["NBR"] = np.int32(len(names))
            rows = np.zeros((len(names), _LONGEST), dtype=np.int8)
            for at, name in enumerate(names):
                content = np.frombuffer(name.encode()[:_LONGEST], dtype=np.int8)
                rows[at, : len(content)] = content
            group.create_dataset("NOM", (len(names),), dtype=np.dtype(f"{_LONGEST}i1"))[...] = rows


def _part(parent: Any, name: str, attributes: Mapping[str, int]) -> Any:
    group = parent.create_group(name, track_order=True)
    group.attrs.update({key: np.int32(value) for key, value in attributes.items()})
    group.attrs["PFL"] = np.bytes_(_PROFILE)
    return group


def _store(group: Any, name: str, values: Any, count: int = 0) -> None:
    is_real = values.dtype.kind == "f" and name == "COO"
    data = group.create_dataset(name, data=values.astype(np.float64 if is_real else np.int32))
    data.attrs.update({"CGT": np.int32(1), "NBR": np.int32(count or len(values) // (3 if is_real else 1))})
