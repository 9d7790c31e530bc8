"""Finer meshes of the same body: volumes, areas and shapes stay, cells fit, and none becomes a sliver."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import basix
import dolfinx
import numpy as np
import pytest
from helpers.mesh_cases import conditions, spec

from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.mesh import MeshSource, build_body, read_source
from hpcinv.mesh.cells import coordinate_element, no_cells
from hpcinv.mesh.checks import check
from hpcinv.mesh.refine.refinement import refine
from hpcinv.mesh.source import DataArray

pytestmark = pytest.mark.slow

CASES: dict[str, tuple[str, int, dict[str, Any]]] = {
    "block of tetrahedra": ("box.py", 1, {"nx": 2, "ny": 3, "nz": 2}),
    "block of bricks": ("box.py", 1, {"nx": 2, "ny": 3, "nz": 2, "hexahedra": True}),
    "straight cells with curved geometry": ("box.py", 2, {"nx": 2, "ny": 1, "nz": 1}),
    "cylinder": ("pdms_beam.py", 2, {"size": "3 mm", "length": "30 mm"}),
    "cylinder, straight": ("pdms_beam.py", 1, {"size": "3 mm", "length": "30 mm"}),
    "sphere of tetrahedra": ("thick_sphere.py", 2, {"radial": 2, "along": 2}),
    "sphere of bricks": ("thick_sphere.py", 2, {"radial": 2, "along": 2, "hexahedra": True}),
}
VERTICES = {"tetrahedron": 4, "hexahedron": 8, "triangle": 3, "quadrilateral": 4}
FACET = {"tetrahedron": "triangle", "hexahedron": "quadrilateral"}


def source_of(name: str, meshes: Path) -> MeshSource:
    file, degree, parameters = CASES[name]
    return read_source(spec(meshes / file, parameters=parameters, geometry_degree=degree), meshes / file)


def some(source: MeshSource) -> np.ndarray:
    """A few cells, spread over the mesh."""
    return np.arange(0, len(source.cells), 7)


def refinements(source: MeshSource) -> Iterator[tuple[MeshSource, np.ndarray]]:
    """Everywhere, and where that is possible in places, also twice."""
    refined = refine(source)
    yield refined.source, refined.parent
    if source.kind == "tetrahedron":
        once = refine(source, some(source))
        twice = refine(once.source, some(once.source))
        yield once.source, once.parent
        yield twice.source, once.parent[twice.parent]


def lagrange(kind: str, degree: int) -> Any:
    return basix.create_element(basix.ElementFamily.P, basix.CellType[kind], degree, basix.LagrangeVariant.equispaced)


def measures(kind: str, degree: int, nodes: np.ndarray) -> np.ndarray:
    """Volumes or areas of cells or facets with ``nodes`` (c, n, 3), by a quadrature of its own."""
    points, weights = basix.make_quadrature(
        basix.CellType[kind], 8 if kind in FACET else 24
    )  # areas are not polynomials
    element = lagrange(kind, degree)
    gradients = element.tabulate(1, points)[1:, :, :, 0]
    J = np.einsum("dqn,cnx->cqdx", gradients, nodes)
    return np.sqrt(np.linalg.det(J @ J.transpose(0, 1, 3, 2))) @ weights


def sharing(source: MeshSource) -> Counter[frozenset[int]]:
    """How many cells have each facet, the slow and obvious way."""
    local = basix.topology(basix.CellType[source.kind])[2]
    return Counter(frozenset(cell[v] for v in facet) for cell in source.cells.tolist() for facet in local)


def quality(source: MeshSource) -> np.ndarray:
    """``12 (3V)^(2/3) / Σ l²`` of tetrahedra: 1 where they are regular, 0 where they are flat.

    Source: Liu & Joe, Relationship between tetrahedron shape measures (1994), doi:10.1007/BF01955874.
    """
    corners = source.points[source.cells[:, :4]]
    volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6
    squares = sum(((corners[:, i] - corners[:, j]) ** 2).sum(axis=1) for i in range(4) for j in range(i))
    return np.asarray(12 * (3 * volumes) ** (2 / 3) / squares)


@pytest.mark.everyday(
    "block of tetrahedra", "block of bricks", "straight cells with curved geometry", "sphere of bricks"
)
@pytest.mark.parametrize("name", CASES)
def test_volumes_and_areas_of_all_groups_stay(name: str, meshes: Path) -> None:
    source = source_of(name, meshes)
    for refined, parent in refinements(source):
        check(refined)
        assert (refined.kind, refined.degree) == (source.kind, source.degree)
        assert (len(refined.cells), len(parent)) == (len(parent), len(refined.cells))
        volumes = [measures(s.kind, s.degree, s.points[s.cells]) for s in (source, refined)]
        pieces = np.bincount(parent, weights=volumes[1])
        assert np.abs(pieces / volumes[0] - 1).max() < 1e-12
        for before, after in zip(source.groups, refined.groups, strict=True):
            assert (before.name, before.dim, before.tag) == (after.name, after.dim, after.tag)
            if after.dim == 3:
                assert set(parent[after.members].tolist()) == set(before.members.tolist())
                continue
            areas = [
                measures(FACET[s.kind], s.degree, s.points[s.facets[g.members]]).sum()
                for s, g in ((source, before), (refined, after))
            ]
            assert areas[1] == pytest.approx(areas[0], rel=1e-13)


@pytest.mark.everyday(
    "block of tetrahedra", "block of bricks", "straight cells with curved geometry", "sphere of bricks"
)
@pytest.mark.parametrize("name", CASES)
def test_cells_fit(name: str, meshes: Path) -> None:
    """A node that hangs would leave facets with one cell inside of the body, and so too large a surface."""
    source = source_of(name, meshes)
    kind = FACET[source.kind]
    local = np.array(basix.topology(basix.CellType[source.kind])[2])

    def surface(mesh: MeshSource) -> float:
        shared = sharing(mesh)
        assert set(shared.values()) <= {1, 2}
        corners = mesh.cells[:, local].reshape(-1, VERTICES[kind])
        outside = corners[[shared[frozenset(f)] == 1 for f in corners.tolist()]]
        return float(measures(kind, 1, mesh.points[outside]).sum())

    straight = source.degree == 1 or source.path.name == "box.py"
    for refined, _ in refinements(source):
        if straight:
            assert surface(refined) == pytest.approx(surface(source), rel=1e-13)
        else:  # the vertices' polyhedron comes nearer to the curved surface
            assert surface(refined) == pytest.approx(surface(source), rel=0.05)


@pytest.mark.everyday("straight cells with curved geometry", "sphere of bricks")
@pytest.mark.parametrize("name", [name for name, (_, degree, _) in CASES.items() if degree == 2])
def test_pieces_have_the_shape_of_their_parents(name: str, meshes: Path) -> None:
    """The nodes of a piece lie in its parent as in a straight piece: its map is the parent's."""
    source = source_of(name, meshes)
    cmap = dolfinx.fem.coordinate_element(coordinate_element(source.kind, 2).basix_element)
    nodes: np.ndarray = lagrange(source.kind, 2).points
    weights = lagrange(source.kind, 1).tabulate(0, nodes)[0, :, :, 0]
    for refined, parent in refinements(source):
        worst = 0.0
        for cell, parent_cell in list(zip(refined.cells, parent, strict=True))[::17]:
            at = cmap.pull_back(refined.points[cell], source.points[source.cells[parent_cell]])
            worst = max(worst, float(np.abs(at - weights @ at[: VERTICES[source.kind]]).max()))
            assert at.min() > -1e-9
            assert at.max() < 1 + 1e-9
        print(f"{name}: {worst:.1e}")
        assert worst < 1e-9  # a node on a chord would be off by some 1e-2


