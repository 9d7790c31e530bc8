"""Cells that are numbered inside out are renumbered, and inverted ones are not."""

import dataclasses
from pathlib import Path

import dolfinx
import numpy as np
import pytest

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh.cells import no_cells, node_order, scalar_element
from hpcinv.mesh.checks import consistently_oriented, determinants
from hpcinv.mesh.source import MeshSource


def cube(kind: str, degree: int) -> MeshSource:
    """Unit cube of 3 x 3 x 3 parts, whose cells are mapped to degree 2 from the first."""
    mesh = dolfinx.mesh.create_unit_cube(MPI.COMM_SELF, 3, 3, 3, dolfinx.mesh.to_type(kind))
    corners = mesh.geometry.x[mesh.geometry.dofmaps[0]]
    nodes = scalar_element(kind, 1).tabulate(0, scalar_element(kind, degree).points)[0, :, :, 0] @ corners
    points, place = np.unique(nodes.reshape(-1, 3).round(9), axis=0, return_inverse=True)
    cells = place.reshape(len(corners), -1)
    tags, no_facets = np.arange(len(points)), no_cells(kind, degree)[:, :0]
    return MeshSource(Path("cube"), kind, degree, points, tags, cells, np.arange(len(cells)), no_facets)


def half_mirrored(source: MeshSource) -> MeshSource:
    """Return the mesh with half of its cells numbered inside out."""
    chosen = np.random.default_rng(0).permutation(len(source.cells)) < len(source.cells) / 2
    order = node_order(source.kind, source.degree, scalar_element(source.kind, source.degree).points[:, [0, 2, 1]])
    return dataclasses.replace(source, cells=np.where(chosen[:, None], source.cells[:, order], source.cells))


@pytest.mark.parametrize(("kind", "degree"), [(k, d) for k in ("tetrahedron", "hexahedron") for d in (1, 2)])
def test_cells_inside_out_are_renumbered(kind: str, degree: int) -> None:
    source = half_mirrored(cube(kind, degree))
    assert determinants(source)[0].min() < 0
    turned = consistently_oriented(source)
    assert determinants(turned)[0].min() > 0 or determinants(turned)[1].max() < 0
    assert (np.sort(turned.cells, axis=1) == np.sort(source.cells, axis=1)).all()
    assert "numbered inside out" in turned.notes[0]
    assert consistently_oriented(turned) is turned


def test_inverted_cells_stay_inverted() -> None:
    source = cube("tetrahedron", 1)
    source.points[np.linalg.norm(source.points - 1 / 3, axis=1) < 1e-6] += [0.4, 0, 0]  # beyond the next node
    signs = np.sign(determinants(source)[0])
    assert np.unique(signs).tolist() == [-1, 1]
    assert consistently_oriented(source) is source
    signs_again = np.sign(determinants(consistently_oriented(half_mirrored(source)))[0])
    np.testing.assert_array_equal(signs_again, signs)
