"""Edges at which the stress has no bound: their exponents against published ones, and which edges of a body count."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from helpers.verification import box, job

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh import build_body
from hpcinv.trust.discretisation.discretisation_error import quantities_at_singular_fibres
from hpcinv.trust.discretisation.estimate import SingularLimit
from hpcinv.trust.discretisation.singular_edges import SingularEdges, singular_edges
from hpcinv.trust.discretisation.wedge_exponents import SMOOTH, Hold, axial_exponent, plane_exponent

FREE, SLIDING, CLAMPED = Hold.FREE, Hold.SLIDING, Hold.CLAMPED
NU_3, NU_5 = 1.8, 1.0  # 3 - 4ν


@pytest.mark.parametrize(
    ("degrees", "first", "second", "kappa", "exponent"),
    [
        (270, FREE, FREE, NU_3, 0.5445),  # the L-shaped body
        (360, FREE, FREE, NU_3, 0.5),  # a crack
        (225, FREE, FREE, NU_5, 0.6736),
        (90, CLAMPED, FREE, NU_3, 0.7112),  # the end of a cantilever
        (90, CLAMPED, FREE, NU_5, 0.5946),
        (180, CLAMPED, FREE, NU_3, 0.5),  # a rigid stamp
        (270, CLAMPED, CLAMPED, NU_5, 0.5445),
        (135, SLIDING, FREE, NU_3, 0.5445),  # half of the L-shaped body
        (90, SLIDING, FREE, NU_3, SMOOTH),
        (90, SLIDING, SLIDING, NU_3, SMOOTH),
        (90, FREE, FREE, NU_3, SMOOTH),
        (180, FREE, FREE, NU_3, SMOOTH),
    ],
)
def test_exponents_agree_with_williams(
    degrees: float, first: Hold, second: Hold, kappa: float, exponent: float
) -> None:
    for pair in ((first, second), (second, first)):
        assert plane_exponent(math.radians(degrees), *pair, kappa) == pytest.approx(exponent, abs=2.5e-3)


def test_exponents_along_an_edge() -> None:
    assert axial_exponent(3 * math.pi / 2, False, False) == pytest.approx(2 / 3)
    assert axial_exponent(math.pi, True, False) == pytest.approx(0.5)
    assert axial_exponent(math.pi / 2, True, False) == SMOOTH


def edges_of(comm: MPI.Intracomm, **data: Any) -> SingularEdges | None:
    its = job(material={"law": "neo-hookean", "mu": 1.0, "lam": 1.0}, **data)
    return singular_edges(its, build_body(its.mesh, its.regions, comm, resolve=its.resolve))


@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("hexahedra", [False, True])
def test_edges_of_a_clamped_block(comm: MPI.Intracomm, hexahedra: bool) -> None:
    edges = edges_of(
        comm, mesh=box((2, 2, 2), hexahedra=hexahedra), supports=[{"region": "z0", "fix": ["x", "y", "z"]}]
    )
    assert edges is not None
    assert len(edges.segments) == 8  # two on each side of the bottom
    assert np.abs(edges.segments[:, :, 2]).max() == 0.0
    assert edges.segment_exponents == pytest.approx(0.7112, abs=2.5e-3)
    assert set(np.array(edges.names)[edges.kinds[edges.kinds >= 0]]) <= {"edge of the support 'z0'"}
    at_bottom = comm.allreduce(int(np.count_nonzero(edges.exponents < SMOOTH)), op=MPI.SUM)
    assert 0 < at_bottom < comm.allreduce(len(edges.exponents), op=MPI.SUM)


def test_planes_of_symmetry_end_in_no_singular_edge(comm: MPI.Intracomm) -> None:
    supports = [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"]
    assert edges_of(comm, mesh=box((2, 2, 2)), supports=supports) is None
    sphere = {"file": "../meshes/thick_sphere.py", "parameters": {"radial": 1, "along": 2}, "geometry_degree": 1}
    assert edges_of(comm, mesh=sphere, supports=supports) is None  # facets of its hole meet under re-entrant angles


def test_a_support_that_ends_within_a_face_counts(comm: MPI.Intracomm) -> None:
    edges = edges_of(
        comm,
        mesh=box((2, 2, 2), hexahedra=True),
        regions={"half": "z < 1e-6 m and x < 0.5001 m"},
        supports=[{"region": "half", "fix": ["x", "y", "z"]}],
    )
    assert edges is not None
    within = edges.segment_exponents[np.abs(edges.segments[:, :, 0] - 0.5).max(axis=1) < 1e-9]
    assert within == pytest.approx([0.5] * 2, abs=2.5e-3)


def test_a_reentrant_edge_is_found_and_named(comm: MPI.Intracomm) -> None:
    slab = {"file": "../benchmarks/slabs/slab.py", "parameters": {"shape": "corner", "n": 1, "hexahedra": True}}
    supports = [{"region": "left", "fix": ["x", "y"]}, *({"region": side, "fix": ["z"]} for side in ("z0", "z1"))]
    edges = edges_of(comm, mesh=slab, supports=supports)
    assert edges is not None
    at_corner = np.abs(edges.segments[:, :, :2] - 1.0).max(axis=(1, 2)) < 1e-9
    assert edges.segment_exponents[at_corner] == pytest.approx([0.5445], abs=2.5e-3)
    assert edges.segment_exponents[~at_corner] == pytest.approx([0.7112] * 2, abs=2.5e-3)
    assert "re-entrant edge of 270°" in {edges.names[kind] for kind in edges.kinds if kind >= 0}


def test_errors_at_an_edge_fall_by_its_order() -> None:
    nothing = np.zeros(0)
    limit = SingularLimit(0.5, 1.0, 1.7, False, "edge", (0.0, 0.0, 0.0), nothing, nothing)
    assert limit.remaining(2.0, 2, 2) == pytest.approx(0.5 / 2 + 0.5 / 8)
    assert limit.least_remaining(1.0, 2, 3) == pytest.approx(0.5 * (2 / 3) ** 2)
    assert limit.doubt.startswith("not reliable here: edge at (0, 0, 0) m: errors fall by 0.5 where cells are halved")


@pytest.mark.parallel([2])
def test_fibres_that_wind_around_an_axis_are_singular_there(comm: MPI.Intracomm) -> None:
    supports = [{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"]  # no singular edges
    effects = [{"effect": "active-stress", "fibre": "f", "stress": 1.0}]
    for hexahedra, axis in itertools.product((False, True), (0.5, 0.4)):  # along edges of cells, and inside of cells
        mesh = box((4, 4, 2), hexahedra=hexahedra)
        wound, pitch = [f"-(Y - {axis} m)", f"X - {axis} m"], "0.1 m"  # it straightens the fibres at the axis
        smooth = {"f": {"direction": [*wound, pitch], "given_on": "reference"}}
        assert edges_of(comm, mesh=mesh, supports=supports, effects=effects, fibres=smooth) is None
        singular = {"f": {"direction": [*wound, "0 m"], "given_on": "reference"}}
        edges = edges_of(comm, mesh=mesh, supports=supports, effects=effects, fibres=singular)
        assert edges is not None
        assert {edges.names[kind] for kind in edges.kinds if kind >= 0} <= {"singular fibres"}
        middles = edges.segments.mean(axis=1)
        assert np.abs(middles[:, :2] - axis).max() < 0.02
        assert np.unique(np.floor(2 * middles[:, 2])).tolist() == [0, 1]  # all along the axis
        cells = comm.allreduce(int(np.count_nonzero(edges.exponents < SMOOTH)), op=MPI.SUM)
        assert cells == len(middles)
        if hexahedra:
            assert cells == (8 if axis == 0.5 else 2)


@pytest.mark.parallel([1, 2])
def test_quantities_at_singular_fibres_are_named(comm: MPI.Intracomm) -> None:
    fibres = {"f": {"direction": ["-(Y - 0.5 m)", "X - 0.5 m", "0 m"], "given_on": "reference"}}
    smooth = {"f": {"direction": ["1 m", "X", "0 m"], "given_on": "reference"}}
    for hexahedra, direction in itertools.product((False, True), (fibres, smooth)):
        its = job(
            material={"law": "neo-hookean", "mu": 1.0, "lam": 1.0},
            mesh=box((4, 4, 2), hexahedra=hexahedra),
            supports=[{"region": f"{axis}0", "fix": [axis]} for axis in "xyz"],
            effects=[{"effect": "active-stress", "fibre": "f", "stress": 1.0}],
            fibres=direction,
            quantities=[
                {"name": "tip", "of": "uz", "at": [0.5, 0.5, 1.0]},
                {"name": "side", "of": "uz", "at": [0.9, 0.5, 1.0]},
                {"name": "top", "of": "uz", "on": "z1", "reduce": "mean"},
            ],
        )
        body = build_body(its.mesh, its.regions, comm, resolve=its.resolve)
        names = quantities_at_singular_fibres(its.quantities, body, singular_edges(its, body))
        assert names == (("tip",) if direction is fibres else ())
