"""Straight ways of points past obstacles: which of them lead through, and where they enter."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.expressions import Expression
from hpcinv.errors import MeshError
from hpcinv.model.contacts import Passages
from hpcinv.model.obstacle_passage import DistanceFunction, Passage, passages
from hpcinv.model.surface_distance import SurfaceDistance
from hpcinv.physics.effects.obstacles import Cylinder, LevelSet, Obstacle, Plane, Sphere

RADIUS = 0.25
BALL = {"centre": (0.0, 0.0, 0.0), "radius": RADIUS}
BAR = {"point": (0.0, 0.0, 0.0), "axis": (0.0, 1.0, 0.0), "radius": RADIUS}
ROUND = LevelSet(shape="level-set", formula=Expression(f"x^2 + y^2 + z^2 - ({RADIUS} m)^2"))


def of(obstacle: Obstacle) -> DistanceFunction:
    """The distance of an obstacle in metres."""
    values = {name: value for name, (value, _) in obstacle.quantities().items()}
    columns = {n: np.reshape(v, (3, 1)) if isinstance(v, tuple) else v for n, v in values.items()}

    def distance(points: Any) -> Any:
        with np.errstate(all="ignore"):
            gaps, directions = obstacle.distance(points.T, SimpleNamespace(**columns))
        return gaps, np.broadcast_to(directions, points.T.shape).T

    return distance


SHAPES = [
    Sphere(shape="sphere", **BALL),  # type: ignore[arg-type]
    Cylinder(shape="cylinder", **BAR),  # type: ignore[arg-type]
    ROUND,
]


def way(obstacle: Obstacle, start: Any, end: Any) -> float:
    (share,) = passages(of(obstacle), np.array([start], dtype=float), np.array([end], dtype=float))
    return float(share)


@pytest.mark.parametrize("obstacle", SHAPES, ids=lambda o: o.shape)
def test_way_through_an_obstacle_ends_just_inside(obstacle: Obstacle) -> None:
    share = way(obstacle, (0.05, 0, 1), (0.05, 0, -1))
    entry = (1 - np.sqrt(RADIUS**2 - 0.05**2)) / 2
    assert entry < share < entry + 0.2 * RADIUS / 2


@pytest.mark.parametrize("obstacle", SHAPES, ids=lambda o: o.shape)
@pytest.mark.parametrize(
    ("start", "end"),
    [
        ((0.3, 0, 1), (0.3, 0, -1)),  # past it
        ((0, 0, 1), (0, 0, 0.1)),  # into it, from where it is pushed back
        ((0, 0, 1), (0, 0, 0.3)),  # towards it
        ((0.05, 0, 0.2), (0.1, 0, 0.2)),  # along its inside
        ((0.01, 0, -0.24), (0.05, 0, -1)),  # out of it
    ],
)
def test_ways_that_cross_no_obstacle_are_whole(obstacle: Obstacle, start: Any, end: Any) -> None:
    assert way(obstacle, start, end) == np.inf


@pytest.mark.parametrize("radius", [1e-2, 1e-3, 1e-4])
def test_thin_wire_is_not_stepped_over(radius: float) -> None:
    wire = Cylinder(shape="cylinder", **BAR | {"radius": radius})  # type: ignore[arg-type]
    share = way(wire, (0, 0, 0.7), (0, 0, -0.3))
    assert share == pytest.approx(0.7, abs=1.1 * radius)


def test_half_spaces_and_moulds_have_no_other_side() -> None:
    plane = Plane(shape="plane", point=(0, 0, 0), normal=(0, 0, 1))
    mould = Sphere(shape="sphere", hollow=True, **BALL)  # type: ignore[arg-type]
    assert not plane.can_be_passed
    assert not mould.can_be_passed
    share = way(plane, (0, 0, 1), (0, 0, -1))
    assert share == np.inf


@pytest.mark.release
def test_way_through_a_plate_of_triangles(tmp_path: Path) -> None:
    import pyvista

    file = tmp_path / "plate.stl"
    pyvista.Box((-1, 1, -1, 1, -0.01, 0.01)).triangulate().save(file)
    plate = SurfaceDistance(file, 1.0, False, MPI.COMM_SELF)
    starts = np.array([[0.1, 0.2, 1.0], [0.1, 0.2, 1.0], [1.5, 0.2, 1.0]])
    through, pressed, past = passages(plate, starts, starts - np.array([[0, 0, 2.0], [0, 0, 0.995], [0, 0, 2.0]]))
    assert through == pytest.approx(0.495, abs=1e-3)
    assert pressed == np.inf
    assert past == np.inf


def saved(path: Path, points: Any, triangles: Any) -> Path:
    """Write triangles as OBJ; pyvista's writers turn some of them."""
    lines = [f"v {x} {y} {z}" for x, y, z in points] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in triangles]
    path.write_text("\n".join(lines))
    return path


