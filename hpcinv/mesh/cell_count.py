"""How many cells gmsh is going to make, estimated from its mesh of the curves, and a limit on them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hpcinv.errors import MeshError

_LINE = 1  # gmsh's number of an edge of two nodes
_PER_CUBE = 5.0
"""Tetrahedra in a cube whose sides are as long as the mean edge on the curves.

Measured: 4.7 to 5.1 for a beam of 7,000 and of 49,000 cells, 4.5 for a ball, 6 and 4.2 for bricks cut into six.
"""
_UNLIMITED = 1e20  # gmsh's own default of the largest size is 1e22


def silent(_text: str) -> None:
    """Listener of those who need none."""


@dataclass(frozen=True)
class MeshingWatch:
    """What meshing is watched by.

    Attributes:
        limit: number of cells that a generator may make.
        told: called with one line of text before the expensive part of meshing begins.
    """

    limit: int
    told: Callable[[str], None] = silent


@contextmanager
def watched(gmsh: Any, path: Path, watch: MeshingWatch) -> Iterator[None]:
    """Within this context ``gmsh.model.mesh.generate`` meshes curves first, and stops if too many cells would follow.

    The mesh is the same: gmsh draws no random numbers for curves, and meshes them once.

    Raises:
        MeshError: within the context, if more than ``watch.limit`` cells are expected.
    """
    mesh = gmsh.model.mesh
    generate, refine = mesh.generate, mesh.refine

    def generate_watched(dim: int = 3) -> None:
        if dim >= 2 and not len(mesh.getElementTypes(1)) and not len(mesh.getElementTypes(2)):
            _require(path, _least(gmsh), watch.limit)
            generate(1)
        if dim >= 2 and (expected := _expected(gmsh)):
            _require(path, expected, watch.limit)
            watch.told(f"about {rounded(expected)} cells expected")
        generate(dim)

    def refine_watched() -> None:
        _require(path, 8.0 * count(gmsh), watch.limit)
        refine()

    mesh.generate, mesh.refine = generate_watched, refine_watched
    try:
        yield
        _require(path, count(gmsh) if gmsh.isInitialized() else 0, watch.limit)
    finally:
        mesh.generate, mesh.refine = generate, refine


def count(gmsh: Any) -> int:
    """Number of solid cells in the current model."""
    return sum(len(tags) for tags in gmsh.model.mesh.getElements(3)[1])


def rounded(number: float) -> str:
    """Two digits of a number of cells, such as ``6,700`` or ``3.2e+09``."""
    if number >= 1e9:
        return f"{number:.1e}"
    digits = max(int(math.log10(number)) - 1, 0) if number >= 1 else 0
    return f"{round(number / 10**digits) * 10**digits:,}"


def _require(path: Path, cells: float, limit: int) -> None:
    if cells > limit:
        raise MeshError(
            f"{path}: about {rounded(cells)} cells expected, more than mesh.maximum_cells allows ({limit:,})",
            "Is the cell size in the same unit as the geometry? If so many cells are meant, raise mesh.maximum_cells.",
        )


def _expected(gmsh: Any) -> float:
    """Number of cells that the mesh of the curves lets expect; 0 without volumes."""
    edges: dict[int, tuple[int, float]] = {}

    def of_curve(tag: int) -> tuple[int, float]:
        if tag not in edges:
            edges[tag] = _edges(gmsh, tag)
        return edges[tag]

    return sum(_cells(gmsh, volume, *_sum(map(of_curve, curves))) for volume, curves in _volumes(gmsh))


def _least(gmsh: Any) -> float:
    """Number of cells that options and sizes of points ask for at least, before anything is meshed; 0 if not known."""
    option = gmsh.option.getNumber
    largest, factor = option("Mesh.MeshSizeMax"), option("Mesh.MeshSizeFactor")
    from_points = bool(option("Mesh.MeshSizeFromPoints"))

    def of_curve(tag: int) -> tuple[float, float]:
        points = gmsh.model.getBoundary([(1, tag)], combined=False, oriented=False)
        sizes = gmsh.model.mesh.getSizes(points) if from_points and points else []
        coarsest = max(sizes, default=0.0) if len(sizes) and min(sizes) > 0 else math.inf
        size = max(min(largest, coarsest), option("Mesh.MeshSizeMin")) * factor
        length = _extent(gmsh, 1, tag)
        return (length / size if 0 < size < _UNLIMITED else 0.0), length

    found = []
    for volume, curves in _volumes(gmsh):
        each = list(map(of_curve, curves))
        if all(number for number, _ in each):
            found.append(_cells(gmsh, volume, *_sum(each)))
    return sum(found)


def _sum(each: Any) -> tuple[float, float]:
    counts, lengths = zip(*each, strict=True) if (each := list(each)) else ((), ())
    return float(sum(counts)), float(sum(lengths))


def _cells(gmsh: Any, volume: int, edges: float, length: float) -> float:
    """Of a volume whose curves have a number of ``edges`` and a ``length``; never fewer than the edges themselves."""
    if not edges or not length:
        return 0.0
    return max(_PER_CUBE * _extent(gmsh, 3, volume) * (edges / length) ** 3, edges)


def _volumes(gmsh: Any) -> Iterator[tuple[int, list[int]]]:
    """Each volume, and the curves of its surfaces."""
    for _, volume in gmsh.model.getEntities(3):
        surfaces = gmsh.model.getBoundary([(3, volume)], combined=False, oriented=False)
        curves = gmsh.model.getBoundary(surfaces, combined=False, oriented=False)
        yield volume, sorted({tag for dim, tag in curves if dim == 1})


def _extent(gmsh: Any, dim: int, tag: int) -> float:
    """Length of a curve or size of a volume as OpenCASCADE knows it, else the diagonal or volume of its box."""
    try:
        return float(gmsh.model.occ.getMass(dim, tag))
    except Exception:  # gmsh raises nothing narrower; of its own kernel it knows no sizes
        box = np.array(gmsh.model.getBoundingBox(dim, tag))
        sides = box[3:] - box[:3]
        return float(np.linalg.norm(sides) if dim == 1 else np.prod(sides))


def _edges(gmsh: Any, curve: int) -> tuple[int, float]:
    """Number and total length of the edges on a curve."""
    _, nodes = gmsh.model.mesh.getElementsByType(_LINE, curve)
    if not len(nodes):
        return 0, 0.0
    tags, points, _ = gmsh.model.mesh.getNodes(1, curve, includeBoundary=True)
    order = np.argsort(tags)
    at = points.reshape(-1, 3)[order][np.searchsorted(tags, nodes, sorter=order)].reshape(-1, 2, 3)
    return len(at), float(np.linalg.norm(at[:, 1] - at[:, 0], axis=1).sum())
