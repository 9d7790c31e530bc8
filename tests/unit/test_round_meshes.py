"""The tube and the hollow sphere: sound meshes of curved bodies, whose volume and surfaces converge as they should."""

from __future__ import annotations

from collections.abc import Callable
from math import log2, pi
from pathlib import Path

import basix
import numpy as np
import pytest
from helpers.mesh_cases import spec

from hpcinv.base.parallel.runtime import MPI
from hpcinv.mesh import MeshSource, build_body, read_source
from hpcinv.mesh.cells import FACET_KIND, scalar_element

pytestmark = pytest.mark.slow

A, B, L = 0.4, 1.1, 1.3
TUBE = {"inner": A, "outer": B, "length": L}
PARTS = {"wall", "inner", "outer", "z0", "z1"}
SHAPES = {
    "octant": ("thick_sphere.py", {"inner": A, "outer": B}),
    "quarter": ("thick_cylinder.py", TUBE),
    "whole": ("thick_cylinder.py", TUBE | {"quarter": False}),
}
CUT, SECTOR = pi * (B**2 - A**2) / 4, L * (B - A)
EXACT = {
    "octant": {"wall": pi * (B**3 - A**3) / 6, "inner": pi * A**2 / 2, "outer": pi * B**2 / 2}
    | dict.fromkeys(("x0", "y0", "z0"), CUT),
    "quarter": {"wall": L * CUT, "inner": pi * A * L / 2, "outer": pi * B * L / 2, "x0": SECTOR, "y0": SECTOR}
    | dict.fromkeys(("z0", "z1"), CUT),
    "whole": {"wall": 4 * L * CUT, "inner": 2 * pi * A * L, "outer": 2 * pi * B * L}
    | dict.fromkeys(("z0", "z1"), 4 * CUT),
}
PLANES = {"x0": (0, 0.0), "y0": (1, 0.0), "z0": (2, 0.0), "z1": (2, L)}


def read(meshes: Path, shape: str, hexahedra: bool, divisions: int, degree: int) -> MeshSource:
    file, parameters = SHAPES[shape]
    of_shape = {"radial": divisions, "along": divisions} | ({} if shape == "octant" else {"around": divisions})
    path = meshes / file
    return read_source(
        spec(path, parameters=parameters | of_shape | {"hexahedra": hexahedra}, geometry_degree=degree), path
    )


def sizes(source: MeshSource) -> dict[str, float]:
    """Volume or area of each group, by quadrature that is exact for volumes and far better than the mesh for areas."""
    sizes = {}
    for group in source.groups:
        kind, nodes = (source.kind, source.cells) if group.dim == 3 else (FACET_KIND[source.kind], source.facets)
        points, weights = basix.make_quadrature(basix.CellType[kind], 12)
        gradients = scalar_element(kind, source.degree).tabulate(1, points)[1:, :, :, 0]
        tangents = np.einsum("dqn,cni->cqid", gradients, source.points[nodes[group.members]])
        gram = np.swapaxes(tangents, 2, 3) @ tangents
        sizes[group.name] = float((np.sqrt(np.linalg.det(gram)) @ weights).sum())
    return sizes


@pytest.mark.everyday("quarter-True-1")
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("hexahedra", [False, True])
@pytest.mark.parametrize("shape", SHAPES)
def test_volume_and_areas_converge_with_order_two_flat_and_four_curved(
    meshes: Path, shape: str, hexahedra: bool, degree: int, record_property: Callable[[str, object], None]
) -> None:
    exact = EXACT[shape]
    coarse, fine = (sizes(read(meshes, shape, hexahedra, divisions, degree)) for divisions in (3, 6))
    assert coarse.keys() == fine.keys() == exact.keys()
    for name, value in exact.items():
        errors = [abs(measured[name] / value - 1) for measured in (coarse, fine)]
        if shape != "octant" and name in ("x0", "y0"):  # rectangles
            assert max(errors) < 1e-14
            continue
        order = log2(errors[0] / errors[1])
        record_property(name, f"{errors[1]:.2e}, order {order:.2f}")
        assert abs(order - 2 * degree) < 0.05, (name, errors)


@pytest.mark.parametrize("hexahedra", [False, True])
@pytest.mark.parametrize("shape", SHAPES)
def test_all_nodes_of_a_round_surface_have_its_radius(meshes: Path, shape: str, hexahedra: bool) -> None:
    source = read(meshes, shape, hexahedra, 3, 2)
    coordinates = 3 if shape == "octant" else 2
    for group in source.groups:
        nodes = source.points[np.unique(source.facets[group.members])] if group.dim == 2 else source.points
        radius = np.linalg.norm(nodes[:, :coordinates], axis=1)
        if group.name in ("inner", "outer"):
            assert np.abs(radius - (A if group.name == "inner" else B)).max() < 1e-14
        elif group.name in PLANES:
            axis, value = PLANES[group.name]
            assert np.all(nodes[:, axis] == value)
        else:
            assert radius.min() > 0.999 * A
            assert radius.max() < 1.001 * B


@pytest.mark.parametrize("shape", SHAPES)
def test_flat_cells_lie_in_even_layers(meshes: Path, shape: str) -> None:
    source = read(meshes, shape, True, 4, 1)
    radius = np.linalg.norm(source.points[:, : 3 if shape == "octant" else 2], axis=1)
    layer = (radius - A) / (B - A) * 4
    assert np.abs(layer - layer.round()).max() < 1e-10  # gmsh divides a line only to about 1e-11
    counts = np.bincount(layer.round().astype(int))
    # Patches of 4 × 4 bricks: three round a corner, one, and four in a ring.
    assert counts.tolist() == [{"octant": 61, "quarter": 5 * 5, "whole": 16 * 5}[shape]] * 5


@pytest.mark.release
@pytest.mark.parallel([1, 2])
def test_a_body_of_each_has_its_whole_boundary_named(comm: MPI.Intracomm, meshes: Path) -> None:
    for shape, (file, parameters) in SHAPES.items():
        for hexahedra in (False, True):
            for degree in (1, 2):
                mesh = spec(meshes / file, parameters=parameters | {"hexahedra": hexahedra}, geometry_degree=degree)
                body = build_body(mesh, {}, comm)
                assert EXACT[shape].keys() | {"boundary"} == body.regions.keys()
                named = sum(region.facet_count for name, region in body.regions.items() if name != "boundary")
                assert named == body.regions["boundary"].facet_count
                assert body.regions["wall"].cell_count == sum(body.partition.cells)
