"""MED files of Salome and code_aster, read and written."""

from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from hpcinv.base.reading.med_files import MIRRORED
from hpcinv.formats.readers.elements import check_names, check_numbers, elements_of, facets_of
from hpcinv.mesh.source import Floats, Ints, MeshSource

_KINDS = {4: "TE4", 10: "T10", 8: "HE8", 20: "H20"}
_FLAT_KINDS = {3: "TR3", 6: "TR6", 4: "QU4", 8: "QU8"}
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
            (3, _KINDS[row.shape[1]], source.cell_tags, row[:, MIRRORED[row.shape[1]]]),
            (2, _FLAT_KINDS[facets.shape[1]], facet_tags, facets),
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