@pytest.mark.release
def test_cells_stay_good_however_often_a_corner_is_refined(meshes: Path) -> None:
    for name in ("block of tetrahedra", "cylinder, straight", "sphere of tetrahedra"):
        source = source_of(name, meshes)
        first, count = quality(source), len(source.cells)
        corner = source.points[source.cells[0, 0]]
        for _ in range(10):
            at_corner = (source.points[source.cells[:, :4]] == corner).all(axis=2).any(axis=1)
            source = refine(source, np.flatnonzero(at_corner)).source
        check(source)
        worst = quality(source).min()
        print(f"{name}: {count} cells, worst {first.min():.3f}; {len(source.cells)} cells, worst {worst:.3f}")
        assert len(source.cells) > count + 500
        assert worst > 0.45 * first.min()
        at_corner = (source.points[source.cells[:, :4]] == corner).all(axis=2).any(axis=1)
        assert np.ptp(source.points[source.cells[at_corner, :4]], axis=(0, 1)).max() < 1e-2 * np.ptp(source.points)


def test_cells_stay_good_when_all_are_refined(meshes: Path) -> None:
    for name in ("block of tetrahedra", "cylinder, straight"):
        source = source_of(name, meshes)
        first = quality(source).min()
        for _ in range(2):
            source = refine(source).source
        assert quality(source).min() > 0.8 * first


