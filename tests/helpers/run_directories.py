"""Directories as runs leave them, made from formulas: no kernel is compiled, and nothing is solved."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hpcinv.output.surfaces.boundary_surface import NAME, Boundary, BoundaryResult, write_boundary
from hpcinv.output.surfaces.interior import NAME as INTERIOR
from hpcinv.output.surfaces.interior import Interior, InteriorResult, write_interior
from hpcinv.output.surfaces.snapshots import NAME as SNAPSHOTS
from hpcinv.output.surfaces.snapshots import Snapshot, write_snapshot

SIZE = 0.1  # m, side of the block
STRESS = np.array([[3.0, 1.0, 0.0], [1.0, -2.0, 0.5], [0.0, 0.5, 1.0]]) * 1e3  # Pa, on the first triangle


def cube(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (m) and outward triangles of the surface of a block with ``n`` squares along each side."""
    grid = np.stack(np.meshgrid(*3 * [np.arange(n + 1)], indexing="ij"), axis=-1).reshape(-1, 3)
    is_outer = ((grid == 0) | (grid == n)).any(axis=1)
    number = np.full((n + 1) ** 3, -1)
    number[is_outer] = np.arange(is_outer.sum())
    triangles = []
    i, j = (axis_numbers.ravel() for axis_numbers in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
    for axis in range(3):
        for side in (0, n):
            squares = []
            for a, b in ((0, 0), (1, 0), (1, 1), (0, 1)):
                places = np.empty((len(i), 3), dtype=int)
                places[:, axis], places[:, (axis + 1) % 3], places[:, (axis + 2) % 3] = side, i + a, j + b
                squares.append(number[(places * [(n + 1) ** 2, n + 1, 1]).sum(axis=1)])
            p, q, r, s = squares
            both = np.concatenate([np.stack([p, q, r], axis=1), np.stack([p, r, s], axis=1)])
            triangles.append(both if side else both[:, ::-1])
    return grid[is_outer] * (SIZE / n), np.concatenate(triangles)


def displaced(points: np.ndarray, load: float = 1.0) -> np.ndarray:
    """Displacement of a cantilever that bends, (n, 3) m."""
    x = points[:, 0] / SIZE
    return load * SIZE * np.stack([-0.1 * x**2, np.zeros_like(x), -0.35 * x**2], axis=1)


def boundary(n: int, states: Sequence[str] = ("",), *, crossing: bool = False) -> Boundary:
    """The block in some states, with stresses that grow along x."""
    points, triangles = cube(n)
    middle = points[triangles].mean(axis=1)
    share = middle[:, 0] / SIZE
    results = []
    for number, state in enumerate(states):
        stress = STRESS.ravel() * (1 + number + share - share[0])[:, None]
        results.append(
            BoundaryResult(
                state,
                "forward" if number else "inverse",
                points,
                points + (1 - 2 * (number == 0)) * displaced(points, 1 + 0.3 * number),
                stress=stress,
                J=1 + 0.01 * share,
                stretches=np.stack([1.1 + 0.1 * share, np.ones_like(share), 1 / (1.1 + 0.1 * share)], axis=1),
                crossing=(share > 0.8) & (middle[:, 2] > 0.09) & crossing,
                fibres={"along": np.tile([1.0, 0.0, 0.0], (len(share), 1))},
            )
        )
    return Boundary(
        points=points,
        triangles=triangles,
        regions={"clamp": middle[:, 0] < 1e-9, "top": middle[:, 2] > SIZE - 1e-9},
        results=tuple(results),
        error=0.01 * share,
        fibres={"along": np.tile([0.8, 0.0, 0.6], (len(share), 1))},
    )


def summary(states: Sequence[str] = ("",), *, status: str = "converged", **more: Any) -> dict[str, Any]:
    """What the summary of a run has that a report reads."""
    gravity = {"effect": "gravity", "case": None, "acceleration": [0.0, 0.0, -9.81], "density": 1000.0}
    line = {"unit": "", "rule": "fail above 1", "verdict": "pass", "note": "", "seconds": 0.25}
    iterations = [{"correction": 10.0**-k, "state": 2.0, "residual": 10.0**-k, "new_tangent": k == 0} for k in range(5)]
    solves = [
        {
            "strategy": "load steps",
            "load": load,
            "outcome": "CONVERGED",
            "factorizations": 1,
            "linear_iterations": 0,
            "position_residual": None,
            "iterations": iterations,
        }
        for load in (0.25, 0.5, 0.75, 1.0)
    ]
    solutions = [
        {
            **({"state": state} if state else {}),
            "direction": "forward" if number else "inverse",
            "load": 1.0 if status == "converged" else 0.75,
            "largest_displacement": 0.0364,
            "factorizations": 4,
            "newton_iterations": 20,
            "linear": {"configuration": "direct", "why": "small", "iterations": 0, "fallback": None, "note": ""},
            "solves": solves if status == "converged" else solves[:3],
        }
        for number, state in enumerate(states)
    ]
    named = {s: {"given": s == states[0], "rest": False, "solution": i} for i, s in enumerate(states) if s}
    effects = [gravity, {"effect": "pressure", "region": "top", "pressure": 100.0}]
    verdict = "pass" if status == "converged" else "fail"
    content = {
        "status": status,
        "job": {
            "job": "block <&> beam",
            "analysis": "inverse",
            "supports": [{"region": "clamp", "fix": ["x", "y", "z"]}],
            "effects": [] if named else effects,
            "states": [{"name": s, "given": s == states[0], "effects": effects, "supports": None} for s in named],
            "quantities": [
                {"name": "tip", "of": "z", "on": "top", "reduce": "max"},
                {"name": "force", "of": "reaction", "on": "clamp"},
            ],
        },
        "fingerprint": {"analysis": "inverse", "mesh": {"sha256": "0" * 64}},
        "versions": {"hpcinv": "0", "dolfinx": None},
        "machine": {"ranks": 2, "omp_threads": 1},
        "mesh": {"file": "block.msh", "cells": 6000, "nodes": 1331, "kind": "tetrahedron", "unknowns": 3993},
        "body": {"size": 3 * [SIZE], "volume": 1e-3, "mass": 1.0, "load": [0.0, 0.0, -9.81], "warnings": []},
        "partition": {"cells": [3000, 3000]},
        **({"states": named | {"rest": {"given": False, "rest": True, "solution": None}}} if named else {}),
        "solutions": solutions,
        "quantities": {"tip": 0.0712345, "force": [0.0, 0.0, 9.81]},
        "errors": {},
        "certificate": {
            "verdict": verdict,
            "lines": [
                line | {"name": "equilibrium residual, relative to the load", "value": 3e-13},
                line | {"name": "smallest volume ratio J", "value": 0.99, "seconds": 0.05},
                line
                | {"name": "discretisation error of the shape, relative to the displacement", "value": 0.002}
                | {"seconds": 2.5},
                line | {"name": "stability", "value": None, "verdict": "not checked", "seconds": None},
            ]
            if status == "converged"
            else [line | {"name": "load factor", "value": 0.75, "verdict": "fail", "note": status}],
            "estimate": {
                "geometry": "included",
                "without_geometry": "",
                "quantities": {"tip": 2e-5},
                "corrected": {"tip": 0.0712545},
                "shape": 7e-5,
            }
            if status == "converged"
            else None,
        },
        "timings": {
            "total": 12.5,
            "phases": {"certificate": {"min": 2.0, "max": 3.0}, "factorization": {"min": 1.0, "max": 1.5}},
            "overhead": 0.05,
        },
        "peak_memory": {"ranks": [200_000_000, 210_000_000], "phases": {"certificate": {"max": 210_000_000}}},
    }
    return content | more


def interior(n: int, states: Sequence[str] = ("",)) -> Interior:
    """The block's inside as six tetrahedra for each of n³ cubes; the region ``core`` is a third of its side wide."""
    ways = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]]
    steps = np.array([[[0, 0, 0], *np.cumsum(np.eye(3, dtype=int)[way], axis=0)] for way in ways])
    grid = np.stack(np.meshgrid(*3 * [np.arange(n)], indexing="ij"), axis=-1).reshape(-1, 3)
    tetrahedra = ((grid[:, None, None] + steps) @ [(n + 1) ** 2, n + 1, 1]).reshape(-1, 4)
    points = np.stack(np.meshgrid(*3 * [np.arange(n + 1)], indexing="ij"), axis=-1).reshape(-1, 3) * (SIZE / n)
    middle = points[tetrahedra].mean(axis=1) / SIZE
    components = STRESS[[0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]
    results = []
    for number in range(len(states)):
        moved = (1 - 2 * (number == 0)) * displaced(points, 1 + 0.3 * number)
        share = middle[:, 0]
        stretches = np.stack([1.1 + 0.1 * share, np.ones_like(share), 1 / (1.1 + 0.1 * share)], axis=1)
        # Stresses are largest in the core, where no surface shows them.
        stress = components * (1 + number + 4 * (np.abs(middle - 0.5).max(axis=1) < 1 / 6))[:, None]
        results.append(InteriorResult(points, points + moved, stress, 1 + 0.01 * share, stretches))
    core = np.abs(middle - 0.5).max(axis=1) < 1 / 6
    return Interior(points, tetrahedra, {"core": core, "rest": ~core}, tuple(results))


def run_directory(
    path: Path,
    n: int = 8,
    states: Sequence[str] = ("",),
    *,
    steps: int = 3,
    crossing: bool = False,
    inside: int = 0,
    **more: Any,
) -> Path:
    """Make the directory of a run of the block, with snapshots of the first state.

    Args:
        inside: cubes along each side of the interior that is kept, if it is.
    """
    path.mkdir(parents=True)
    made = boundary(n, states, crossing=crossing)
    write_boundary(path / NAME, made)
    if inside:
        write_interior(path / INTERIOR, interior(inside, states))
    for i in range(steps):
        load = (i + 1) / (steps + 1)
        rows = np.arange(len(made.points))
        u = -displaced(made.points, load)
        write_snapshot(path / SNAPSHOTS, Snapshot(0, i + 1, states[0], load, np.nan, rows, u), most=20)
    (path / "summary.json").write_text(json.dumps(summary(states, **more)))
    return path
