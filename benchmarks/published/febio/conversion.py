"""A model of FEBio as a mesh and a job of hpcinv, for its elastic laws with one solution on the same elements."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from hpcinv.mesh.cells import vtk_order
from hpcinv.mesh.io.vtu import save_vtu
from hpcinv.mesh.source import DataArray, Group, MeshSource

from .feb_reader import AXES, BoundaryCondition, ElementBlock, Floats, Model
from .laws import Law, law_of

KINDS = {"hex8": ("hexahedron", 1), "tet4": ("tetrahedron", 1), "tet10": ("tetrahedron", 2)}
FACET = {"hexahedron": "quadrilateral", "tetrahedron": "triangle"}
FACES = {
    "hex8": ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
    "tet4": ((0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)),
    "tet10": ((0, 2, 1, 6, 5, 4), (0, 1, 3, 4, 8, 7), (1, 2, 3, 5, 9, 8), (2, 0, 3, 6, 7, 9)),
}
"""Nodes of the faces of an element, vertices first, in the order of FEBio, which is VTK's."""

SETTINGS = {"certificate": {"level": "quick"}, "output": {"fields": False, "mesh": []}}


type Facet = tuple[int, ...]
"""Sorted numbers of its nodes."""


class Unsupported(Exception):
    """A model that has no counterpart here; the message says what is missing."""


@dataclass(frozen=True)
class Conversion:
    """A mesh (coordinates in m), and a job for the mesh file ``MESH`` with it."""

    source: MeshSource
    job: dict[str, Any]

    def write(self, directory: Path) -> Path:
        """Write mesh and job to a directory, and return the job's file."""
        directory.mkdir(parents=True, exist_ok=True)
        save_vtu(directory / MESH, self.source, self.source.points)
        path = directory / f"{self.job['job']}.yaml"
        path.write_text(yaml.safe_dump(self.job, sort_keys=False, width=120))
        return path


MESH = "mesh.vtu"


def convert(model: Model, name: str, analysis: str = "forward") -> Conversion:
    """Return mesh and job of a model.

    Raises:
        Unsupported: it has elements, a law, a load or a condition that have no counterpart.
    """
    if model.unread:
        raise Unsupported(", ".join(dict.fromkeys(model.unread)))
    if len(model.blocks) != 1:
        raise Unsupported(f"{len(model.blocks)} blocks of elements")
    block = model.blocks[0]
    if block.kind not in KINDS or block.formulation not in ("", "elastic-solid", "three-field-solid"):
        raise Unsupported(f"elements {block.kind} {block.formulation}".rstrip())
    law = law_of(model, block)
    mesh = _Mesh(model, block)
    for condition in model.conditions:
        mesh.add_nodes(condition.region)
    for load in model.loads:
        mesh.add_surface(load)
    supports = [
        {"region": part, **_support(condition)}
        for condition in model.conditions
        for part in mesh.parts(condition.region)
    ]
    effects = [
        {"region": part, **_effect(load, mesh)} for load in model.loads for part in mesh.parts(load.region)
    ] + list(law.effects)
    fibres = {
        family: {"data": family, "given_on": "reference"} if isinstance(axis, str) else _constant(axis)
        for family, axis in law.fibres.items()
    }
    kind, degree = KINDS[block.kind]
    job = {
        "job": name,
        "analysis": analysis,
        "mesh": {"file": MESH},
        "fibres": fibres,
        "let": dict(law.definitions),
        "material": dict(law.material),
        "effects": effects,
        "supports": supports,
        "discretisation": {"displacement": degree, "formulation": "displacement"},
        **SETTINGS,
    }
    return Conversion(mesh.source(kind, degree, law), {key: value for key, value in job.items() if value})


def _constant(axis: Floats) -> dict[str, Any]:
    return {"direction": axis.tolist(), "given_on": "reference"}


def prescribed(model: Model) -> dict[tuple[int, int], float]:
    """Return the prescribed displacement (m) by node number and component."""
    values: dict[tuple[int, int], float] = {}
    for condition in model.conditions:
        for node in model.nodes_of(condition.region).tolist():
            values |= {(node, axis): value for axis, value in _components(condition).items()}
    return values


def _components(condition: BoundaryCondition) -> dict[int, float]:
    """Prescribed displacement by component."""
    if condition.type == "zero displacement":
        return {i: 0.0 for i, axis in enumerate(AXES) if condition.values.get(f"{axis}_dof", "0") == "1"}
    values = condition.values
    absolute = values.get("relative", "0") == "0" and values.get("dof") in AXES
    if condition.type == "prescribed displacement" and absolute:
        return {AXES.index(values["dof"]): condition.number("value")}
    raise Unsupported(f"boundary condition {condition.type}")


def _support(condition: BoundaryCondition) -> dict[str, Any]:
    components = _components(condition)
    if not any(components.values()):
        return {"fix": [AXES[axis] for axis in components]}
    return {"displacement": [components.get(axis) for axis in range(3)]}


