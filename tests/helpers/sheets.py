"""Surfaces of quadrilaterals of degree 2, with their edges as groups."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from hpcinv.mesh.cells import scalar_element
from hpcinv.mesh.io.gmsh_model import save_msh
from hpcinv.mesh.source import Group, MeshSource

type Place = Callable[[np.ndarray, np.ndarray], np.ndarray]


def flat(length: float, width: float) -> Place:
    """Return the places of a rectangle in the plane z = 0."""
    return lambda s, t: np.column_stack([length * s, width * t, np.zeros_like(s)])


def quadrilaterals(
    path: Path, points: np.ndarray, cells: np.ndarray, edges: Mapping[str, np.ndarray], unit: float = 1.0
) -> MeshSource:
    """Return a surface of cells (n, 9), the group "sheet", with the edges (m, 3) as groups.

    Args:
        unit: of the points, m.
    """
    ends = np.cumsum([len(edge) for edge in edges.values()])
    groups = [Group("sheet", 3, 1, np.arange(len(cells)))]
    for number, (name, edge) in enumerate(edges.items()):
        groups.append(Group(name, 2, number + 1, np.arange(ends[number] - len(edge), ends[number])))
    return MeshSource(
        path=path,
        kind="quadrilateral",
        degree=2,
        points=points,
        node_tags=np.arange(1, len(points) + 1),
        cells=cells,
        cell_tags=np.arange(1, len(cells) + 1),
        facets=np.concatenate([np.empty((0, 3), dtype=np.int64), *edges.values()]),
        groups=tuple(groups),
        unit=unit,
    )


def sheet(path: Path, nx: int, ny: int, place: Place, unit: float = 1.0) -> MeshSource:
    """Return nx × ny cells on the places (n, 3) of coordinates in [0, 1]²; edges are x0, x1, y0, y1."""
    columns, rows = 2 * nx + 1, 2 * ny + 1
    t, s = (grid.ravel() for grid in np.meshgrid(np.linspace(0, 1, rows), np.linspace(0, 1, columns), indexing="ij"))
    steps = np.rint(2 * scalar_element("quadrilateral", 2).points).astype(np.int64)
    first = np.array([2 * j * columns + 2 * i for j in range(ny) for i in range(nx)])
    cells = first[:, None] + steps[:, 0] + columns * steps[:, 1]
    along = np.rint(2 * scalar_element("interval", 2).points[:, 0]).astype(np.int64)
    vertical = columns * (2 * np.arange(ny)[:, None] + along)
    horizontal = 2 * np.arange(nx)[:, None] + along
    sides = [vertical, vertical + columns - 1, horizontal, horizontal + columns * (rows - 1)]
    return quadrilaterals(path, place(s, t), cells, dict(zip(("x0", "x1", "y0", "y1"), sides, strict=True)), unit)


def save_sheet(path: Path, nx: int, ny: int, place: Place, unit: float = 1.0) -> Path:
    """Write a `sheet`."""
    source = sheet(path, nx, ny, place, unit)
    save_msh(path, source, source.points)
    return path


def save_sphere_octant(path: Path, divisions: int) -> Path:
    """Write an eighth of a unit sphere, 3 × divisions² cells; its edges in the planes x, y, z = 0 are x0, y0, z0."""
    steps = np.linspace(0, 1, 2 * divisions + 1)
    local = np.rint(2 * scalar_element("quadrilateral", 2).points).astype(np.int64)
    corners = [(axis, 2 * i, 2 * j) for axis in range(3) for i in range(divisions) for j in range(divisions)]
    cubes = np.ones((len(corners), len(local), 3))
    for cube, (axis, i, j) in zip(cubes, corners, strict=True):
        cube[:, (axis + 1) % 3], cube[:, (axis + 2) % 3] = steps[i + local[:, 0]], steps[j + local[:, 1]]
    places, cells = np.unique(np.round(cubes.reshape(-1, 3), 9), axis=0, return_inverse=True)
    cells, tangents = cells.reshape(len(corners), -1), np.tan(np.pi / 4 * places)
    points = tangents / np.linalg.norm(tangents, axis=1, keepdims=True)
    sides = np.concatenate([cells[:, edge] for edge in ([0, 1, 4], [0, 2, 5], [1, 3, 6], [2, 3, 7])])
    edges = {f"{name}0": sides[(points[sides][..., k] == 0).all(axis=1)] for k, name in enumerate("xyz")}
    save_msh(path, quadrilaterals(path, points, cells, edges), points)
    return path
