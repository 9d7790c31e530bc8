"""A tetrahedral mesh with its vertices, cells and nodes in another order is the same body: no result may change."""

from __future__ import annotations

import dataclasses
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import NO_CERTIFICATE, ROOT
from helpers.mesh_cases import spec
from helpers.verification import job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh.body import read_source
from hpcinv.mesh.mesh_files import save
from hpcinv.mesh.source import MeshSource
from hpcinv.output.result import Result

EVEN = [p for p in permutations(range(4)) if np.linalg.det(np.eye(4)[list(p)]) > 0]


def bar() -> MeshSource:
    parameters = {"nx": 3, "ny": 1, "nz": 1, "lx": "0.3 m", "ly": "0.1 m", "lz": "0.1 m"}
    source = read_source(spec(ROOT / "meshes" / "box.py", parameters=parameters), ROOT / "meshes" / "box.py")
    x, y, z = source.points.T
    sheared = np.column_stack([x + 0.1 * y, y + 0.2 * z * x / 0.3, z])  # cells of many shapes
    return dataclasses.replace(source, points=sheared, facets=source.facets[:0], groups=())


def renumbered(source: MeshSource) -> MeshSource:
    random = np.random.default_rng(3)
    turns = np.array(EVEN)[random.integers(len(EVEN), size=len(source.cells))]
    nodes, cells = random.permutation(len(source.points)), random.permutation(len(source.cells))
    place = np.argsort(nodes)
    turned = place[np.take_along_axis(source.cells, turns, axis=1)]
    return dataclasses.replace(
        source, points=source.points[nodes], cells=turned[cells], node_tags=source.node_tags[nodes]
    )


ONE = {"law": "neo-hookean", "mu": "3 kPa", "lam": "9 kPa"}
LAYERS = {
    "lower": {"law": "isochoric-neo-hookean", "mu": "3 kPa", "kappa": "incompressible"},
    "elsewhere": {"law": "isochoric-neo-hookean", "mu": "9 kPa", "kappa": "incompressible"},
}


def solved(path: Path, source: MeshSource, degree: int, material: dict[str, Any]) -> Result:
    save(path, source, source.points)
    quantities: list[dict[str, Any]] = [
        {"name": "largest", "of": "von_mises", "on": "body", "reduce": "max"},
        {"name": "ratio", "of": "J", "on": "body", "reduce": "min"},
        {"name": "energy", "of": "energy", "on": "body", "reduce": "integral", "over": "reference"},
    ]
    data = job(
        analysis="inverse",
        mesh={"file": str(path)},
        regions={"end": "x - 0.1*y < 1e-9 m", "body": "x > -1 m", "lower": "z < 0.051 m"},
        material=material,
        effects=[{"effect": "gravity", "acceleration": [1, -9, 3], "density": 100}],
        supports=[{"region": "end", "fix": ["x", "y", "z"]}],
        discretisation={"displacement": degree},
        solver={"tolerance": 1e-12},
        quantities=quantities,
        certificate=NO_CERTIFICATE | {"estimate": degree == 2},
    )
    return hpcinv.run(data, MPI.COMM_SELF)


@pytest.mark.everyday("3-material0")
@pytest.mark.parametrize(("degree", "material"), [(3, ONE), (2, LAYERS)])
def test_no_result_depends_on_the_numbering_of_the_mesh(degree: int, material: dict[str, Any], tmp_path: Path) -> None:
    source = bar()
    other = renumbered(source)
    sources = {"a": source, "b": other}
    first, second = (solved(tmp_path / f"{name}.vtu", mesh, degree, material) for name, mesh in sources.items())
    assert second.quantities == pytest.approx(first.quantities, rel=1e-9)
    if degree == 2:
        assert first.estimate is not None
        assert second.estimate is not None
        assert second.estimate.quantities == pytest.approx(first.estimate.quantities, rel=1e-6)
    size = first.solutions[0].largest_displacement
    by_place = []
    for result in (first, second):
        shape, given = result.solutions[0].other_nodes, result.solutions[0].mesh_nodes
        by_place.append(shape[np.lexsort(np.round(given, 9).T)])
    assert np.abs(by_place[1] - by_place[0]).max() < 1e-10 * size