def _effect(load: BoundaryCondition, mesh: _Mesh) -> dict[str, Any]:
    if load.type == "pressure" and load.values.get("linear", "0") == "0":
        text = load.values.get("pressure", "")
        factor = load.factors.get("pressure", 1.0)
        try:
            pressure: Any = float(text) * factor
        except ValueError:
            pressure = f"{factor:.17g}*({text})"  # a formula of X, Y, Z
        return {"effect": "pressure", "pressure": pressure}
    if load.type == "force":
        traction = load.number("scale") * load.vector("force") / mesh.area(load.region)
        return {"effect": "traction", "traction": traction.tolist(), "area_in": "reference"}
    if load.type == "traction":
        traction = load.number("scale") * load.vector("traction")
        area_in = "reference" if load.values.get("linear", "0") == "1" else "current"
        return {"effect": "traction", "traction": traction.tolist(), "area_in": area_in}
    raise Unsupported(f"load {load.type}")


class _Mesh:
    """The mesh of one block, and the regions that conditions and loads need."""

    def __init__(self, model: Model, block: ElementBlock) -> None:
        self.model, self.block = model, block
        used = np.unique(block.nodes)
        self.rows = np.flatnonzero(np.isin(model.numbers, used))
        self.number = {int(number): row for row, number in enumerate(model.numbers[self.rows])}
        faces = np.concatenate([block.nodes[:, list(face)] for face in FACES[block.kind]])
        keys = [tuple(sorted(face)) for face in faces.tolist()]
        count = Counter(keys)
        self.faces: dict[Facet, list[int]] = dict(zip(keys, faces.tolist(), strict=True))
        self.boundary = {key for key in self.faces if count[key] == 1}
        self.regions: dict[str, frozenset[Facet]] = {}

    def add_nodes(self, name: str) -> None:
        """Add the region of all facets whose nodes are in a set, which must have no other nodes."""
        wanted = set(self.model.nodes_of(name).tolist()) & self.number.keys()
        facets = [key for key in self.faces if wanted.issuperset(key)]
        keys = [key for key in facets if key in self.boundary]
        if set().union(*keys) != wanted:
            keys = facets
        if not wanted or set().union(*keys) != wanted:
            raise Unsupported(f"a condition on nodes that do not fill facets ({name})")
        self.regions[name] = frozenset(keys)

    def add_surface(self, load: BoundaryCondition) -> None:
        """Add the region of the surface of a load."""
        if load.tag != "surface_load" or load.values.get("shell_bottom", "0") != "0":
            raise Unsupported(f"load {load.type or load.tag}")
        keys = [tuple(sorted(facet.tolist())) for facet in self.model.surfaces.get(load.region, ())]
        if not keys or not self.boundary.issuperset(keys):
            raise Unsupported(f"a load on facets that are not of the boundary ({load.region})")
        self.regions[load.region] = frozenset(keys)

    def area(self, name: str) -> float:
        """Return the area (m²) of a region of plane facets."""
        corners = 4 if self.block.kind == "hex8" else 3
        rows = [[self.number[node] for node in self.faces[key][:corners]] for key in self.regions[name]]
        points = self.model.points[self.rows][rows]
        fans = np.cross(points[:, 1:-1] - points[:, :1], points[:, 2:] - points[:, :1])
        return float(np.linalg.norm(fans.sum(axis=1), axis=1).sum()) / 2

    @cached_property
    def _parts(self) -> dict[frozenset[str], list[Facet]]:
        """Facets by the regions that they belong to: a facet can be in one group of a mesh only."""
        parts: dict[frozenset[str], list[Facet]] = {}
        for key in sorted(set().union(*self.regions.values())):
            parts.setdefault(frozenset(name for name, keys in self.regions.items() if key in keys), []).append(key)
        return parts

    def parts(self, name: str) -> list[str]:
        """Return the groups of facets that make up a region, once all regions are there."""
        return [f"part{i}" for i, names in enumerate(self._parts, 1) if name in names]

    def source(self, kind: str, degree: int, law: Law) -> MeshSource:
        """Return the mesh with its groups and the arrays of the law."""
        row = np.vectorize(self.number.__getitem__, otypes=[np.int64])
        facets = np.array([self.faces[key] for keys in self._parts.values() for key in keys], dtype=np.int64)
        ends = np.cumsum([len(keys) for keys in self._parts.values()])
        groups = [
            Group(f"part{i}", 2, i, np.arange(end - len(keys), end))
            for i, (keys, end) in enumerate(zip(self._parts.values(), ends, strict=True), 1)
        ]
        return MeshSource(
            path=self.model.path,
            kind=kind,
            degree=degree,
            points=self.model.points[self.rows],
            node_tags=self.model.numbers[self.rows],
            cells=row(self.block.nodes)[:, vtk_order(kind, degree)],
            cell_tags=self.block.numbers,
            facets=row(facets)[:, vtk_order(FACET[kind], degree)],
            groups=tuple(groups),
            data={name: DataArray(name, "cells", values) for name, values in law.arrays.items()},
        )
