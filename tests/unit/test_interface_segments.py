"""Segments of two surfaces: exact integrals on flat interfaces, gaps of curved facets."""

from __future__ import annotations

from collections.abc import Callable

import basix
import numpy as np
import pytest

from hpcinv.mesh.cells import scalar_element
from hpcinv.model.interfaces.facets import FacetKind, Facets
from hpcinv.model.interfaces.segments import segments

type Height = Callable[[np.ndarray, np.ndarray], np.ndarray]


def sheet(kind: str, divisions: int, degree: int, height: Height, *, faces_up: bool, seed: int = 0) -> Facets:
    """A unit square with moved inner nodes; nodes of each facet are its own."""
    s = np.linspace(0, 1, divisions + 1)
    plane = np.stack(np.meshgrid(s, s, indexing="ij"), axis=-1)
    plane[1:-1, 1:-1] += np.random.default_rng(seed).uniform(-0.2, 0.2, plane[1:-1, 1:-1].shape) / divisions
    cells = []
    for i in range(divisions):
        for j in range(divisions):
            a, b, c, d = plane[i, j], plane[i + 1, j], plane[i, j + 1], plane[i + 1, j + 1]
            cells += [[a, b, c, d]] if kind == "quadrilateral" else [[a, b, d], [a, d, c]]
    corners = np.array(cells)
    shapes = scalar_element(kind, 1).tabulate(0, scalar_element(kind, degree).points)[0, :, :, 0]
    flat = np.einsum("av,cvt->cat", shapes, corners)
    points = np.concatenate([flat, height(flat[..., 0], flat[..., 1])[..., None]], axis=2)
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    signs = np.sign(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]) * (1 if faces_up else -1)
    nodes = np.arange(points.shape[0] * points.shape[1]).reshape(points.shape[:2]) + (0 if faces_up else 10**6)
    return Facets(FacetKind(kind, degree), nodes, np.zeros((*nodes.shape, 3), dtype=np.int64), points, signs)


def nodal_areas(facets: Facets) -> np.ndarray:
    points, weights = basix.make_quadrature(basix.CellType[facets.kind.kind], 8)
    values, *slopes = np.asarray(facets.kind.values(points))
    first, second = (np.einsum("qk,nki->nqi", slope, facets.points) for slope in slopes)
    return np.asarray(np.einsum("q,qk,nq->nk", weights, values, np.linalg.norm(np.cross(first, second), axis=2)))


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize(
    ("kinds", "exact"),
    [
        (("triangle", "triangle"), 1e-15),
        (("quadrilateral", "quadrilateral"), 2e-8),
        (("triangle", "quadrilateral"), 2e-8),
    ],
)
def test_areas_at_nodes_are_exact_on_both_sides(kinds: tuple[str, str], exact: float, degree: int) -> None:
    lower = sheet(kinds[0], 3, degree, lambda x, y: 0 * x, faces_up=True)
    upper = sheet(kinds[1], 5, degree, lambda x, y: 0 * x + 0.1, faces_up=False, seed=1)
    found = segments(lower, upper, 0.3)
    assert np.abs(found.gaps - 0.1).max() < 1e-15
    assert found.weights.sum() == pytest.approx(1.0, abs=1e-13)
    for facets, number, places in (
        (lower, found.first, found.first_places),
        (upper, found.second, found.second_places),
    ):
        areas = np.zeros(facets.nodes.shape)
        np.add.at(areas, number, found.weights[:, None] * facets.kind.values(places)[0])
        assert np.abs(areas - nodal_areas(facets)).max() < exact


def test_gaps_of_quadratic_facets_are_along_the_normal() -> None:
    def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.asarray(0.1 * (x - 0.5) ** 2 - 0.05 * y**2)

    lower = sheet("triangle", 4, 2, height, faces_up=True)
    upper = sheet("triangle", 5, 2, lambda x, y: height(x, y) + 0.01, faces_up=False, seed=1)
    found = segments(lower, upper, 0.3)
    slope = np.hypot(0.2 * 0.5, 0.1)
    assert found.gaps.max() < 0.01 * (1 + 1e-3)  # normals are of the middle of each facet
    assert found.gaps.min() > 0.01 / np.sqrt(1 + slope**2) * (1 - 1e-3)
    points = np.einsum("nk,nki->ni", lower.kind.values(found.first_places)[0], lower.points[found.first])
    assert np.abs(points[:, 2] - height(points[:, 0], points[:, 1])).max() < 1e-12


@pytest.mark.parametrize(("up", "distance"), [(True, 0.1), (False, 0.5)])
def test_surfaces_that_face_away_or_are_far_have_no_segments(up: bool, distance: float) -> None:
    lower = sheet("triangle", 2, 1, lambda x, y: 0 * x, faces_up=True)
    upper = sheet("triangle", 2, 1, lambda x, y: 0 * x + distance, faces_up=up)
    assert len(segments(lower, upper, 0.3).weights) == 0
