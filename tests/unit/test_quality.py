"""The worst cells of moved bodies, and the planes of symmetry that they must not cross, on any number of ranks."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.mesh_cases import TETRAHEDRON, spec, write_msh22
from helpers.verification import job

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh import Body, build_body
from hpcinv.mesh.cells import scalar_element
from hpcinv.mesh.quality import curvature, mean_ratio, scaled_jacobian, worst_cells
from hpcinv.mesh.symmetry import symmetry_planes
from hpcinv.trust.certificate.check import Verdict
from hpcinv.trust.certificate.shape import cells

pytestmark = pytest.mark.slow

REGULAR = np.array([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)], dtype=float)


def nodes_of(body: Body) -> np.ndarray:
    return body.mesh.geometry.x * body.length_scale


def mirrored(nodes: np.ndarray) -> np.ndarray:
    return nodes * np.array([1.0, 1.0, -1.0])


def test_mean_ratios_are_those_known() -> None:
    rng = np.random.default_rng(1)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    corner = np.array(TETRAHEDRON)
    flat = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)], dtype=float)
    tetrahedra = np.stack([REGULAR, 1e-3 * REGULAR @ turn, corner, flat, corner * np.array([1, 1, 1e-4])])
    # 3V = 1/2 and edges of 1 and √2; of the flat one 3V = 1e-4/2, and three edges of its foot hold all the length
    exact = [1, 1, 12 * 0.5 ** (2 / 3) / 9, 0, 12 * (1e-4 / 2) ** (2 / 3) / (4 + 2 + 3e-8)]
    shapes = mean_ratio(tetrahedra)
    assert np.abs(shapes) == pytest.approx(exact, rel=1e-12, abs=1e-16)
    assert shapes[2] > 0
    assert mean_ratio(mirrored(tetrahedra)) == pytest.approx(-shapes, rel=1e-12, abs=1e-16)

    # The other form of it, 3 det(S)^(2/3) / tr SᵀS, where S takes the regular tetrahedron to the cell
    random = rng.normal(size=(50, 4, 3))
    edges, regular = random[:, 1:] - random[:, :1], REGULAR[1:] - REGULAR[:1]
    S = np.linalg.solve(regular, edges)
    det = np.linalg.det(S) * np.linalg.det(regular)
    exact_ratio = 3 * np.abs(np.linalg.det(S)) ** (2 / 3) / (S**2).sum(axis=(1, 2)) * np.sign(det)
    assert mean_ratio(random) == pytest.approx(exact_ratio, rel=1e-9)


def test_scaled_jacobians_are_those_known() -> None:
    cube: np.ndarray = scalar_element("hexahedron", 1).points
    shear = np.array([[1, 0, 0], [0, 1, 0], [0.75, 0, 1]])  # the upright edges become (0.75, 0, 1), 1.25 long
    dented = cube.copy()
    dented[7] = 0.4  # beyond the middle of its three neighbours, where the corner would be flat: at 2/3
    edges = dented[[3, 5, 6]] - dented[7]
    corner = -np.linalg.det(edges) / np.linalg.norm(edges, axis=1).prod()
    shapes = np.stack([cube, cube * np.array([1, 10, 1e-3]), cube @ shear, cube * np.array([1, 1, 0]), dented])
    assert abs(corner) > 0.1
    assert scaled_jacobian(shapes) == pytest.approx([1, 1, 0.8, 0, -abs(corner)], abs=1e-14)
    assert scaled_jacobian(mirrored(shapes))[:3] == pytest.approx([-1, -1, -0.8])


@pytest.mark.parametrize("kind", ["tetrahedron", "hexahedron"])
def test_curvature_agrees_with_a_middle_moved_along_its_edge(kind: str) -> None:
    """With the middle nodes of all edges along x moved by δ, ``∂x/∂ξ = 1 + 4 δ (1 - 2ξ)`` on these edges."""
    straight: np.ndarray = scalar_element(kind, 2).points
    middle = straight[:, 0] == 0.5
    on_edge = middle & (straight[:, 1:] == 0).all(axis=1) if kind == "tetrahedron" else middle
    for delta in (0.0, 0.05, 0.3):
        moved = straight + delta * np.outer(on_edge, [1, 0, 0])
        shapes = curvature(kind, 2, moved[None], straight)
        assert shapes == pytest.approx([(1 - 4 * delta) / (1 + 4 * delta)], abs=1e-14)


@pytest.mark.parallel([1, 2])
def test_the_worst_cell_of_a_body_is_found_where_it_is(comm: MPI.Intracomm, meshes: Path, run_directory: Path) -> None:
    for hexahedra, name, whole in ((False, "mean ratio", 12 * 0.5 ** (2 / 3) / 11), (True, "scaled Jacobian", 1.0)):
        parameters = {"lx": 4.0, "ly": 3.0, "lz": 3.0, "nx": 4, "ny": 3, "nz": 3, "hexahedra": hexahedra}
        for degree in (1, 2):
            body = build_body(spec(meshes / "box.py", parameters=parameters, geometry_degree=degree), {}, comm)
            given = nodes_of(body)
            # Of the six tetrahedra of a unit cube the worst have edges of 1, 1, √2, √2, √2, √3.
            worst = worst_cells(body, given, 7 * given, 4)
            assert [w.measure for w in worst] == ([name] if degree == 1 else [name, "curvature"])
            assert [worst[0].value, worst[0].given_value] == pytest.approx([whole] * 2, rel=1e-10)
            assert [w.value for w in worst[1:]] == pytest.approx(
                [1.0] * (degree - 1), abs=1e-10
            )  # as gmsh has its nodes
            # One corner of the block is pushed in along the diagonal: a cube is flat there at 2/3 of it.
            at_corner = (given < 1e-6).all(axis=1)
            for depth in (0.2, 0.9):
                worst = worst_cells(body, given, given + depth * np.outer(at_corner, [1, 1, 1]), 4)
                assert comm.allgather(worst) == [worst] * comm.size
                assert worst[0].given_value == pytest.approx(whole, rel=1e-10)
                assert (worst[0].value < 0) == (depth > 2 / 3)
                assert worst[0].value < 0.95 * whole
                assert np.abs(np.array(worst[0].point) - 0.5).max() < 0.5
                assert degree == 1 or (worst[1].value < 0.1 and np.abs(np.array(worst[1].point) - 0.5).max() < 0.5)

    # A mesh that is numbered left-handed throughout is as good as its mirror image.
    if comm.size == 1:
        path = write_msh22(run_directory / "left.msh", TETRAHEDRON, [(4, 1, 1, (2, 1, 3, 4))], [(3, 1, "body")])
        left = build_body(spec(path), {}, comm)
        (found_left,) = worst_cells(left, nodes_of(left), mirrored(nodes_of(left)), 1)
        assert found_left.given_value == pytest.approx(12 * 0.5 ** (2 / 3) / 9)
        assert found_left.value == pytest.approx(-found_left.given_value)


@pytest.mark.everyday("0.8")
@pytest.mark.parallel([1, 2])
@pytest.mark.parametrize("share", [0.2, 0.8])
def test_a_valid_curved_cell_does_not_fail_by_its_corners(
    share: float, comm: MPI.Intracomm, run_directory: Path
) -> None:
    """``x + a y²`` keeps each volume; it takes the apex of a flat cell to the other side of its base for a/4 > t."""
    points = [(0, 0, 0), (0, 1, 0), (0, 0, 1), (0.1, 0.5, 0.25), (-1, 0.3, 0.3)]
    path = run_directory / "flat.msh"
    if comm.rank == 0:
        write_msh22(path, points, [(4, 1, 1, (2, 1, 3, 4)), (4, 1, 1, (1, 2, 3, 5))], [(3, 1, "body")])
    comm.barrier()
    supports = [{"region": "boundary", "fix": ["x", "y", "z"]}]
    held = job(mesh={"file": str(path)}, material={"law": "neo-hookean", "mu": 1.0, "lam": 4.0}, supports=supports)
    for degree in (1, 2):
        body = build_body(spec(path), {}, comm, degree=degree)
        given = nodes_of(body)
        moved = given + share * np.outer(given[:, 1] ** 2, [1, 0, 0])
        model: Any = SimpleNamespace(body=body, quadrature_degree=4)
        solution: Any = SimpleNamespace(job=held, is_on_given_mesh=True, mesh_nodes=given, other_nodes=moved)
        lines = list(cells(model, solution))
        turned = share > 0.4
        verdicts = [Verdict.WARN if turned else Verdict.PASS, Verdict.PASS]
        assert [line.verdict for line in lines] == (
            verdicts if degree == 2 else [Verdict.FAIL if turned else Verdict.PASS]
        )
        assert (lines[0].value is not None and lines[0].value < 0) is turned
        assert degree == 1 or lines[1].value == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parallel([1, 2])
def test_a_body_that_went_through_its_planes_of_symmetry(comm: MPI.Intracomm, meshes: Path) -> None:
    octant = {"file": "../meshes/thick_sphere.py", "parameters": {"radial": 2, "along": 2, "hexahedra": True}}
    material = {"law": "neo-hookean", "mu": 1.0, "lam": 4.0}
    three = job(mesh=octant, material=material, supports=[{"region": f"{a}0", "fix": [a]} for a in "xyz"])
    body = build_body(three.mesh, {}, comm, resolve=three.resolve)
    given = nodes_of(body)
    still = symmetry_planes(three, body, given, 1.3 * given)
    assert [(p.region, p.position, p.crossed) for p in still] == [(f"{axis}0", 0.0, 0.0) for axis in "xyz"]
    np.testing.assert_array_equal([p.normal for p in still], np.eye(3))
    # r -> (1 - r)²/… as far as the inner radius has gone through the centre by 0.1
    through = given * (1.2 - 0.7 / np.linalg.norm(given, axis=1, keepdims=True))
    planes = symmetry_planes(three, body, given, through)
    assert [p.crossed for p in planes] == pytest.approx([0.1] * 3, rel=1e-12)
    assert [p.region for p in planes] == ["x0", "y0", "z0"]
    np.testing.assert_array_equal([p.normal for p in planes], np.eye(3))

    block = {"file": "../meshes/box.py", "parameters": {"nx": 2, "ny": 2, "nz": 2}}
    others = [
        {"region": "x0", "fix": ["x"]},  # with the next: held against sliding, too
        {"region": "x0", "fix": ["y"]},
        {"region": "x1", "fix": ["x", "y", "z"]},
        {"region": "y1", "displacement": [None, 0.1, None]},
        {"region": "half", "fix": ["z"]},  # a rest of half the block: the other half may sag
        {"region": "y0", "fix": ["x"]},
        {"region": "z1", "fix": ["z"]},
    ]
    regions = {"half": "z < 1e-6 m and x < 0.6 m"}
    rest = job(mesh=block, regions=regions, material=material, supports=others)
    body = build_body(rest.mesh, rest.regions, comm, resolve=rest.resolve)
    given = nodes_of(body)
    (only,) = symmetry_planes(rest, body, given, given + 0.25)
    assert (only.region, only.position) == ("z1", pytest.approx(1.0))
    np.testing.assert_array_equal(only.normal, [0.0, 0.0, 1.0])
    assert only.crossed == pytest.approx(0.25)