TRIANGLE = [[0, 0, 1], [2, 0, 1], [0, 3, 1]]
TILTED = [[0, 0, 1], [2, 0, 3], [0, 3, -2]]


@pytest.mark.everyday("corners0")
@pytest.mark.parametrize("corners", [TRIANGLE, TILTED])
def test_flat_surface_has_no_thickness(corners: Any, tmp_path: Path) -> None:
    sheet = SurfaceDistance(saved(tmp_path / "one.obj", corners, [[0, 1, 2]]), 1e-3, False, MPI.COMM_SELF)
    assert sheet.half_thickness is None
    normal = np.cross(np.subtract(corners[1], corners[0]), np.subtract(corners[2], corners[0]))
    normal = normal / np.linalg.norm(normal)
    middle = np.mean(corners, axis=0)
    distances, normals = sheet(1e-3 * np.array([middle + 0.2 * normal, middle - 0.1 * normal]))
    np.testing.assert_allclose(distances, [0.2e-3, -0.1e-3], rtol=1e-5)
    np.testing.assert_allclose(normals, [normal, normal], atol=1e-6)


@pytest.mark.release
def test_thickness_of_a_tilted_plate_is_not_its_bounding_boxs(tmp_path: Path) -> None:
    import pyvista

    plate = pyvista.Cube(x_length=2.0, y_length=3.0, z_length=0.02).triangulate().rotate_x(45).rotate_y(30)
    plate.save(tmp_path / "plate.ply")
    surface = SurfaceDistance(tmp_path / "plate.ply", 1.0, False, MPI.COMM_SELF)
    assert surface.half_thickness == pytest.approx(0.01, rel=1e-4)


def test_triangles_without_an_area_are_left_out(tmp_path: Path) -> None:
    corners = [*TRIANGLE, [1, 0, 1], [0.5, 0, 1]]
    file = saved(tmp_path / "slivers.obj", corners, [[0, 3, 4], [0, 1, 2], [0, 3, 1]])
    distances, normals = SurfaceDistance(file, 1.0, False, MPI.COMM_SELF)(np.array([[0.7, -0.1, 1.5]]))
    assert distances == pytest.approx(np.hypot(0.1, 0.5), rel=1e-5)
    np.testing.assert_allclose(normals, [[0, 0, 1]], atol=1e-6)
    line = saved(tmp_path / "line.obj", corners, [[0, 3, 4], [0, 3, 1]])
    with pytest.raises(MeshError, match=r"line.obj: its triangles have no area"):
        SurfaceDistance(line, 1.0, False, MPI.COMM_SELF)


@pytest.mark.parallel([1, 2])
def test_a_step_goes_as_far_as_all_obstacles_let_all_points_go(comm: MPI.Intracomm) -> None:
    """Points above a ball and a bar; the share of the nearest passage counts, of any obstacle on any rank."""
    start = np.array([[0.05, 0, 1.0], [0.5, 0, 1.0], [0, 0, 1.0 + comm.rank]])  # straight down by 2; one passes by
    end = start - [0, 0, 2]
    bounds = np.full(3, -1.0), np.full(3, 1.0)
    points: Any = SimpleNamespace(places=lambda: start, displacements=lambda: end - start)
    ball, bar = (Passage(points, of(shape), bounds, lambda: np.zeros(3)) for shape in SHAPES[:2])
    below = Passage(points, of(Plane(shape="plane", point=(0, 0, -9), normal=(0, 0, 1))), bounds, lambda: np.zeros(3))
    first = [way(SHAPES[0], a, b) for a, b in zip(start, end, strict=True)]
    expected = comm.allreduce(min(first), MPI.MIN)
    assert 0.3 < expected < 0.5
    assert Passages([ball], comm).share([start]) == pytest.approx(expected, rel=1e-12)
    assert Passages([below, bar, ball], comm).share([start] * 3) == pytest.approx(expected, rel=1e-12)
    assert Passages([below], comm).share([start]) == 1.0
    assert Passages([ball], comm).share([end]) == 1.0  # none moves
    assert Passages([], comm).share([]) == 1.0
    mine = Passages([ball] if comm.rank == 0 else [below], comm)
    assert mine.share([start]) == pytest.approx(comm.bcast(min(first)), rel=1e-12)
