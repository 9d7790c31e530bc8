"""Files of a shape with fewer nodes than the computed body: how far they are from it, in every format."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.mesh_cases import spec
from scipy.spatial import cKDTree

from hpcinv.base.mesh_formats import FORMATS, SAVED
from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.errors import OutputError
from hpcinv.mesh import Body, build_body, write_mesh
from hpcinv.mesh.cells import scalar_element
from hpcinv.mesh.mesh_files import left_out
from hpcinv.mesh.readers import FILES
from hpcinv.mesh.source import Floats, MeshSource
from hpcinv.output.shape_files import ShapeFile, lines_of, notes_of

pytestmark = pytest.mark.usefixtures("warm_reader")

FORMATS_OF_FILES = [name for name in SAVED if not FORMATS[f".{name}"].is_partitioned]


def bent(points: Floats) -> Floats:
    """A bar along x, bent so that edges are curved, and bulged so that faces are."""
    x, y, z = points.T
    return np.column_stack([x, y + 0.05 * x**2, z + 0.03 * (x * y) ** 2])


def points_of(source: MeshSource, degree: int) -> Floats:
    """Return the nodes of a degree on the cells of a file, in m."""
    shapes = scalar_element(source.kind, source.degree).tabulate(0, scalar_element(source.kind, degree).points)
    points: Floats = np.einsum("pn,cni->cpi", shapes[0, :, :, 0], source.points[source.cells])
    return points.reshape(-1, 3)


CASES = ((False, 1, 2), (False, 2, 3), (True, 1, 2), (True, 2, 2), (False, 1, 1))
"""whether hexahedra, degree of the geometry and of the displacement"""


@pytest.mark.release
@pytest.mark.parallel(2)
def test_distance_of_files_from_the_body(comm: MPI.Intracomm, meshes: Path, run_directory: Path) -> None:
    for hexahedra, geometry, displacement in CASES:
        parameters = {"lx": 3.0, "nx": 2, "ny": 1, "nz": 1, "hexahedra": hexahedra}
        mesh = spec(meshes / "box.py", parameters=parameters, geometry_degree=geometry)
        body = build_body(mesh, {}, comm, degree=displacement)
        nodes = bent(body.nodes)
        all_nodes = comm.gather(nodes)
        distances = dict[str, float]()
        for name in FORMATS_OF_FILES if geometry < displacement else ("msh", "vtu", "inp"):
            path = run_directory / f"shape.{name}"
            try:
                write_mesh(path, body, nodes)
            except OutputError:
                assert (name, geometry) == ("mesh", 2)
                continue
            said = distances[name] = left_out(path, body, nodes)

            def check(
                path: Path = path, body: Body = body, gathered: list[Floats] | None = all_nodes, said: float = said
            ) -> None:
                tree = cKDTree(points_of(FILES[path.suffix](path), body.degree))
                measured = float(tree.query(np.concatenate(gathered or []))[0].max())
                assert measured == pytest.approx(said, rel=1e-4, abs=1e-9), path.name

            on_root(comm, check)
        is_straight = geometry < displacement
        assert (min(distances.values()) > 1e-4) == is_straight
        assert (max(distances.values()) > 1e-4) == (is_straight or (hexahedra and geometry == 2))
        assert left_out(run_directory / "shape.bp", body, nodes) == distances["msh"]


def test_lines_name_the_files_and_the_remedy() -> None:
    near = ShapeFile("shape.vtu", 0.0, 1e-2, 2)
    straight = [ShapeFile(f"shape.{name}", 3e-4, 1e-2, 1) for name in ("msh", "inp")]
    far = ShapeFile("shape-rest.inp", 1e-3, 1e-2, 2, "rest")
    files = {file.name: file for file in (near, *straight, far)}
    first, second = notes_of(files)
    assert first.startswith("shape.msh, .inp: up to 300 µm from the computed body: straight between its vertices")
    assert second.startswith("shape-rest.inp: up to 1 mm from the computed body: without some nodes")
    lines = list(lines_of(files))
    assert [(line.state, line.verdict.value) for line in lines] == [("", "pass"), ("rest", "warning")]
    (line,) = lines_of({"shape.msh": replace(straight[0], left_out=6e-4)})
    assert "for solids 'mesh: {geometry_degree: 2}'" in line.remedy
    assert "mesh: {geometry_degree: 2}" in lines[0].note
    assert not list(lines_of({"shape.vtu": near, "shape.msh": replace(straight[0], left_out=1e-6)}))
