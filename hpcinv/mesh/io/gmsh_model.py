"""Interface to gmsh models: sessions, meshes, views (data of MSH files), and METIS."""

import importlib
import os
import re
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from hpcinv.base.parallel.signals import ended_by_signals, handlers_kept
from hpcinv.errors import MeshError, SystemPartMissing
from hpcinv.mesh.cells import EDGE_KIND, FACET_KIND, degree_of, node_order
from hpcinv.mesh.io.length_unit import store_unit
from hpcinv.mesh.source import DataArray, Floats, Group, Ints, MeshSource, Place, data_arrays, distinct_tags, in_mask

DIMENSION_NAMES = {0: "point", 1: "curve", 2: "surface", 3: "volume"}
GMSH_NAMES = {
    "tetrahedron": "Tetrahedron",
    "hexahedron": "Hexahedron",
    "triangle": "Triangle",
    "quadrilateral": "Quadrangle",
    "interval": "Line",
}

_SURFACE_CELLS = {
    "Triangle 3": ("triangle", 1),
    "Triangle 6": ("triangle", 2),
    "Quadrilateral 4": ("quadrilateral", 1),
    "Quadrilateral 9": ("quadrilateral", 2),
}
"""kinds and degrees of the cells of a shell's surface, by gmsh's names"""

PLACES: dict[str, Place] = {"NodeData": "nodes", "ElementData": "cells"}  # of views ($NodeData, $ElementData)


def _load() -> Any:
    """Import gmsh, whose library needs X and OpenGL libraries even without a window."""
    try:
        return importlib.import_module("gmsh")
    except OSError as exc:
        raise SystemPartMissing(
            f"gmsh cannot be loaded: {exc}",
            "On Debian and Ubuntu: apt-get install libgl1 libglu1-mesa libgomp1 libxcursor1 libxft2 libxinerama1",
        ) from exc
    except ImportError as exc:
        raise SystemPartMissing(f"gmsh is not installed: {exc}", "python -m pip install gmsh") from exc


