"""Tetrahedra within a body with the results there, for sections; few of them, also for large bodies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hpcinv.base.quantity.arrays import Floats, Ints
from hpcinv.base.quantity.stress_measures import COMPONENTS
from hpcinv.base.reading.door import admitted
from hpcinv.errors import OutputError
from hpcinv.mesh.topology import unique_rows
from hpcinv.output.surfaces.boundary_surface import DAMAGE, write_arrays

NAME = "interior.npz"
_REGION = "region:"
_SIDES = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])  # of a tetrahedron
_AGAIN = "Run the job again."


@dataclass(frozen=True)
class InteriorResult:
    """One solution within the body.

    Attributes:
        mesh, others: the points on the mesh of the solve and of the computed body, (n, 3) m.
        stress: mean Cauchy stress of the cell that each tetrahedron is of, (m, 6) Pa: xx, yy, zz, xy, yz, xz.
        J: mean volume ratio there, (m,).
        stretches: principal stretches in the middle of that cell, largest first, (m, 3).
    """

    mesh: Floats
    others: Floats
    stress: Floats
    J: Floats
    stretches: Floats

    @property
    def full_stress(self) -> Floats:
        """The stress as matrices row by row, (m, 9) Pa."""
        full = np.empty((len(self.stress), 3, 3))
        for column, (i, j) in enumerate(COMPONENTS.values()):
            full[:, i, j] = full[:, j, i] = self.stress[:, column]
        return full.reshape(-1, 9)


@dataclass(frozen=True)
class Interior:
    """Tetrahedra that fill a body.

    Attributes:
        points: (n, 3) m of the given mesh.
        tetrahedra: rows of ``points``, (m, 4).
        regions: for each name of a region of cells, the tetrahedra in it, (m,).
        results: for each state of the body; empty before a run.
        joined: whether the body has more cells than these.
    """

    points: Floats
    tetrahedra: Ints
    regions: Mapping[str, npt.NDArray[np.bool_]] = field(default_factory=dict)
    results: tuple[InteriorResult, ...] = ()
    joined: bool = False

    def interfaces(self) -> tuple[Ints, Ints]:
        """Return the triangles between tetrahedra of different regions.

        Returns:
            Rows of ``points``, (k, 3), and the tetrahedra on the two sides of each, (k, 2).
        """
        marks = np.stack([np.zeros(len(self.tetrahedra), dtype=bool), *self.regions.values()], axis=1)
        label = np.unique(marks, axis=0, return_inverse=True)[1].reshape(-1)
        faces, place = unique_rows(np.sort(self.tetrahedra[:, _SIDES].reshape(-1, 3), axis=1))
        order = np.argsort(place, kind="stable")
        first = np.flatnonzero(np.diff(place[order], prepend=-1))
        pairs = first[np.diff(first, append=len(order)) == 2]
        owners = np.stack([order[pairs], order[pairs + 1]], axis=1) // len(_SIDES)
        between = label[owners[:, 0]] != label[owners[:, 1]]
        return faces[place[order[pairs[between]]]], owners[between]


def write_interior(path: Path, interior: Interior) -> None:
    """Write it as compressed NumPy arrays (.npz) in single precision; raises ``OutputError`` if that fails."""
    arrays: dict[str, Any] = {
        "points": interior.points.astype(np.float32),
        "tetrahedra": interior.tetrahedra.astype(np.int32),
        "joined": np.array(interior.joined),
    }
    arrays |= {_REGION + name: mask for name, mask in interior.regions.items()}
    for i, result in enumerate(interior.results):
        arrays |= {f"{i}:{name}": value.astype(np.float32) for name, value in vars(result).items()}
    write_arrays(path, arrays)


def read_interior(path: Path) -> Interior | None:
    """Read what `write_interior` wrote; ``None`` if there is no such file.

    Raises:
        OutputError: it is damaged, or of another version of hpcinv.
    """
    try:
        with np.load(admitted(path)) as stored:
            arrays = dict(stored)
        count = sum(key.endswith(":J") for key in arrays)
        names = InteriorResult.__dataclass_fields__
        results = tuple(
            InteriorResult(**{name: arrays[f"{i}:{name}"].astype(np.float64) for name in names}) for i in range(count)
        )
        interior = Interior(
            arrays["points"].astype(np.float64),
            arrays["tetrahedra"].astype(np.int64),
            {key.removeprefix(_REGION): mask for key, mask in arrays.items() if key.startswith(_REGION)},
            results,
            bool(arrays["joined"]),
        )
        _check_sizes(interior)
    except FileNotFoundError:
        return None
    except DAMAGE as error:
        raise OutputError(f"{path}: cannot be read: {error}", _AGAIN) from error
    return interior


def _check_sizes(interior: Interior) -> None:
    """Raise ``ValueError`` unless each array has a row for each point or tetrahedron."""
    points, rows, count = interior.points.shape, interior.tetrahedra, len(interior.tetrahedra)
    fits = points[1:] == (3,) and rows.shape == (count, 4)
    fits &= all(mask.shape == (count,) for mask in interior.regions.values())
    for result in interior.results:
        fits &= result.mesh.shape == result.others.shape == points
        shapes = result.stress.shape, result.J.shape, result.stretches.shape
        fits &= shapes == ((count, 6), (count,), (count, 3))
    if not fits or not 0 <= rows.min(initial=0) <= rows.max(initial=0) < max(len(interior.points), 1):
        raise ValueError("its arrays do not fit together")


@dataclass(frozen=True)
class Section:
    """Triangles where a plane cuts tetrahedra.

    Attributes:
        points: (n, 3) m, three for each triangle in turn.
        rows: the tetrahedron of each triangle, (n / 3,).
    """

    points: Floats
    rows: Ints

    @property
    def triangles(self) -> Ints:
        """Rows of ``points``, (n / 3, 3)."""
        return np.arange(len(self.points)).reshape(-1, 3)


def cut_tetrahedra(points: Floats, tetrahedra: Ints, normal: Floats, place: float) -> Section:
    """Return the section of tetrahedra by the plane ``normal · x = place``."""
    heights = points @ normal - place
    heights = np.where(heights == 0.0, np.finfo(float).tiny, heights)  # a point on the plane counts as above it
    above = heights[tetrahedra] > 0
    triangles, rows = list[Floats](), list[Ints]()
    for pattern in range(1, 15):
        upper = [k for k in range(4) if pattern >> k & 1]
        lower = [k for k in range(4) if not pattern >> k & 1]
        chosen = np.flatnonzero((above == [k in upper for k in range(4)]).all(axis=1))
        if not len(chosen):
            continue
        corners = tetrahedra[chosen]
        crossings = [_crossing(points, heights, corners[:, a], corners[:, b]) for a, b in _around(upper, lower)]
        for k in range(1, len(crossings) - 1):
            triangles.append(np.stack([crossings[0], crossings[k], crossings[k + 1]], axis=1))
            rows.append(chosen)
    if not rows:
        return Section(np.zeros((0, 3)), np.zeros(0, dtype=np.int64))
    return Section(np.concatenate(triangles).reshape(-1, 3), np.concatenate(rows))


def _around(upper: Sequence[int], lower: Sequence[int]) -> list[tuple[int, int]]:
    """Edges from vertices above to those below in the order around the section."""
    edges = [(a, b) for a in upper for b in lower]
    return edges if len(edges) == 3 else [edges[0], edges[1], edges[3], edges[2]]


def _crossing(points: Floats, heights: Floats, first: Ints, second: Ints) -> Floats:
    share = heights[first] / (heights[first] - heights[second])
    return np.asarray(points[first] + share[:, None] * (points[second] - points[first]))
