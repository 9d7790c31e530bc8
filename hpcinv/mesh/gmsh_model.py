"""The only module that talks to gmsh: sessions, reading its current model, and laying a mesh into one."""

from __future__ import annotations

import importlib
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from hpcinv.errors import MeshError, SystemPartMissing
from hpcinv.mesh.cells import DEGREES, FACET_KIND, node_order
from hpcinv.mesh.source import Floats, Group, Ints, MeshSource

DIMENSION_NAMES = {0: "point", 1: "curve", 2: "surface", 3: "volume"}


def _load() -> Any:
    """Import gmsh, whose library is linked to X and OpenGL even where no window is ever opened."""
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
def session(name: str) -> Iterator[Any]:
    """gmsh with an empty current model, quiet, single-threaded and with fixed defaults, so that meshes are repeatable."""
    gmsh = _load()
    if gmsh.isInitialized():
        raise MeshError("gmsh is already in use by this process", "Call gmsh.finalize() before hpcinv builds a mesh.")
    # Not interruptible: gmsh would replace the handler of SIGINT.
    gmsh.initialize(argv=[], readConfigFiles=False, run=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("General.NumThreads", 1)
        gmsh.model.add(name)
        yield gmsh
    finally:
        gmsh.finalize()


def extract(gmsh: Any, path: Path) -> MeshSource:
    """The mesh of gmsh's current model; raises ``MeshError`` where it is no solid of one supported kind of cell."""
    mesh = gmsh.model.mesh
    tags, coordinates, _ = mesh.getNodes()
    node_tags, first = np.unique(tags.astype(np.int64), return_index=True)
    points = coordinates.reshape(-1, 3)[first]

    kind, degree, code = _cell_type(gmsh, path)
    cell_tags, cells, cell_groups = _elements(gmsh, path, 3, kind, degree, code, node_tags)
    facet_kind = FACET_KIND[kind]
    facet_code = mesh.getElementType({"triangle": "Triangle", "quadrilateral": "Quadrangle"}[facet_kind], degree)
    _, facets, facet_groups = _elements(gmsh, path, 2, facet_kind, degree, facet_code, node_tags)
    thin = tuple(_group_name(gmsh, d, t) for d in (0, 1) for _, t in gmsh.model.getPhysicalGroups(d))
    return MeshSource(
        path, kind, degree, points, node_tags, cells, cell_tags, facets, (*cell_groups, *facet_groups), thin
    )


def _cell_type(gmsh: Any, path: Path) -> tuple[str, int, int]:
    """Kind, degree and gmsh's number of the one type of solid element in the model."""
    found = [gmsh.model.mesh.getElementProperties(t) for t in gmsh.model.mesh.getElementTypes(3)]
    if not found:
        raise MeshError(
            f"{path}: no solid cells",
            "A body of tetrahedra or hexahedra is needed: mesh the volume (gmsh: model.mesh.generate(3)), not only its surface.",
        )
    name, _, degree, *_ = found[0]
    kind = name.split()[0].lower()
    if len(found) > 1 or kind not in FACET_KIND:
        raise MeshError(
            f"{path}: cells are {' and '.join(sorted(name for name, *_ in found))}",
            "One kind is supported in a mesh: all tetrahedra or all hexahedra.",
        )
    require_degree(path, degree)
    return kind, degree, int(gmsh.model.mesh.getElementTypes(3)[0])


def require_degree(path: Path, degree: int) -> None:
    """Raise ``MeshError`` for a geometry of a degree that is not supported."""
    if degree not in DEGREES:
        raise MeshError(
            f"{path}: geometry of degree {degree}",
            "Degree 1 (flat) and 2 (curved) are supported: save the mesh with Mesh.ElementOrder = 2.",
        )


def _elements(
    gmsh: Any, path: Path, dim: int, kind: str, degree: int, code: int, node_tags: Ints
) -> tuple[Ints, Ints, list[Group]]:
    """Tags, nodes and groups of the elements of one dimension: all cells, but of the facets only those in a group."""
    properties = gmsh.model.mesh.getElementProperties(code)
    order = node_order(kind, degree, np.array(properties[4]).reshape(-1, dim))
    groups_of: dict[int, list[int]] = defaultdict(list)
    for _, group in gmsh.model.getPhysicalGroups(dim):
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, group):
            groups_of[int(entity)].append(int(group))
    several = {e: g for e, g in groups_of.items() if len(g) > 1}
    if several:
        names = sorted({" and ".join(f"'{_group_name(gmsh, dim, g)}'" for g in tags) for tags in several.values()})
        raise MeshError(
            f"{path}: one {DIMENSION_NAMES[dim]} is in several physical groups: {'; '.join(names)}",
            "Keep one group on it and define the other as a geometric region (regions: {name: 'x < 1 mm'}).",
        )
    tags, nodes, labels = [], [], []
    for _, entity in gmsh.model.getEntities(dim):
        (label,) = groups_of.get(int(entity), [0])
        if dim == 3 or label:
            found, on = gmsh.model.mesh.getElementsByType(code, entity)
            tags.append(found.astype(np.int64))
            nodes.append(on.reshape(-1, properties[3])[:, order].astype(np.int64))
            labels.append(np.full(len(found), label))
    tag = np.concatenate([*tags, np.zeros(0, dtype=np.int64)])
    label = np.concatenate([*labels, np.zeros(0, dtype=np.int64)])
    node = np.concatenate([*nodes, np.zeros((0, properties[3]), dtype=np.int64)])
    by_tag = np.argsort(tag, kind="stable")
    groups = [
        Group(_group_name(gmsh, dim, t), dim, int(t), np.flatnonzero(label[by_tag] == t))
        for _, t in gmsh.model.getPhysicalGroups(dim)
    ]
    return tag[by_tag], np.searchsorted(node_tags, node[by_tag]), groups