@contextmanager
def session(name: str, size_factor: float = 1.0) -> Iterator[Any]:
    """Context with gmsh and an empty model; quiet, with one thread and fixed defaults: meshes are repeatable.

    Args:
        size_factor: factor of all cell sizes, except of transfinite meshes.
    """
    gmsh = _load()
    if gmsh.isInitialized():
        raise MeshError(
            "gmsh is already initialized in this process", "Call gmsh.finalize() before hpcinv builds a mesh."
        )
    with handlers_kept():  # gmsh resets SIGTERM
        gmsh.initialize(argv=[], readConfigFiles=False, run=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("General.NumThreads", 1)
        gmsh.option.setNumber("Mesh.MeshSizeFactor", size_factor)
        gmsh.model.add(name)
        with ended_by_signals():
            yield gmsh
    finally:
        if gmsh.isInitialized():  # a generator may have finalized it
            gmsh.finalize()


@dataclass(frozen=True)
class ElementType:
    """gmsh's code of an element type, its number of nodes, and the permutations to and from DOLFINx order."""

    code: int
    size: int
    order: Ints
    back: Ints

    @classmethod
    def query(cls, gmsh: Any, kind: str, degree: int) -> Self:
        """gmsh's complete Lagrange element of this degree."""
        code = gmsh.model.mesh.getElementType(GMSH_NAMES[kind], degree)
        _, dim, _, size, reference, _ = gmsh.model.mesh.getElementProperties(code)
        order = node_order(kind, degree, np.asarray(reference).reshape(-1, dim))
        return cls(int(code), int(size), order, np.argsort(order))


def extract(gmsh: Any, path: Path) -> MeshSource:
    """Mesh of gmsh's current model: all cells, and the facets in physical groups.

    Raises:
        MeshError: there are no solid cells of one supported kind.
    """
    kind, degree = _solid(gmsh, path)
    return _source(gmsh, path, (3, kind, degree), FACET_KIND[kind])


def extract_surface(gmsh: Any, path: Path) -> tuple[MeshSource, ...]:
    """Surface mesh of gmsh's current model, one for each kind of cells, with the edges in physical groups of curves.

    Groups of surfaces have ``dim`` 3, as groups of cells have, and groups of curves have 2.

    Raises:
        MeshError: there are solid cells, or surface cells other than triangles and quadrilaterals of degree 1 or 2.
    """
    mesh = gmsh.model.mesh
    solid, names = (sorted(mesh.getElementProperties(t)[0] for t in mesh.getElementTypes(d)) for d in (3, 2))
    if solid:
        raise MeshError(
            f"{path}: a shell cannot be tied to solid cells, and the file has {' and '.join(solid)}",
            "Save the surface alone (gmsh: model.mesh.generate(2)), or mesh all of it as a solid.",
        )
    degrees = {_SURFACE_CELLS.get(name, ("", 0))[1] for name in names}
    if degrees not in ({1}, {2}):
        raise MeshError(
            f"{path}: a shell needs triangles or quadrilaterals of degree 1 or 2, not {' and '.join(names) or 'none'}",
            "Mesh it by gmsh's model.mesh.generate(2) and setOrder(2), with Mesh.SecondOrderIncomplete = 0.",
        )
    parts = []
    for kind, degree in map(_SURFACE_CELLS.__getitem__, names):
        source = _source(gmsh, path, (2, kind, degree), EDGE_KIND[kind])
        parts.append(replace(source, groups=tuple(replace(group, dim=group.dim + 1) for group in source.groups)))
    return tuple(parts)


def _source(gmsh: Any, path: Path, cell: tuple[int, str, int], facet_kind: str) -> MeshSource:
    """Return the mesh of all cells of a dimension, kind and degree, with the facets in physical groups."""
    dim, kind, degree = cell
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    node_tags, first = np.unique(tags.astype(np.int64), return_index=True)
    cell_tags, cells, groups = _elements(gmsh, path, dim, ElementType.query(gmsh, kind, degree), all_cells=True)
    _, facets, facet_groups = _elements(gmsh, path, dim - 1, ElementType.query(gmsh, facet_kind, degree))
    thin = ((d, tag) for d in range(dim - 1) for _, tag in gmsh.model.getPhysicalGroups(d))
    return MeshSource(
        path=path,
        kind=kind,
        degree=degree,
        points=coordinates.reshape(-1, 3)[first],
        node_tags=node_tags,
        cells=np.searchsorted(node_tags, cells),
        cell_tags=cell_tags,
        facets=np.searchsorted(node_tags, facets),
        groups=(*groups, *facet_groups),
        thin_groups=tuple(_group_name(gmsh, d, tag) for d, tag in thin),
    )


def _solid(gmsh: Any, path: Path) -> tuple[str, int]:
    """Kind and degree of the solid elements of the model, which must be of one type."""
    types = [gmsh.model.mesh.getElementProperties(t) for t in gmsh.model.mesh.getElementTypes(3)]
    if not types:
        raise MeshError(
            f"{path}: no solid cells",
            "Mesh the volume (gmsh: model.mesh.generate(3)), give it a physical group if others have one,"
            " or make it a shell: 'mesh: {shell: {thickness: …}}'.",
        )
    kinds = {gmsh_name: kind for kind, gmsh_name in GMSH_NAMES.items()}
    name, _, _, size, *_ = types[0]
    kind = kinds.get(name.split()[0])
    if len(types) > 1 or kind is None:
        raise MeshError(
            f"{path}: cells are {' and '.join(sorted(name for name, *_ in types))}",
            "Use one kind of cell in a mesh, all of one degree: all tetrahedra (gmsh: extrude without 'recombine'),"
            " or all hexahedra (gmsh: Mesh.SubdivisionAlgorithm = 2).",
        )
    return kind, degree_of(path, kind, size)


def _elements(
    gmsh: Any, path: Path, dim: int, element: ElementType, *, all_cells: bool = False
) -> tuple[Ints, Ints, list[Group]]:
    """Tags, node tags and groups of all cells, or of the facets in groups, sorted by tag."""
    groups_of = _groups_of_entities(gmsh, dim)
    tags, nodes = [np.zeros(0, dtype=np.int64)], [np.zeros((0, element.size), dtype=np.int64)]
    owners = [np.zeros(0, dtype=np.int64)]
    for _, entity in gmsh.model.getEntities(dim):
        if all_cells or int(entity) in groups_of:
            element_tags, element_nodes = gmsh.model.mesh.getElementsByType(element.code, entity)
            tags.append(element_tags.astype(np.int64))
            nodes.append(element_nodes.astype(np.int64).reshape(-1, element.size)[:, element.order])
            owners.append(np.full(len(element_tags), int(entity)))
    tag = np.concatenate(tags)
    tag_order = np.argsort(tag, kind="stable")
    owner = np.concatenate(owners)[tag_order]
    groups = []
    for _, number in gmsh.model.getPhysicalGroups(dim):
        entities = [entity for entity, numbers in groups_of.items() if int(number) in numbers]
        name = _group_name(gmsh, dim, number)
        groups.append(Group(name, dim, int(number), np.flatnonzero(np.isin(owner, entities))))
    return tag[tag_order], np.concatenate(nodes)[tag_order], groups


def _groups_of_entities(gmsh: Any, dim: int) -> dict[int, set[int]]:
    """Tags of the physical groups of each entity that is in some."""
    groups_of: dict[int, set[int]] = defaultdict(set)
    for _, group in gmsh.model.getPhysicalGroups(dim):
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, group):
            groups_of[int(entity)].add(int(group))
    return dict(groups_of)


