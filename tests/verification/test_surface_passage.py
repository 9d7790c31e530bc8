"""Bodies that one load step would carry through each other."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from helpers.verification import job

import hpcinv
from hpcinv.base.parallel.runtime import MPI
from hpcinv.errors import SolveError
from hpcinv.mesh import Body
from hpcinv.model.interfaces.facets import FacetKind, Facets, RegionFacets
from hpcinv.model.interfaces.one_body import OneBody
from hpcinv.model.interfaces.surface_passage import SurfacePassage, _passes
from hpcinv.model.spaces import Unknowns

BESIDE = """
def build(gmsh):
    low = gmsh.model.occ.addBox(0, 0, 0, 1, 1, 0.3)
    high = gmsh.model.occ.addBox(0.9, 0.25, 0.4, 0.5, 0.5, 0.3)
    gmsh.model.occ.synchronize()
    for block, lower, upper in ((low, "z0", "top"), (high, "bottom", "z1")):
        sides = [tag for _, tag in gmsh.model.getBoundary([(3, block)], oriented=False)]
        sides.sort(key=lambda tag: gmsh.model.occ.getCenterOfMass(2, tag)[2])
        gmsh.model.addPhysicalGroup(2, sides[:1], name=lower)
        gmsh.model.addPhysicalGroup(2, sides[-1:], name=upper)
    gmsh.model.addPhysicalGroup(3, [low, high], name="blocks")
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.4)
    gmsh.model.mesh.generate(3)
"""


def triangle(height: float) -> Facets:
    """A triangle whose outer normal is z."""
    points = np.array([[[0, 0, height], [1, 0, height], [0, 1, height]]], dtype=float)
    numbers = np.zeros((1, 3), dtype=np.int64)
    return Facets(FacetKind("triangle", 1), numbers, np.zeros((1, 3, 3), dtype=np.int64), points, np.ones(1))


@pytest.mark.parametrize(
    ("start", "end", "facet", "passes"),
    [
        ((0.2, 0.2, 1.0), (0.2, 0.2, -1.0), (0.0, 0.0), True),
        ((0.2, 0.2, -1.0), (0.2, 0.2, 1.0), (0.0, 0.0), False),
        ((0.2, 0.2, 1.0), (0.2, 0.2, -0.05), (0.0, 0.0), False),
        ((2.0, 0.2, 1.0), (0.2, 0.2, -1.0), (0.0, 0.0), False),
        ((0.2, 0.2, 0.0), (0.2, 0.2, 0.0), (-1.0, 1.0), True),
        ((0.2, 0.2, 1.0), (0.2, 0.2, -1.0), (0.0, -2.0), False),
    ],
    ids=["through", "out of it", "not deep", "next to it", "moving facet", "facet ahead"],
)
def test_ways_through_a_triangle(
    start: tuple[float, ...], end: tuple[float, ...], facet: tuple[float, float], passes: bool
) -> None:
    before, after = (np.array([[place]]) for place in (start, end))
    assert _passes(before, after, triangle(facet[0]), triangle(facet[1]), 0.1) is passes


def test_facets_of_one_body_that_may_not_meet_are_passed() -> None:
    """Rules of both ways name facets by their numbers on all ranks, first the facets of the first surface."""
    asked = list[tuple[list[int], list[int]]]()

    def may_meet(i: Any, j: Any) -> Any:
        asked.append((list(i), list(j)))
        return np.zeros(len(i), dtype=bool)

    one_body = cast(OneBody, SimpleNamespace(radius=0.01, starts=(3, 5), may_meet=may_meet))
    surfaces = cast(tuple[RegionFacets, RegionFacets], (None, None))
    body = cast(Body, SimpleNamespace(mesh=SimpleNamespace(comm=MPI.COMM_SELF), length=1.0))
    passage = SurfacePassage(surfaces, body, cast(Unknowns, None), one_body)
    assert passage._depth == 0.01
    assert SurfacePassage(surfaces, body, cast(Unknowns, None))._depth == 2.0**-6
    start, end = (np.array([[[0.2, 0.2, z]]]) for z in (1.0, -1.0))
    for rule in passage._rules:
        assert not _passes(start, end, triangle(0.0), triangle(0.0), 0.1, rule)
    assert asked == [([3], [0]), ([0], [5])]


def test_one_step_does_not_carry_a_body_through_another(tmp_path: Path) -> None:
    """The upper body faces the lower one with its edge; the step would end below it, without a force.

    In one step the body can only be crushed.
    """
    (tmp_path / "beside.py").write_text(BESIDE)
    down = {"region": "z1", "displacement": [-0.6, 0, -0.9]}
    posed = job(
        analysis="forward",
        mesh={"file": str(tmp_path / "beside.py")},
        material={"law": "neo-hookean", "mu": 1.0, "lam": 2.0},
        solver={"minimum_step": 0.9, "rescue": []},
        discretisation={"displacement": 1},
        supports=[{"region": "z0", "fix": ["x", "y", "z"]}, down],
        interfaces=[{"between": ["bottom", "top"], "kind": "contact"}],
    )
    with pytest.raises(SolveError, match="stopped at load factor 0 of 1"):
        hpcinv.run(posed, MPI.COMM_SELF)