def _group_name(gmsh: Any, dim: int, tag: int) -> str:
    """Name of a physical group; one without a name is called after its dimension and number, as in ``surface-3``."""
    return gmsh.model.getPhysicalName(dim, tag) or f"{DIMENSION_NAMES[dim]}-{tag}"


def lay(gmsh: Any, source: MeshSource, points: Floats) -> None:
    """Lay the topology, tags and groups of ``source`` at ``points`` (n, 3) into gmsh's current model."""
    model = gmsh.model
    next_tag = int(source.cell_tags.max()) + 1
    home = 0
    for dim, kind, nodes in ((3, source.kind, source.cells), (2, FACET_KIND[source.kind], source.facets)):
        name = {"quadrilateral": "Quadrangle"}.get(kind, kind.capitalize())
        code = model.mesh.getElementType(name, source.degree)
        reference = np.array(model.mesh.getElementProperties(code)[4]).reshape(-1, dim)
        back = np.argsort(node_order(kind, source.degree, reference))
        groups = [g for g in source.groups if g.dim == dim]
        rest = np.setdiff1d(np.arange(len(nodes)), np.concatenate([g.members for g in groups] or [np.zeros(0, int)]))
        for group in [*groups, Group("", dim, 0, rest)]:
            if not len(group.members):
                continue
            entity = model.addDiscreteEntity(dim)
            if not home:  # the nodes live on one entity; elements of the others refer to them by tag
                home = entity
                model.mesh.addNodes(3, entity, source.node_tags, points.ravel())
            if dim == 3:
                tags = source.cell_tags[group.members]
            else:
                tags = np.arange(next_tag, next_tag + len(group.members))
                next_tag += len(tags)
            model.mesh.addElementsByType(entity, code, tags, source.node_tags[nodes[group.members][:, back]].ravel())
            if group.tag:
                model.addPhysicalGroup(dim, [entity], group.tag, group.name)


def metis(corners: Ints, kind: str, parts: int) -> Ints:
    """Part of each cell (m,), 0 ≤ part < ``parts``, by METIS on the dual graph of cells given by their ``corners``."""
    with session("partition") as gmsh:
        for what in ("Topology", "GhostCells", "Physicals"):
            gmsh.option.setNumber(f"Mesh.PartitionCreate{what}", 0)
        gmsh.option.setNumber("Mesh.MetisAlgorithm", 1)  # recursive bisection: parts equal to within a cell or so
        mesh = gmsh.model.mesh
        count = int(corners.max()) + 1
        entity = gmsh.model.addDiscreteEntity(3)
        code = mesh.getElementType(kind.capitalize(), 1)
        reference = np.array(mesh.getElementProperties(code)[4]).reshape(-1, 3)
        back = np.argsort(node_order(kind, 1, reference))
        mesh.addNodes(3, entity, np.arange(1, count + 1), np.zeros(3 * count))
        mesh.addElementsByType(entity, code, np.arange(1, len(corners) + 1), corners[:, back].ravel() + 1)
        mesh.partition(parts)
        part = np.full(len(corners), -1, dtype=np.int64)
        for dim, tag in gmsh.model.getEntities(3):
            owner = gmsh.model.getPartitions(dim, tag)
            if len(owner):
                elements, _ = mesh.getElementsByType(code, tag)
                part[elements.astype(np.int64) - 1] = owner[0] - 1
    return part