def _group_name(gmsh: Any, dim: int, tag: int) -> str:
    """Name of a physical group, or its dimension and tag, such as ``surface-3``, if it has no name."""
    return gmsh.model.getPhysicalName(dim, tag) or f"{DIMENSION_NAMES[dim]}-{tag}"


def save_msh(path: Path, source: MeshSource, points: Floats) -> None:
    """Write topology, tags, groups and data of ``source`` at ``points`` (n, 3) as binary MSH 4.1; not collective.

    The points are in ``source.unit``.

    Raises:
        OSError: not all of it could be written.
    """
    path.unlink(missing_ok=True)
    source = _storable(source)
    with session(path.stem) as gmsh:
        _add_mesh(gmsh, source, points)
        store_unit(gmsh, source.unit or 1.0)
        for option, value in (("Binary", 1), ("MshFileVersion", 4.1), ("SaveAll", 1)):
            gmsh.option.setNumber(f"Mesh.{option}", value)
        with _written_in_full(path):
            gmsh.write(str(path))
        write_views(gmsh, path, source)


def _storable(source: MeshSource) -> MeshSource:
    """Return the mesh with tags and names that gmsh can store: distinct tags from 1 on, names without quotes."""

    def tags(given: Ints) -> Ints:
        is_valid = not len(given) or (given.min() > 0 and len(np.unique(given)) == len(given))
        return given if is_valid else np.arange(1, len(given) + 1)

    groups = [replace(group, name=" ".join(group.name.replace('"', "'").split())) for group in source.groups]
    return replace(
        source,
        node_tags=tags(source.node_tags),
        cell_tags=tags(source.cell_tags),
        groups=distinct_tags(groups),
    )


@contextmanager
def _written_in_full(path: Path) -> Iterator[None]:
    """Context in which gmsh writes further sections; ``OSError`` unless they are complete, as on a full disk.

    gmsh itself reports no failure of a write.
    """
    size_before = path.stat().st_size if path.exists() else 0
    yield
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(size - 40, 0))
        if size == size_before or re.search(rb"\$End\w+\s*$", file.read()) is None:
            raise OSError(f"only {size:,} bytes were written")


def _add_mesh(gmsh: Any, source: MeshSource, points: Floats) -> None:
    """Add the topology, tags and groups of ``source`` at ``points`` (n, 3) to gmsh's current model."""
    model = gmsh.model
    facet_tags = source.cell_tags.max() + 1 + np.arange(len(source.facets))
    home = 0
    lower = 1 if source.kind in EDGE_KIND else 0  # cells of a surface
    for cell_dim, kind, tags, nodes in (
        (3, source.kind, source.cell_tags, source.cells),
        (2, (FACET_KIND | EDGE_KIND)[source.kind], facet_tags, source.facets),
    ):
        dim = cell_dim - lower
        element = ElementType.query(gmsh, kind, source.degree)
        entities: dict[int, list[int]] = defaultdict(list)
        for owners, members in _by_groups(source, cell_dim):
            entity = model.addDiscreteEntity(dim)
            for owner in owners:
                entities[owner].append(entity)
            if not home:  # all nodes belong to one entity; elements of other entities refer to them by tag
                home = entity
                model.mesh.addNodes(dim, home, source.node_tags, points.ravel())
            node_tags = source.node_tags[nodes[members][:, element.back]]
            model.mesh.addElementsByType(entity, element.code, tags[members], node_tags.ravel())
        for owner, parts in sorted(entities.items()):
            model.addPhysicalGroup(dim, parts, source.groups[owner].tag, source.groups[owner].name)


