"""Interiors of bodies for sections: their volume, area and interfaces, on 1 to 3 ranks."""

from pathlib import Path

import numpy as np
import pytest

from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import OutputError
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.mesh import build_body
from hpcinv.mesh.body import Body
from hpcinv.mesh.source import Floats, Group, Ints, MeshSource
from hpcinv.output.surfaces.interior import Interior, cut_tetrahedra, read_interior, write_interior
from hpcinv.output.surfaces.interior_gathering import interior_of

CORNERS = np.array([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1)])


def block(n: int) -> Body:
    """n x n x n hexahedra in a cube of 1 m; those below half of its height are the region ``low``."""
    cubes = np.array([[i, j, k] for i in range(n) for j in range(n) for k in range(n)])
    points, cells = np.unique((cubes[:, None] + CORNERS).reshape(-1, 3), axis=0, return_inverse=True)
    source = MeshSource(
        path=Path("block"),
        kind="hexahedron",
        degree=1,
        points=points / n,
        node_tags=np.arange(1, len(points) + 1),
        cells=cells.reshape(-1, 8),
        cell_tags=np.arange(1, len(cubes) + 1),
        facets=np.zeros((0, 4), dtype=np.int64),
        groups=(Group("low", 3, 1, np.flatnonzero(cubes[:, 2] < n // 2)),),
    )
    return build_body(MeshSpec.model_construct(file="block.vtu", unit=1.0), {}, MPI.COMM_WORLD, replacement=source)


def volume(points: Floats, tetrahedra: Ints) -> float:
    corners = points[tetrahedra]
    return float(np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])).sum() / 6)


def area(points: Floats) -> float:
    a, b, c = points.reshape(-1, 3, 3).transpose(1, 0, 2)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


@pytest.mark.parallel([1, 2, 3])
def test_the_interior_fills_the_body() -> None:
    interior = interior_of(block(4))
    if interior is None:
        return
    assert not interior.joined
    assert len(interior.tetrahedra) == 6 * 64
    assert volume(interior.points, interior.tetrahedra) == pytest.approx(1)
    assert volume(interior.points, interior.tetrahedra[interior.regions["low"]]) == pytest.approx(0.5)
    for normal in ([1, 0, 0], [0, 0, 1]):
        section = cut_tetrahedra(interior.points, interior.tetrahedra, np.array(normal, dtype=float), 0.3)
        assert area(section.points) == pytest.approx(1)
    diagonal = cut_tetrahedra(interior.points, interior.tetrahedra, np.ones(3) / np.sqrt(3), 1.5 / np.sqrt(3))
    assert area(diagonal.points) == pytest.approx(0.75 * np.sqrt(3))  # a regular hexagon of sides 1/√2
    faces, owners = interior.interfaces()
    assert area(interior.points[faces].reshape(-1, 3)) == pytest.approx(1)
    assert np.allclose(interior.points[faces][..., 2], 0.5)
    assert (interior.regions["low"][owners].sum(axis=1) == 1).all()


@pytest.mark.parallel([1, 2, 3])
def test_cells_of_a_large_body_are_joined() -> None:
    interior = interior_of(block(12), most=2_000)
    if interior is None:
        return
    assert interior.joined
    assert 500 < len(interior.tetrahedra) < 4_000
    # Nodes stay on the sides of the cube, and the joined cells cover it; where they overlap it is counted twice.
    assert np.allclose([interior.points.min(axis=0), interior.points.max(axis=0)], [[0, 0, 0], [1, 1, 1]])
    assert volume(interior.points, interior.tetrahedra) == pytest.approx(1, abs=0.1)


def test_a_kept_interior_is_read_again(tmp_path: Path) -> None:
    interior = interior_of(block(2))
    assert interior is not None
    path = tmp_path / "interior.npz"
    assert read_interior(path) is None
    write_interior(path, interior)
    again = read_interior(path)
    assert again is not None
    assert np.array_equal(again.tetrahedra, interior.tetrahedra)
    assert np.array_equal(again.regions["low"], interior.regions["low"])
    write_interior(path, Interior(interior.points[:5], interior.tetrahedra))
    with pytest.raises(OutputError, match="its arrays do not fit together"):
        read_interior(path)