def test_data_go_along(meshes: Path) -> None:
    """Quadratic data at the nodes of degree 2, linear ones of degree 1 are interpolated exactly; cells inherit."""

    def field(points: np.ndarray, degree: int) -> np.ndarray:
        x, y, z = points.T
        return np.stack([1 + 2 * x - y + z, *([x * y - z**2] * 2 if degree == 2 else [z - x, y])], axis=1)

    for name in ("block of tetrahedra", "block of bricks", "straight cells with curved geometry"):
        source = source_of(name, meshes)
        numbers = np.arange(len(source.cells), dtype=float)[:, None]
        arrays = {
            "field": DataArray("field", "nodes", field(source.points, source.degree)),
            "number": DataArray("number", "cells", numbers),
        }
        object.__setattr__(source, "data", arrays)
        for refined, parent in refinements(source):
            values = refined.data["field"].values
            assert np.abs(values - field(refined.points, source.degree)).max() < 2e-12  # gmsh puts middles that exactly
            assert np.array_equal(refined.data["number"].values[:, 0], parent)


def test_unrefined_cells_keep_their_tags_and_plane_ends_stay_plane(meshes: Path) -> None:
    for name in ("cylinder", "cylinder, straight"):
        source = source_of(name, meshes)
        for refined, parent in refinements(source):
            places = dict(zip(source.node_tags.tolist(), source.points.tolist(), strict=True))
            kept = [t in places for t in refined.node_tags.tolist()]
            assert sum(kept) == len(source.points)
            assert [places[t] for t in refined.node_tags[kept].tolist()] == refined.points[kept].tolist()
            assert len(set(refined.node_tags.tolist())) == len(refined.points)
            whole = np.isin(refined.cell_tags, source.cell_tags)
            assert np.array_equal(refined.cell_tags[whole], source.cell_tags[parent[whole]])
            assert np.array_equal(refined.cells[whole, :4].shape, [whole.sum(), 4])
            (tip,) = (g for g in refined.groups if g.name == "tip")
            assert set(refined.points[refined.facets[tip.members], 0].ravel().tolist()) == {0.03}


@pytest.mark.parametrize("name", ["block of tetrahedra", "block of bricks", "straight cells with curved geometry"])
def test_meshes_without_facet_groups_are_refined(name: str, meshes: Path) -> None:
    """As with files whose regions are named by conditions of the job alone."""
    source = source_of(name, meshes)
    bare = replace(source, facets=no_cells(FACET[source.kind], source.degree), groups=())
    for (refined, _), (same, _) in zip(refinements(bare), refinements(source), strict=True):
        check(refined)
        assert refined.facets.shape == (0, bare.facets.shape[1])
        assert np.array_equal(refined.cells, same.cells)
        assert np.array_equal(refined.points, same.points)


def test_hexahedra_are_not_refined_in_places(meshes: Path) -> None:
    with pytest.raises(ValueError, match="only tetrahedra"):
        refine(source_of("block of bricks", meshes), np.array([0]))


@pytest.mark.parallel([1, 2])
def test_bodies_of_refined_meshes(comm: MPI.Intracomm, meshes: Path) -> None:
    for name, (file, degree, parameters) in CASES.items():
        mesh = spec(meshes / file, parameters=parameters, geometry_degree=degree)
        refined: list[MeshSource] = []

        def make(name: str = name, refined: list[MeshSource] = refined) -> int:
            source = source_of(name, meshes)
            refined.append(refine(source, None if source.kind == "hexahedron" else some(source)).source)
            return len(refined[0].cells)

        count = on_root(comm, make)
        body = build_body(mesh, conditions(part="x < 0.6 m"), comm, replacement=refined[0] if refined else None)
        assert body.mesh.topology.index_map(3).size_global == count
        groups = on_root(comm, lambda body=body: {(g.name, g.dim): len(g.members) for g in body.source.groups})
        for (group, dim), members in groups.items():
            region = body.regions[group]
            assert (region.facet_count if dim == 2 else region.cell_count) == members