def _by_groups(source: MeshSource, dim: int) -> Iterator[tuple[list[int], Ints]]:
    """Parts of the cells (``dim`` 3) or facets (2) with the same groups: their indices, and the members; no group last.

    gmsh has an entity for each part.
    """
    sets, place = np.unique(source.masks(dim), axis=0, return_inverse=True)
    owners = [[i for i in range(len(source.groups)) if in_mask(row[None], i)[0]] for row in sets]
    for part in sorted(range(len(sets)), key=lambda part: owners[part] or [len(source.groups)]):
        yield owners[part], np.flatnonzero(place.ravel() == part)


def read_views(gmsh: Any, source: MeshSource) -> dict[str, DataArray]:
    """Values of gmsh's views at the nodes or in the cells of ``source``, at their last time step.

    Missing values are NaN; views on surfaces only are ignored.
    """
    return data_arrays(_matched(gmsh, source))


def _matched(gmsh: Any, source: MeshSource) -> Iterator[tuple[str, Place, Floats]]:
    known = {"nodes": source.node_tags, "cells": source.cell_tags}  # in ascending order
    for view in gmsh.view.getTags():
        last = int(gmsh.view.option.getNumber(view, "NbTimeStep")) - 1
        kind, tags, values, _, components = gmsh.view.getHomogeneousModelData(view, last)
        if kind not in PLACES:
            continue
        place = PLACES[kind]
        rows = np.searchsorted(known[place], tags.astype(np.int64)).clip(max=len(known[place]) - 1)
        is_known = known[place][rows] == tags
        if is_known.any():
            result = np.full((len(known[place]), components), np.nan)
            result[rows[is_known]] = values.reshape(-1, components)[is_known]
            yield gmsh.view.option.getString(view, "Name"), place, result


def write_views(gmsh: Any, path: Path, source: MeshSource) -> None:
    """Append the data of ``source``, whose mesh is gmsh's current model, to the MSH file at ``path``."""
    gmsh.option.setNumber("PostProcessing.SaveMesh", 0)
    tags = {"nodes": source.node_tags, "cells": source.cell_tags}
    kinds = {place: kind for kind, place in PLACES.items()}
    for name, array in source.data.items():
        view = gmsh.view.add(name)
        gmsh.view.addHomogeneousModelData(
            view,
            0,
            gmsh.model.getCurrent(),
            kinds[array.place],
            tags[array.place],
            array.values.ravel(),
            numComponents=array.values.shape[1],
        )
        with _written_in_full(path):
            gmsh.view.write(view, str(path), append=True)


def metis(corners: Ints, kind: str, parts: int) -> Ints:
    """Part (m,) of each cell, 0 ≤ part < ``parts``, by METIS on the dual graph of cells with these vertices (m, k)."""
    if parts == 1:
        return np.zeros(len(corners), dtype=np.int64)
    with session("partition") as gmsh:
        for what in ("Topology", "GhostCells", "Physicals"):
            gmsh.option.setNumber(f"Mesh.PartitionCreate{what}", 0)
        gmsh.option.setNumber("Mesh.MetisAlgorithm", 1)  # recursive bisection: sizes differ by about one cell
        mesh = gmsh.model.mesh
        nodes = int(corners.max()) + 1
        element = ElementType.query(gmsh, kind, 1)
        entity = gmsh.model.addDiscreteEntity(3)
        mesh.addNodes(3, entity, np.arange(1, nodes + 1), np.zeros(3 * nodes))  # METIS needs no coordinates
        mesh.addElementsByType(
            entity, element.code, np.arange(1, len(corners) + 1), corners[:, element.back].ravel() + 1
        )
        mesh.partition(parts)
        part = np.full(len(corners), -1, dtype=np.int64)
        for dim, piece in gmsh.model.getEntities(3):
            owner = gmsh.model.getPartitions(dim, piece)
            if len(owner):
                cells, _ = mesh.getElementsByType(element.code, piece)
                part[cells.astype(np.int64) - 1] = owner[0] - 1
    return part
