"""Number of cells that gmsh will make, estimated from its mesh of the curves, and a limit on it."""

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from hpcinv.errors import MeshError

_LINE = 1  # gmsh's element type of an edge with two nodes
_PER_CUBE = 5.0
"""Number of tetrahedra in a cube whose side is the mean edge length on the curves.

Measured: 4.7 to 5.1 for a beam of 7,000 and of 49,000 cells, 4.5 for a ball, 6 and 4.2 for bricks cut into six.
"""
_UNLIMITED = 1e20  # gmsh's own default of the largest size is 1e22


def no_report(_text: str) -> None:
    """Ignore the text."""


@dataclass(frozen=True)
class MeshingMonitor:
    """Limit on the number of cells of a generated mesh, and report of the expected number.

    Attributes:
        report: called with one line of text before the expensive part of meshing begins.
    """

    limit: int
    report: Callable[[str], None] = no_report


@contextmanager
def monitored(gmsh: Any, path: Path, monitor: MeshingMonitor) -> Iterator[None]:
    """Context in which ``gmsh.model.mesh.generate`` meshes curves first, and stops if too many cells would follow.

    The mesh is the same: gmsh draws no random numbers for curves, and meshes them once.

    Raises:
        MeshError: within the context, if more than ``monitor.limit`` cells are expected.
    """
    mesh = gmsh.model.mesh
    generate, refine = mesh.generate, mesh.refine

    def monitored_generate(dim: int = 3) -> None:
        if dim >= 2 and not len(mesh.getElementTypes(1)) and not len(mesh.getElementTypes(2)):
            require_at_most(path, _least(gmsh), monitor.limit)
            generate(1)
        if dim >= 2 and (expected := _expected(gmsh)):
            require_at_most(path, expected, monitor.limit)
            monitor.report(f"about {rounded(expected)} cells expected")
        generate(dim)

    def monitored_refine() -> None:
        require_at_most(path, 8.0 * count(gmsh), monitor.limit)
        refine()

    mesh.generate, mesh.refine = monitored_generate, monitored_refine
    try:
        yield
        require_at_most(path, count(gmsh) if gmsh.isInitialized() else 0, monitor.limit)
    finally:
        mesh.generate, mesh.refine = generate, refine


def count(gmsh: Any) -> int:
    """Number of solid cells in the current gmsh model."""
    return sum(len(tags) for tags in gmsh.model.mesh.getElements(3)[1])


def rounded(number: float) -> str:
    """A number of cells rounded to two digits, such as ``6,700`` or ``3.2e+09``."""
    if number >= 1e9:
        return f"{number:.1e}"
    digits = max(int(math.log10(number)) - 1, 0) if number >= 1 else 0
    return f"{round(number / 10**digits) * 10**digits:,}"


def require_at_most(path: Path, cells: float, limit: int) -> None:
    """Raise ``MeshError`` if there are more cells than the limit."""
    if cells > limit:
        raise MeshError(
            f"{path}: about {rounded(cells)} cells expected, more than mesh.maximum_cells allows ({limit:,})",
            "Check the unit of the cell size. If so many cells are meant, raise mesh.maximum_cells.",
        )


def _expected(gmsh: Any) -> float:
    """Number of cells estimated from the mesh of the curves; 0 without volumes."""

    @cache
    def measure_curve(tag: int) -> tuple[float, float]:
        return _edges(gmsh, tag)

    return sum(_cells(gmsh, volume, *_sum(map(measure_curve, curves))) for volume, curves in _volumes(gmsh))


def _least(gmsh: Any) -> float:
    """Lower bound of the number of cells by options and sizes at points, before anything is meshed; 0 if unknown."""
    option = gmsh.option.getNumber
    largest, factor = option("Mesh.MeshSizeMax"), option("Mesh.MeshSizeFactor")
    uses_point_sizes = bool(option("Mesh.MeshSizeFromPoints"))

    def measure_curve(tag: int) -> tuple[float, float]:
        points = gmsh.model.getBoundary([(1, tag)], combined=False, oriented=False)
        sizes = gmsh.model.mesh.getSizes(points) if uses_point_sizes and points else []
        coarsest = max(sizes, default=0.0) if len(sizes) and min(sizes) > 0 else math.inf
        size = max(min(largest, coarsest), option("Mesh.MeshSizeMin")) * factor
        length = _extent(gmsh, 1, tag)
        return (length / size if 0 < size < _UNLIMITED else 0.0), length

    counts = []
    for volume, curves in _volumes(gmsh):
        each = list(map(measure_curve, curves))
        if all(number for number, _ in each):
            counts.append(_cells(gmsh, volume, *_sum(each)))
    return sum(counts)


def _sum(each: Iterable[tuple[float, float]]) -> tuple[float, float]:
    counts, lengths = np.array(list(each), dtype=float).reshape(-1, 2).sum(axis=0)
    return float(counts), float(lengths)


def _cells(gmsh: Any, volume: int, edges: float, length: float) -> float:
    """Estimated cells of a volume whose curves have this number of ``edges`` and ``length``; at least the edges."""
    if not edges or not length:
        return 0.0
    return max(_PER_CUBE * _extent(gmsh, 3, volume) * (edges / length) ** 3, edges)


def _volumes(gmsh: Any) -> Iterator[tuple[int, list[int]]]:
    for _, volume in gmsh.model.getEntities(3):
        surfaces = gmsh.model.getBoundary([(3, volume)], combined=False, oriented=False)
        curves = gmsh.model.getBoundary(surfaces, combined=False, oriented=False)
        yield volume, sorted({tag for dim, tag in curves if dim == 1})


def _extent(gmsh: Any, dim: int, tag: int) -> float:
    """Length of a curve or size of a volume by OpenCASCADE, otherwise the diagonal or volume of its bounding box."""
    try:
        return float(gmsh.model.occ.getMass(dim, tag))
    except Exception:  # gmsh raises nothing narrower; its own kernel computes no sizes
        box = np.array(gmsh.model.getBoundingBox(dim, tag))
        sides = box[3:] - box[:3]
        return float(np.linalg.norm(sides) if dim == 1 else np.prod(sides))


def _edges(gmsh: Any, curve: int) -> tuple[float, float]:
    _, nodes = gmsh.model.mesh.getElementsByType(_LINE, curve)
    if not len(nodes):
        return 0, 0.0
    tags, points, _ = gmsh.model.mesh.getNodes(1, curve, includeBoundary=True)
    order = np.argsort(tags)
    ends = points.reshape(-1, 3)[order][np.searchsorted(tags, nodes, sorter=order)].reshape(-1, 2, 3)
    return len(ends), float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum())
