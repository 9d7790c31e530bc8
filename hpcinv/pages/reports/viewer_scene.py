"""The body of a run as arrays for the page: shapes, steps, stresses, regions, fibres, supports and loads."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hpcinv.base.quantity.arrays import Floats
from hpcinv.base.quantity.stress_measures import COMPONENTS
from hpcinv.base.quantity.units import parse_quantity
from hpcinv.job.mesh_file import IMAGES
from hpcinv.output.surfaces.boundary_surface import Boundary, BoundaryResult
from hpcinv.output.surfaces.decimation import MOST, Decimated, decimated
from hpcinv.output.surfaces.interior import Interior, InteriorResult
from hpcinv.output.surfaces.snapshots import Snapshot
from hpcinv.pages.pictures.result_picture import upwards
from hpcinv.pages.reports.packed_arrays import PackedArrays
from hpcinv.pages.reports.symbols import symbols

_STATES = 3  # of the largest surface; more states have fewer points
_FIBRES = 3_000  # lines of one family
_STEPS_SIZE = 1_600_000  # bytes of the displacements of steps
_MASKS = 16  # regions in one array of bits
_OPPOSITE = {"L": "R", "R": "L", "P": "A", "A": "P", "S": "I", "I": "S"}


def scene(
    summary: Mapping[str, Any],
    boundary: Boundary,
    snapshots: Sequence[Snapshot],
    arrays: PackedArrays,
    interior: Interior | None = None,
) -> dict[str, Any]:
    """Add the body to ``arrays``; return what they mean as plain data, with the rows of the points as ``kept``.

    Args:
        interior: with as many results as the boundary.
    """
    most = MOST if len(boundary.results) <= _STATES else MOST * _STATES // len(boundary.results)
    kept = _kept(boundary, most)
    up = upwards(summary["job"])
    steps = _steps(snapshots, kept, boundary, arrays)
    return {
        "name": summary["job"]["job"],
        "choice": "State",
        "kept": kept.points,
        "points": len(kept.points),
        "triangles": arrays.add_whole(kept.triangles),
        "of": {"points": len(boundary.points), "triangles": len(boundary.triangles)},
        "shell": bool(boundary.faces),
        "decimated": len(kept.points) < len(boundary.points),
        "up": [0.0, 0.0, 1.0] if up is None else (up / np.linalg.norm(up)).tolist(),
        "axes": axes_of(summary["job"].get("mesh") or {}),
        "units": shown_units(summary),
        "interior": packed_interior(interior, arrays),
        "regions": regions_of(boundary, kept, arrays, interior),
        "error": None if boundary.error is None else arrays.add(boundary.error[kept.rows]),
        "fibres": {"every": _every(kept), "families": _lines(boundary.fibres, kept, arrays)},
        "results": [
            _result(summary, boundary, result, kept, arrays)
            | {"interior": interior and _inner_result(interior.results[number], arrays)}
            | {"steps": [step for step in steps if step["solution"] == number]}
            for number, result in enumerate(boundary.results)
        ],
    }


def _kept(boundary: Boundary, most: int) -> Decimated:
    """Part of the points that snapshots have, so that these can be drawn."""
    first = decimated(boundary.points, boundary.triangles)
    again = decimated(boundary.points[first.points], first.triangles, most)
    return Decimated(first.points[again.points], again.triangles, first.rows[again.rows])


def _result(
    summary: Mapping[str, Any], boundary: Boundary, result: BoundaryResult, kept: Decimated, arrays: PackedArrays
) -> dict[str, Any]:
    states = summary.get("states", {})
    rest = next((name for name, state in states.items() if state["rest"]), "undeformed")
    state_section: Mapping[str, Any] = next(
        (s for s in summary["job"].get("states") or () if s["name"] == result.state), {}
    )
    loads = symbols(summary["job"], state_section, boundary, summary.get("units"))
    place = {int(old): new for new, old in reversed(list(enumerate(kept.rows)))}
    for symbol in loads:
        symbol["rows"] = [place[row] for row in symbol["rows"] if row in place]
    stress = np.stack([result.stress.reshape(-1, 3, 3)[:, i, j] for i, j in COMPONENTS.values()], axis=1)
    load = next((s["load"] for s in summary["solutions"] if s.get("state", "") == result.state), 1.0)
    return {
        "title": result.state or "deformed",
        "direction": result.direction,
        "undeformed": rest,
        "deformed": result.state or "deformed",
        "load": load,
        "mesh": arrays.add(result.mesh[kept.points]),
        "displacement": arrays.add((result.others - result.mesh)[kept.points]),
        "stress": arrays.add(stress[kept.rows]),
        "J": arrays.add(result.J[kept.rows]),
        "stretches": arrays.add(result.stretches[kept.rows]),
        "crossing": arrays.add_whole(result.crossing[kept.rows]) if result.crossing.any() else None,
        "fibres": _lines(result.fibres, kept, arrays),
        "symbols": loads,
    }


def _every(kept: Decimated) -> int:
    return -(-len(kept.rows) // _FIBRES)


def _lines(fibres: Mapping[str, Floats], kept: Decimated, arrays: PackedArrays) -> dict[str, int]:
    """Add the directions of each family on every n-th triangle."""
    return {name: arrays.add(directions[kept.rows][:: _every(kept)]) for name, directions in fibres.items()}


def regions_of(boundary: Boundary, kept: Decimated, arrays: PackedArrays, interior: Interior | None) -> dict[str, Any]:
    """Names and, in bits of whole numbers, the triangles and tetrahedra of each region that has some."""
    inner = interior.regions if interior else {}
    names = [name for name, marks in boundary.regions.items() if marks.any()]
    names += [name for name, marks in inner.items() if marks.any() and name not in names]
    rows, cells = len(kept.rows), len(interior.tetrahedra) if interior else 0
    outer_marks = {name: boundary.regions[name][kept.rows] for name in names if name in boundary.regions}
    return {
        "names": names,
        "masks": _bits(names, outer_marks, rows, arrays),
        "inner": _bits(names, inner, cells, arrays) if interior else [],
    }


def _bits(
    names: Sequence[str], marks: Mapping[str, npt.NDArray[np.bool_]], count: int, arrays: PackedArrays
) -> list[int]:
    words = []
    for begin in range(0, len(names), _MASKS):
        word = np.zeros(count, dtype=np.int64)
        for k, name in enumerate(names[begin : begin + _MASKS]):
            if name in marks:
                word |= marks[name].astype(np.int64) << k
        words.append(arrays.add_whole(word))
    return words


def packed_interior(interior: Interior | None, arrays: PackedArrays) -> dict[str, Any] | None:
    """Add the tetrahedra of sections and the interfaces of their regions; ``None`` without an interior."""
    if interior is None:
        return None
    interfaces, owners = interior.interfaces()
    return {
        "points": arrays.add(interior.points),
        "tetrahedra": arrays.add_whole(interior.tetrahedra),
        "interfaces": arrays.add_whole(interfaces),
        "owners": arrays.add_whole(owners),
        "joined": interior.joined,
    }


def _inner_result(result: InteriorResult, arrays: PackedArrays) -> dict[str, int]:
    return {
        "mesh": arrays.add(result.mesh),
        "displacement": arrays.add(result.others - result.mesh),
        "stress": arrays.add(result.stress),
        "J": arrays.add(result.J),
        "stretches": arrays.add(result.stretches),
    }


def shown_units(summary: Mapping[str, Any]) -> dict[str, list[float | str]]:
    """Size and symbol of the units that the job chose, by SI unit."""
    symbols = summary.get("units") or {}
    return {unit: [parse_quantity(f"1 {symbol}")[0], symbol] for unit, symbol in symbols.items()}


def axes_of(mesh: Mapping[str, Any]) -> list[list[str]]:
    """Letters at the low and high ends of x, y and z: sides of the patient for an image, else the axis."""
    if Path(str(mesh.get("file") or mesh.get("image") or mesh.get("lumen") or "")).suffix not in IMAGES:
        return [["", axis] for axis in "xyz"]
    return [[_OPPOSITE[letter], letter] for letter in str(mesh.get("orientation") or "LPS")]


def _steps(
    snapshots: Sequence[Snapshot], kept: Decimated, boundary: Boundary, arrays: PackedArrays
) -> list[dict[str, Any]]:
    """The steps between the first and the last, as many as there is room for."""
    usable = [s for s in snapshots if s.solution < len(boundary.results) and np.isin(kept.points, s.points).all()]
    room = max(2, _STEPS_SIZE // max(1, 8 * len(kept.points)))
    chosen = np.unique(np.linspace(0, len(usable) - 1, min(room, len(usable))).astype(int)).tolist()
    return [
        {
            "solution": snapshot.solution,
            "load": snapshot.load,
            "residual": snapshot.residual if np.isfinite(snapshot.residual) else None,
            "displacement": arrays.add(snapshot.displacement[np.searchsorted(snapshot.points, kept.points)]),
        }
        for snapshot in (usable[i] for i in chosen)
    ]
