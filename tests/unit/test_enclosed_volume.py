"""Volumes of cavities with and without openings, and their derivatives, on 1 and 2 ranks."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
import pytest
from helpers.hollow_block import hollow_block

from hpcinv.base.parallel.runtime import MPI
from hpcinv.base.quantity.expressions import Expression
from hpcinv.errors import MeshError
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.mesh import build_body
from hpcinv.mesh.body import Body
from hpcinv.mesh.enclosed_volume import EnclosedVolume

SHEAR = np.array([[1.2, 0.3, -0.4], [0.1, 0.9, 0.2], [0.5, -0.3, 1.1]])
FAR = np.array([300.0, -200.0, 100.0])

CLOSED = {(1, 1, 1), (1, 2, 1)}
CHANNEL = {(1, 1, k) for k in range(3)} | {(2, 1, 1)}  # from bottom to top, with a niche
CORNER = {(0, 0, 0), (1, 0, 0)}  # an eighth of a cavity around the origin


def hollow_body(holes: set[tuple[int, int, int]], kind: str, degree: int, region: str) -> Body:
    source = hollow_block(holes, kind)
    spec = MeshSpec.model_construct(file="block.vtu", unit=1.0)
    return build_body(spec, {"hole": Expression(region)}, MPI.COMM_WORLD, degree=degree, replacement=source)


INSIDE = "x > 0.5 m and x < 3.5 m and y > 0.5 m and y < 3.5 m"
CASES: dict[str, tuple[set[tuple[int, int, int]], str, Sequence[float] | None, int, float]] = {
    "closed": (CLOSED, "cavity > 0", None, 0, 2.0),
    "channel": (CHANNEL, f"{INSIDE} and not (nz*nz > 0.5 and (z < 0.1 m or z > 2.9 m))", None, 2, 4.0),
    "eighth": (CORNER, "x < 2.1 m and y < 1.1 m and z < 1.1 m", (0.0, 0.0, 0.0), 1, 2.0),
}  # fmt: skip


@pytest.mark.parallel([1, 2])
def test_polyhedral_cavities() -> None:
    for case, (kind, degree) in product(CASES, [("tetrahedron", 1), ("hexahedron", 2)]):
        holes, region, apex, openings, exact = CASES[case]
        check_polyhedron(hollow_body(holes, kind, degree, region), apex, openings, exact)


def check_polyhedron(body: Body, apex: Sequence[float] | None, openings: int, exact: float) -> None:
    cavity = EnclosedVolume(body, ["hole"], apex)
    assert cavity.openings == openings
    assert cavity.volume(body.given_nodes) == pytest.approx(exact, rel=1e-13)
    assert (EnclosedVolume(body, ["hole"], None).unevenness(body.given_nodes) > 0.1) == (apex is not None)
    if apex is None:
        moved = body.given_nodes @ SHEAR.T + FAR  # openings are then oblique
        assert cavity.volume(moved) == pytest.approx(exact * np.linalg.det(SHEAR), rel=1e-11)


@pytest.mark.parallel([1, 2])
def test_curved_cavity() -> None:
    body = hollow_body(CHANNEL, "hexahedron", 2, CASES["channel"][1])
    cavity = EnclosedVolume(body, ["hole"], None)
    x, y, z = body.given_nodes.T
    curved = np.column_stack([x + 0.1 * x * y, y + 0.2 * z**2, z])  # volume ratio 1 + y/10
    assert cavity.volume(curved) == pytest.approx(4 * 1.15, rel=1e-13)


@pytest.mark.parallel([1, 2])
def test_derivatives() -> None:
    for holes, region, apex, *_ in CASES.values():
        check_derivative(hollow_body(holes, "tetrahedron", 2, region), apex)


def check_derivative(body: Body, apex: Sequence[float] | None) -> None:
    cavity = EnclosedVolume(body, ["hole"], apex)
    x, y, z = body.given_nodes.T
    nodes = body.given_nodes + 0.1 * np.column_stack([np.sin(y + z), np.cos(x * z), np.sin(x * y)])  # uneven rims
    step = np.column_stack([np.cos(z), np.sin(x + y), np.cos(2 * x)])
    slope, cell_nodes = 0.0, body.mesh.geometry.dofmaps[0]
    for cells, derivatives in cavity.gradient(nodes):
        slope += float((derivatives * step[cell_nodes[cells]]).sum())
    slope = body.mesh.comm.allreduce(slope)
    h = 1e-2  # a cubic polynomial: differences of both orders are exact
    v = [cavity.volume(nodes + k * h * step) for k in (-2, -1, 1, 2)]
    assert slope == pytest.approx((v[0] - 8 * v[1] + 8 * v[2] - v[3]) / (12 * h), rel=1e-11)


@pytest.mark.parallel([1, 2])
def test_outer_surfaces_are_refused() -> None:
    body = hollow_body(CLOSED, "tetrahedron", 1, "cavity < 1")
    with pytest.raises(MeshError, match="'hole' encloses no cavity"):
        EnclosedVolume(body, ["hole"], None)
