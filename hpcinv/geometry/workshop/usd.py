"""A body with its rest shape as a deformable body of OpenUSD (``.usda``), for robot simulators and film.

Names are from "Deformable Body Physics in USD", proposal 111 of OpenUSD (github.com/PixarAnimationStudios/
OpenUSD-proposals) as of November 2026, which no version of OpenUSD has yet: simulators that follow it read the file,
others see a mesh of tetrahedra with its surface.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations, count
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdPhysics, UsdShade, Vt

from hpcinv.base.files.atomic import write_output
from hpcinv.base.files.names import check_directory_of
from hpcinv.base.quantity.spatial_fields import is_uniform
from hpcinv.errors import OutputError
from hpcinv.job.job import Job
from hpcinv.mesh.cells import FACET_KIND, scalar_element, vertex_count
from hpcinv.mesh.refine.subdivision import eighths, quarters
from hpcinv.mesh.source import Floats, Ints, MeshSource
from hpcinv.physics.effects.gravity import Gravity
from hpcinv.version import __version__

SCHEMA = "OpenUSD-proposals 111, Deformable Body Physics in USD, November 2026"
_FACES = np.array([[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]])
"""corners around the faces of a hexahedron"""


@dataclass(frozen=True)
class Written:
    """What the file holds.

    Attributes:
        distance: largest distance of a curved edge from the straight ones that replace it, in either shape, m.
        regions: names in the file by their names in the job.
    """

    cells: int
    distance: float
    regions: Mapping[str, str]


def write_usd(path: Path, job: Job, loaded: MeshSource, rest: MeshSource, scale: float, unit: float) -> Written:
    """Write the body in a state, with its rest shape, laws, weight and regions.

    Args:
        loaded: shape in m that is shown first.
        rest: rest shape in m, with the same cells.
        scale: factor of all lengths about the origin.
        unit: of the coordinates in the file, m.

    Raises:
        OutputError: the shapes have different cells, or the file cannot be written.
    """
    if loaded.cells.shape != rest.cells.shape or (loaded.cells != rest.cells).any():
        raise OutputError(f"{path}: the files of both shapes have different cells", "Export another state of the run.")
    check_directory_of(path)
    root = f"/{Tf.MakeValidIdentifier(job.job)}"
    stage = _stage(root, unit)
    cells, parents = _tetrahedra(loaded)
    used, numbers = np.unique(cells, return_inverse=True)
    points, rest_points = (source.points[used] for source in (loaded, rest))
    cells = _right_handed(numbers.reshape(cells.shape), points)
    body = _body(stage, f"{root}/Body", cells, points * (scale / unit), rest_points * (scale / unit))
    regions = _add_regions(body, loaded, used, parents)
    _add_materials(stage, root, job, regions, unit)
    _add_weight(stage, body, job, (points, rest_points), cells, scale, unit)
    write_output(path, stage.ExportToString().encode(), "Is the directory writable, and space left?")
    return Written(len(cells), scale * max(_chord_distance(loaded), _chord_distance(rest)), regions)


def _stage(root: str, unit: float) -> Usd.Stage:
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageMetersPerUnit(stage, unit)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    stage.GetRootLayer().customLayerData = {"hpcinv": __version__, "deformableSchema": SCHEMA}
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, root).GetPrim())
    return stage


def _body(stage: Usd.Stage, place: str, cells: Ints, points: Floats, rest_points: Floats) -> UsdGeom.TetMesh:
    """Add the tetrahedra with their surface, in both shapes."""
    body = UsdGeom.TetMesh.Define(stage, place)
    for schema in ("PhysicsBodyAPI", "PhysicsDeformableBodyAPI", "PhysicsVolumeDeformableSimAPI"):
        body.GetPrim().AddAppliedSchema(schema)
    at, at_rest = (Vt.Vec3fArray.FromNumpy(array.astype(np.float32)) for array in (points, rest_points))
    body.CreatePointsAttr(at)
    body.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(at))
    body.CreateTetVertexIndicesAttr(Vt.Vec4iArray.FromNumpy(cells.astype(np.int32)))
    body.CreateSurfaceFaceVertexIndicesAttr(UsdGeom.TetMesh.ComputeSurfaceFaces(body))
    body.GetPrim().CreateAttribute("physics:restShapePoints", Sdf.ValueTypeNames.Point3fArray).Set(at_rest)
    return body


def _add_regions(body: UsdGeom.TetMesh, source: MeshSource, used: Ints, parents: Ints) -> dict[str, str]:
    """Add regions of cells and of the surface; return their names in the file."""
    surface, names = np.array(body.GetSurfaceFaceVertexIndicesAttr().Get()), dict[str, str]()
    for group in source.groups:
        if group.dim == 3:
            members, element, family = np.flatnonzero(np.isin(parents, group.members)), "tetrahedron", "cells"
        else:
            triangles = np.searchsorted(used, _triangles(source, group.members))
            members, element, family = _rows_of(triangles, surface), "face", "boundary"
        if len(members):
            names[group.name] = _free_name(Tf.MakeValidIdentifier(group.name), names.values())
            indices = Vt.IntArray.FromNumpy(members.astype(np.int32))
            subset = UsdGeom.Subset.CreateGeomSubset(body, names[group.name], element, indices, family)
            subset.GetPrim().SetDisplayName(group.name)
    return names


def _add_materials(stage: Usd.Stage, root: str, job: Job, regions: Mapping[str, str], unit: float) -> None:
    """Add a material for each law, with the moduli at small strain of laws that are the same everywhere."""
    for where, law in job.laws.items():
        region = where.removeprefix("material").removeprefix(".")
        name = regions.get(region, "Body")
        material = UsdShade.Material.Define(stage, f"{root}/Materials/{name}")
        for schema in ("PhysicsMaterialAPI", "PhysicsVolumeDeformableMaterialAPI"):
            material.GetPrim().AddAppliedSchema(schema)
        if law.is_uniform:
            young, poisson = law.young_and_poisson()
            for key, value in (("youngsModulus", young * unit), ("poissonsRatio", poisson)):
                material.GetPrim().CreateAttribute(f"physics:{key}", Sdf.ValueTypeNames.Float).Set(value)
        owner = stage.GetPrimAtPath(f"{root}/Body/{name}" if region in regions else f"{root}/Body")
        UsdShade.MaterialBindingAPI.Apply(owner).Bind(material, materialPurpose="physics")


def _add_weight(
    stage: Usd.Stage,
    body: UsdGeom.TetMesh,
    job: Job,
    shapes: tuple[Floats, Floats],
    cells: Ints,
    scale: float,
    unit: float,
) -> None:
    """Add masses of the nodes and the acceleration of the first weight of the job, none without one."""
    acceleration = np.zeros(3)
    weights = (effect for effect in job.effects if isinstance(effect, Gravity) and is_uniform(effect.density))
    if (effect := next(weights, None)) is not None:
        acceleration = np.array(effect.acceleration, dtype=np.float64)
        points = shapes[effect.density_in == "reference"] * scale
        masses = np.zeros(len(points))
        np.add.at(masses, cells, (float(effect.density) / 4 * np.abs(_volumes(points[cells])))[:, None])
        array = Vt.FloatArray.FromNumpy(masses.astype(np.float32))
        body.GetPrim().CreateAttribute("physics:masses", Sdf.ValueTypeNames.FloatArray).Set(array)
    scene = UsdPhysics.Scene.Define(stage, body.GetPath().GetParentPath().AppendChild("PhysicsScene"))
    size = float(np.linalg.norm(acceleration))
    scene.CreateGravityMagnitudeAttr(size / unit)
    if size:
        scene.CreateGravityDirectionAttr(Gf.Vec3f(*(acceleration / size).tolist()))


def _tetrahedra(source: MeshSource) -> tuple[Ints, Ints]:
    """Return straight tetrahedra (n, 4) of the nodes, and the cell of each."""
    vertices = source.cells[:, : vertex_count(source.kind)]
    parents = np.arange(len(vertices))
    if source.degree == 2:
        pieces = eighths(source)
        vertices, parents = pieces.vertices, pieces.parents
    if source.kind == "tetrahedron":
        return vertices, parents
    # Each tetrahedron has the first vertex and half of a face without it. Faces are cut at their first vertex, in both
    # cells alike.
    first = vertices.argmin(axis=1)
    halves = _halves(vertices[:, _FACES].reshape(-1, 4)).reshape(len(vertices), 12, 3)
    apart = ~(halves == vertices[np.arange(len(vertices)), first][:, None, None]).any(axis=2)
    halves = halves[apart].reshape(-1, 6, 3)
    apex = np.broadcast_to(vertices.min(axis=1)[:, None, None], (len(vertices), 6, 1))
    return np.concatenate([apex, halves], axis=2).reshape(-1, 4), np.repeat(parents, 6)


def _halves(cyclic: Ints) -> Ints:
    """Return two triangles (2 n, 3) of each quadrilateral (n, 4), whose nodes go round it, at its first node."""
    rows = np.arange(len(cyclic))[:, None]
    turned = cyclic[rows, (cyclic.argmin(axis=1)[:, None] + np.arange(4)) % 4]
    halves: Ints = turned[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
    return halves


def _triangles(source: MeshSource, members: Ints) -> Ints:
    """Return straight triangles (n, 3) of facets."""
    kind = FACET_KIND[source.kind]
    facets = source.facets[members]
    vertices = quarters(kind, facets).vertices if source.degree == 2 else facets[:, : vertex_count(kind)]
    return vertices if kind == "triangle" else _halves(vertices[:, [0, 1, 3, 2]])


def _right_handed(cells: Ints, points: Floats) -> Ints:
    turned: Ints = np.where((_volumes(points[cells]) > 0)[:, None], cells, cells[:, [0, 2, 1, 3]])
    return turned


def _volumes(corners: Floats) -> Floats:
    volumes: Floats = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
    return volumes


def _rows_of(triangles: Ints, surface: Ints) -> Ints:
    """Return the rows of a surface with the given triangles; others are left out."""
    rows = {tuple(row): number for number, row in enumerate(np.sort(surface, axis=1).tolist())}
    return np.array(
        [rows[key] for row in np.sort(triangles, axis=1).tolist() if (key := tuple(row)) in rows], dtype=np.int64
    )


def _free_name(name: str, others: Iterable[str]) -> str:
    taken = set(others)
    return next(free for n in count() if (free := f"{name}_{n}" if n else name) not in taken)


def _chord_distance(source: MeshSource) -> float:
    """Return the largest distance of an edge of degree 2 from the two straight ones through its nodes."""
    if source.degree == 1:
        return 0.0
    edges = source.points[source.cells][:, _edges_of(source.kind)]
    return float(np.linalg.norm(edges[:, :, 0] - 2 * edges[:, :, 2] + edges[:, :, 1], axis=2).max() / 8)


def _edges_of(kind: str) -> Ints:
    """Return the local nodes (n, 3) of the edges of degree 2: both ends and the middle."""
    nodes, corners = scalar_element(kind, 2).points, vertex_count(kind)
    found = []
    for a, b in combinations(range(corners), 2):
        middle = np.abs(nodes - (nodes[a] + nodes[b]) / 2).max(axis=1)
        if kind == "tetrahedron" or np.count_nonzero(nodes[a] != nodes[b]) == 1:
            found.append((a, b, int(middle.argmin())))
    return np.array(found)
