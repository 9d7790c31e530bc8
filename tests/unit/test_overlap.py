"""Bodies that pass through themselves, and bodies that only look like it, on any number of ranks."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.mesh_cases import spec

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh import Body, build_body, read_source
from hpcinv.mesh.crossing_facets import Overlap, crossing, find_overlap, meeting
from hpcinv.mesh.surface import Surface, gather_surface
from hpcinv.trust.certificate.overlap import overlap

type Move = Callable[[np.ndarray], np.ndarray]

HOLLOW_SPHERE = """
def build(gmsh, *, size: float = 0.3):
    occ = gmsh.model.occ
    occ.cut([(3, occ.addSphere(0, 0, 0, 1))], [(3, occ.addSphere(0, 0, 0, 0.5))])
    occ.synchronize()
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    gmsh.model.mesh.generate(3)
"""


def body_of(file: Path, comm: MPI.Intracomm, degree: int | None = None, **parameters: Any) -> Body:
    settings = {"parameters": parameters} if parameters else {}
    return build_body(spec(file, geometry_degree=degree, **settings), {}, comm)


def moved(body: Body, move: Move = lambda x: x) -> Overlap:
    return overlap(body, move(body.mesh.geometry.x * body.length_scale))


def along_arc(angle: float, bent: tuple[float, float], middle: float = 0.0, z: float = 0.0) -> Move:
    """Bend a bar along x in its part ``bent``, its middle line at ``y = middle``, and lift it by ``z`` on the way."""

    def move(x: np.ndarray) -> np.ndarray:
        begin, end = bent
        radius = (end - begin) / angle
        turned = (np.clip(x[:, 0], begin, end) - begin) / radius
        behind = np.where(x[:, 0] > end, x[:, 0] - end, np.minimum(x[:, 0] - begin, 0.0))
        across = radius + middle - x[:, 1]
        lift = z * np.clip((x[:, 0] - begin) / (end - begin), 0, 1)
        sine, cosine = np.sin(turned), np.cos(turned)
        return np.stack(
            [across * sine + behind * cosine, radius - across * cosine + behind * sine, x[:, 2] + lift], axis=1
        )

    return move


def exactly_crossing(first: np.ndarray, other: np.ndarray, common: int) -> bool | None:
    """Whether two triangles meet on a segment, in fractions: what each of them has of the line of their planes.

    The first ``common`` corners are the same. ``None`` where another corner lies in the other's plane.
    """
    triangles = [[[Fraction(int(c)) for c in p] for p in t] for t in (first, other)]

    def minus(a: list[Fraction], b: list[Fraction]) -> list[Fraction]:
        return [x - y for x, y in zip(a, b, strict=True)]

    def cross(a: list[Fraction], b: list[Fraction]) -> list[Fraction]:
        return [a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3)]

    def dot(a: list[Fraction], b: list[Fraction]) -> Fraction:
        return sum((x * y for x, y in zip(a, b, strict=True)), Fraction(0))

    normals = [cross(minus(t[1], t[0]), minus(t[2], t[0])) for t in triangles]
    line = cross(*normals)
    spans = []
    for k in (0, 1):
        corners, base = triangles[k], triangles[1 - k][0]
        heights = [dot(normals[1 - k], minus(p, base)) for p in corners]
        if any(h == 0 for h in heights[common:]):
            return None
        ends = [dot(line, p) for p, h in zip(corners, heights, strict=True) if h == 0]
        for i in range(3):
            (p, h), (q, g) = ((corners[j], heights[j]) for j in (i, i - 2))
            if h * g < 0:
                ends.append(dot(line, p) + h / (h - g) * (dot(line, q) - dot(line, p)))
        spans.append(ends)
    if not all(spans):
        return False
    return max(min(s) for s in spans) < min(max(s) for s in spans)


@pytest.mark.everyday("False-0", "False-1", "True-1")
@pytest.mark.parametrize("common", [0, 1])
@pytest.mark.parametrize("slivers", [False, True])
def test_crossings_of_triangles_are_those_that_fractions_have(common: int, slivers: bool) -> None:
    rng = np.random.default_rng(common)
    points = rng.integers(-900, 900, (800, 6, 3))
    if slivers:  # a side of the second passes by the middle of a thin first one, as near as that is wide
        points[:, 2] = points[:, 1] + rng.integers(-4, 5, (800, 3))
        points[:, 5] = points[:, 0] + points[:, 1] - points[:, 4] + rng.integers(-4, 5, (800, 3))
    points[:, 3 : 3 + common] = points[:, :common]
    exact = [exactly_crossing(p[:3], p[3:], common) for p in points]
    place = 6 * np.arange(len(points))[:, None] + np.arange(6)
    second = np.concatenate([place[:, :common], place[:, 3 + common :]], axis=1)
    crosses, where = crossing(points.reshape(-1, 3).astype(float), place[:, :3], second)
    judged = np.array([e is not None for e in exact])
    assert np.array_equal(crosses[judged], np.array(exact)[judged].astype(bool))
    assert 0.02 * len(points) < crosses.sum() < 0.9 * len(points)
    assert judged.sum() > 0.9 * len(points)
    # Where they cross is in the planes of both, and inside of their boxes.
    for triangles in (points[crosses, :3], points[crosses, 3:]):
        a, b, c = np.moveaxis(triangles, 1, 0)
        normal = np.cross(b - a, c - a)
        height = np.einsum("ni,ni->n", normal, where[crosses] - a) / np.linalg.norm(normal, axis=1)
        assert np.abs(height).max() < 1e-6
        assert (where[crosses] > triangles.min(axis=1) - 1e-6).all()
        assert (where[crosses] < triangles.max(axis=1) + 1e-6).all()


@pytest.mark.parametrize("count", [1, 13, 64])
def test_triangles_whose_boxes_meet_are_found_each_pair_once(count: int) -> None:
    """Some share corners, and some edges have many triangles."""
    rng = np.random.default_rng(count)
    points = rng.uniform(0, 1, (count + 2, 3)) * np.array([1, 1, 100])
    corners = np.array([[0, 1, i + 2] if i % 5 == 0 else rng.permutation(count + 2)[:3] for i in range(count)])
    used, corners = np.unique(corners, return_inverse=True)
    points, corners = points[used], corners.reshape(-1, 3)
    low, high = points[corners].min(axis=1), points[corners].max(axis=1)
    expected = {
        (i, j)
        for i in range(count)
        for j in range(i + 1, count)
        if (low[i] <= high[j]).all() and (low[j] <= high[i]).all()
    }
    pairs_met = [(int(i), int(j)) for i, j in meeting(points, corners)]
    assert sorted(pairs_met) == sorted(expected)


def facets(kind: str, degree: int, tags: Any, nodes: Any) -> Surface:
    """Facets given by the numbers of their nodes and the places of these."""
    rows = np.array(tags)
    return Surface(kind, degree, rows, np.array(nodes, dtype=float)[rows], np.ones(len(rows), dtype=bool))


def test_shared_corners_and_edges_of_neighbours_are_no_overlap() -> None:
    # One corner is shared; the second triangle stands across the first, or next to it.
    flat = [(0, 0, 0), (4, -1, 0), (4, 1, 0)]
    assert find_overlap(facets("triangle", 1, [(0, 1, 2), (0, 3, 4)], [*flat, (3, 0, 1), (3, 0, -1)])).pairs == 1
    assert find_overlap(facets("triangle", 1, [(0, 1, 2), (0, 3, 4)], [*flat, (-3, 0, 1), (-3, 0, -1)])).pairs == 0
    # One edge is shared: flat triangles cannot cross, however sharp the fold.
    for height in (1.0, 1e-6, 0.0, -1e-6):
        fold = [(0, 0, 0), (1, 0, 0), (0.4, 1, 0), (0.6, 0.9, height)]
        assert find_overlap(facets("triangle", 1, [(0, 1, 2), (1, 0, 3)], fold)).pairs == 0
    # Curved ones can: the second bulges through the first between the shared edge and its tip.
    corners = [(0, 0, 0), (1, 0, 0), (0.5, 1, 0), (0.5, 0.9, 0.1)]
    middles = [(0.75, 0.5, 0), (0.25, 0.5, 0), (0.5, 0, 0), (0.75, 0.45, -0.1), (0.25, 0.45, -0.1)]
    tags = [(0, 1, 2, 4, 5, 6), (0, 1, 3, 7, 8, 6)]
    assert find_overlap(facets("triangle", 2, tags, corners + middles)).pairs == 1
    middles[3:] = [(0.75, 0.45, 0.03), (0.25, 0.45, 0.03)]
    assert find_overlap(facets("triangle", 2, tags, corners + middles)).pairs == 0
    # And quadrilaterals: the second is twisted, one far corner above the first and the other below.
    square = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)]
    tags = [(0, 1, 2, 3), (0, 1, 4, 5)]
    assert find_overlap(facets("quadrilateral", 1, tags, [*square, (0, 0.9, 0.1), (1, 0.9, -0.1)])).pairs == 1
    assert find_overlap(facets("quadrilateral", 1, tags, [*square, (0, 0.9, 0.1), (1, 0.9, 0.2)])).pairs == 0


def side_by_side(box: Surface, shift: Any) -> Surface:
    """A surface and its copy somewhere else."""
    return Surface(
        box.kind,
        box.degree,
        np.concatenate([box.tags, box.tags + 10_000]),
        np.concatenate([box.nodes, box.nodes + np.array(shift)]),
        np.concatenate([box.outward, box.outward]),
    )


@pytest.mark.everyday("False")
@pytest.mark.parametrize("hexahedra", [False, True])
def test_touching_is_not_crossing_and_no_overlap_hides_behind_edges_on_edges(
    hexahedra: bool, comm: MPI.Intracomm, meshes: Path
) -> None:
    """Two boxes of one grid: where they meet, edges lie on edges, and faces in faces, whether they touch or overlap."""
    bar = body_of(meshes / "box.py", comm, lx=3.0, ly=3.0, lz=6.0, nx=3, ny=3, nz=6, hexahedra=hexahedra)
    surface = gather_surface(bar, bar.mesh.geometry.x * bar.length_scale)
    assert surface is not None
    for shift in ((3, 0, 0), (3, 1, 2), (3, 3, 0), (-3, -3, -6), (0, 0, 6), (3 - 1e-11, 1, 0), (0.3, 0.4, 6 + 1e-12)):
        assert find_overlap(side_by_side(surface, shift)) == Overlap(0, None), shift
    for shift in ((2, 0, 0), (1, 1, 3), (0, 0, 3), (3 - 1e-6, 0, 0), (2.5, 2.5, 5.5), (3 - 1e-6, 0.2, 0.1)):
        overlap = find_overlap(side_by_side(surface, shift))
        assert overlap.pairs > 0, shift
        low, high = np.maximum(shift, 0), np.array([3, 3, 6]) + np.minimum(shift, 0)
        assert (overlap.point > low - 1e-7).all(), shift
        assert (overlap.point < high + 1e-7).all(), shift


@pytest.mark.release
@pytest.mark.parametrize("hexahedra", [False, True])
def test_two_cubes_cross_where_no_plane_separates_them(hexahedra: bool, comm: MPI.Intracomm, meshes: Path) -> None:
    """Convex bodies are apart if there is a gap along a normal of one of them, or of an edge of each."""
    cube = body_of(meshes / "box.py", comm, nx=3, ny=3, nz=3, hexahedra=hexahedra)
    surface = gather_surface(cube, cube.mesh.geometry.x * cube.length_scale - 0.5)
    assert surface is not None
    corners = np.array(list(np.ndindex(2, 2, 2))) - 0.5
    apart = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3))) if seed % 3 else (np.eye(3), None)
        turn *= np.sign(np.linalg.det(turn))
        shift = rng.normal(size=3)
        shift *= rng.uniform(0.6, 1.6) / np.linalg.norm(shift)
        normals = [*np.eye(3), *turn.T, *(np.cross(a, b) for a in np.eye(3) for b in turn.T)]
        spans = [(corners @ n, (corners @ turn.T + shift) @ n) for n in normals if np.linalg.norm(n) > 1e-9]
        gap = max(max(b.min() - a.max(), a.min() - b.max()) for a, b in spans)
        two = side_by_side(surface, shift)
        two.nodes[len(surface.nodes) :] = surface.nodes @ turn.T + shift
        assert (find_overlap(two).pairs == 0) == (gap > 0), (seed, gap)
        apart.append(gap > 0)
    assert 5 < sum(apart) < 25


@pytest.mark.release
@pytest.mark.parallel([2])
def test_arms_tubes_slabs_and_spheres_that_pass_through_themselves(
    comm: MPI.Intracomm, meshes: Path, run_directory: Path
) -> None:
    for degree, hexahedra in ((2, False), (1, True)):
        shape = {"lx": 12.0, "nx": 24, "ny": 2, "nz": 2, "hexahedra": hexahedra}
        bar = body_of(meshes / "box.py", comm, degree, **shape)
        alone = body_of(meshes / "box.py", MPI.COMM_SELF, degree, **shape)
        for angle, z, crosses in ((np.pi, 0.0, False), (4.3, 0.0, True), (4.3, 1.2, False), (4.3, 0.9, True)):
            arms = along_arc(angle, (4.0, 8.0), 0.5, z)
            overlap = moved(bar, arms)
            assert (overlap.pairs > 0) == (overlap.point is not None) == crosses, (degree, hexahedra, angle, z, overlap)
            assert comm.allgather(overlap) == [overlap] * comm.size
            assert moved(alone, arms) == overlap  # to the last digit, on any number of ranks

        slab = body_of(meshes / "box.py", comm, degree, lx=10.0, ly=0.1, lz=3.0, nx=20, ny=1, nz=3, hexahedra=hexahedra)
        assert moved(slab, along_arc(3.0, (4.0, 6.0))).pairs == 0
        assert moved(slab, along_arc(3.9, (4.0, 6.0))).pairs > 0  # folded, and each half through the other
        # Rolled up to a ring whose ends touch, and a little further.
        ring = along_arc(2 * np.pi, (0.0, 10.0))
        for scale in (1e-6, 1.0, 1e3):
            assert moved(slab, lambda x: scale * ring(x)).pairs == 0  # noqa: B023
        assert moved(slab, along_arc(2 * np.pi - 1e-4, (0.0, 10.0))).pairs == 0
        assert moved(slab, along_arc(2 * np.pi + 1e-4, (0.0, 10.0))).pairs > 0

        tube = body_of(
            meshes / "thick_cylinder.py",
            comm,
            degree,
            length=8.0,
            inner=0.2,
            outer=0.3,
            quarter=False,
            radial=1,
            around=4,
            along=24,
            hexahedra=hexahedra,
        )
        for angle, crosses in ((6.0, False), (7.0, True)):
            arc = along_arc(angle, (0.0, 8.0))
            assert (moved(tube, lambda x: arc(x[:, [2, 0, 1]])).pairs > 0) == crosses  # noqa: B023

    path = run_directory / "hollow.py"
    if comm.rank == 0:
        path.write_text(HOLLOW_SPHERE)
    comm.barrier()
    sphere = body_of(path, comm)

    def shifted(by: float) -> Move:
        """The inner surface moves along x, the outer one stays."""
        return lambda x: x + np.outer(np.clip(2 - 2 * np.linalg.norm(x, axis=1), 0, 1), [by, 0, 0])

    assert moved(sphere, shifted(0.3)).pairs == 0
    overlap = moved(sphere, shifted(0.7))
    assert overlap.pairs > 0
    # Both spheres: |x| = 1 and |x - 0.7| = 0.5 meet on a ring at x = 0.886
    assert overlap.point is not None
    assert overlap.point[0] == pytest.approx(0.886, abs=0.05)


@pytest.mark.release
def test_no_false_alarm_on_what_is_thin_flat_or_curved(comm: MPI.Intracomm, meshes: Path) -> None:
    for file in ("single_tetrahedron.msh", "block.geo", "pdms-beam-sagging.msh"):
        assert moved(body_of(meshes / file, comm)) == Overlap(0, None), file
    for degree in (1, 2):
        assert moved(body_of(meshes / "pdms_beam.py", comm, degree, size=4e-3)) == Overlap(0, None)
        for hexahedra in (False, True):
            how = {"comm": comm, "degree": degree, "hexahedra": hexahedra}
            coarse = body_of(meshes / "thick_sphere.py", along=1 + (not hexahedra), radial=1, **how)
            assert moved(coarse) == Overlap(0, None)
            wall = {"inner": 0.9999, "around": 4} if hexahedra else {"inner": 0.99, "around": 24}
            thin = body_of(meshes / "thick_cylinder.py", radial=1, **wall, **how)
            assert moved(thin) == Overlap(0, None)
            assert moved(body_of(meshes / "box.py", **how)) == Overlap(0, None)
            # A sheet 1e4 times as long as thick, flat, bent, and in waves higher than 50 times its thickness.
            sheet = body_of(meshes / "box.py", lx=10.0, ly=1e-3, lz=10.0, nx=20, ny=1, nz=4, **how)
            assert moved(sheet) == Overlap(0, None)
            assert moved(sheet, along_arc(6.2, (0.0, 10.0))) == Overlap(0, None)
            assert moved(sheet, lambda x: x + np.outer(0.06 * np.sin(x[:, 0]), [0, 1, 0])) == Overlap(0, None)
    # Cells as flat as 1e-5, and slivers: all four corners near one plane.
    flat = body_of(meshes / "box.py", comm)
    assert moved(flat, lambda x: x * np.array([1, 1, 1e-5])) == Overlap(0, None)
    sliver = body_of(meshes / "single_tetrahedron.msh", comm)
    assert moved(sliver, lambda x: x @ np.array([[1, 0, 0], [0, 1, 0], [1, 1, 1e-4]])) == Overlap(0, None)


@pytest.mark.release
def test_the_sagging_beam_straightened(comm: MPI.Intracomm, meshes: Path) -> None:
    beam = body_of(meshes / "pdms-beam-sagging.msh", comm)
    generator = spec(meshes / "pdms_beam.py", parameters={"size": "2.2 mm"}, geometry_degree=2)
    straight = read_source(generator, meshes / "pdms_beam.py").points
    assert overlap(beam, straight[beam.mesh.geometry.input_global_indices]) == Overlap(0, None)


@pytest.mark.everyday("False")
@pytest.mark.parametrize("hexahedra", [False, True])
def test_a_displacement_of_small_gradient_makes_no_convex_body_cross_itself(
    hexahedra: bool, comm: MPI.Intracomm, meshes: Path
) -> None:
    """``|u(a) - u(b)| < |a - b|`` in a convex body, so that ``a + u(a) = b + u(b)`` for no two points."""
    plate = body_of(meshes / "box.py", comm, 2, lx=2.0, ly=0.01, nx=16, ny=1, nz=8, hexahedra=hexahedra)
    for seed in range(5):
        rng = np.random.default_rng(seed)
        waves, amplitudes = rng.normal(size=(2, 4, 3))
        gradient = np.linalg.norm(waves, axis=1) @ np.linalg.norm(amplitudes, axis=1)

        def wave(x: np.ndarray) -> np.ndarray:
            return x + 0.7 / gradient * np.sin(x @ waves.T) @ amplitudes  # noqa: B023

        assert moved(plate, wave) == Overlap(0, None)
