"""Data arrays of mesh files reach the nodes and cells that they belong to, in every format and on any number of ranks.

Values are linear functions of position, so that each rank knows what each of its rows must hold.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import dolfinx
import numpy as np
import pytest
import pyvista
from helpers.mesh_cases import TETRAHEDRON, spec, write_msh22
from helpers.mesh_data_files import ARRAYS, block, linear, write

from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.errors import MeshError
from hpcinv.mesh import Body, build_body, read_source, write_mesh
from hpcinv.mesh.cells import coordinate_element, scalar_element
from hpcinv.mesh.data import as_function, distribute
from hpcinv.mesh.refine.degree import change_degree
from hpcinv.mesh.source import DataArray

pytestmark = pytest.mark.usefixtures("warm_reader")

FILES = ("data.vtu", "data.xdmf", "2.2.msh", "4.1.msh")
MOVE = np.array([3.0, 2.0, 1.0])
CELLS = ("tetrahedron", "hexahedron")
CLOSE = 1e-11  # gmsh puts a node of degree 2 to about 1e-12 in the middle; neighbours' values differ by 0.1 and more


def bodies(
    comm: MPI.Intracomm, meshes: Path, directory: Path, degrees: tuple[tuple[int, int | None], ...]
) -> Iterator[Body]:
    """Blocks in which any two of a file, a kind of cell, and a pair of degrees (the file's, the one asked for) meet."""
    for (i, file), (j, kind) in product(enumerate(FILES), enumerate(CELLS)):
        degree, asked = degrees[(i + j) % len(degrees)]
        path = directory / file
        on_root(comm, lambda path=path, kind=kind, degree=degree: write(path, meshes, kind == "hexahedron", degree))
        body = build_body(spec(path, geometry_degree=asked), {}, comm)
        assert (body.source.kind, body.source.degree) == (kind, asked or degree)
        assert body.source.data.keys() == ARRAYS.keys()
        yield body


def positions(body: Body, on: str) -> np.ndarray:
    """Positions (m) of the local geometry nodes, or means of the vertices of the local cells, ghosts too."""
    x = body.mesh.geometry.x * body.length_scale
    corners = {"tetrahedron": 4, "hexahedron": 8}[body.source.kind]
    return x if on == "nodes" else x[body.mesh.geometry.dofmaps[0][:, :corners]].mean(axis=1)


def assert_right(body: Body) -> None:
    """Every row of every array, and every value of the functions made of them."""
    for name, (on, components) in ARRAYS.items():
        array = distribute(body, name)
        expected = linear(positions(body, on), components)
        assert (array.name, array.place) == (name, on)
        assert array.values.shape == expected.shape
        assert np.abs(array.values - expected).max() < CLOSE
        function = as_function(body, array)
        assert function.name == name
        assert function.ufl_shape == {1: (), 3: (3,), 9: (3, 3)}[components]
        # DOLFINx's own positions of the dofs; constants have theirs at the cells' midpoints.
        dofs = function.function_space.tabulate_dof_coordinates() * body.length_scale
        local_values = function.x.array.reshape(len(dofs), components)
        assert np.abs(local_values - linear(dofs, components)).max() < CLOSE
        assert function.function_space.element.basix_element.degree == (body.source.degree if on == "nodes" else 0)


def with_ghosts(body: Body) -> Body:
    """The same body on a mesh whose ranks know the cells next to their own."""
    source, comm = body.source, body.mesh.comm
    partitioner = dolfinx.mesh.create_cell_partitioner(dolfinx.mesh.GhostMode.shared_facet, 2)
    element = coordinate_element(source.kind, source.degree)
    mesh = dolfinx.mesh.create_mesh(comm, source.cells, element, source.points / body.length_scale, partitioner)
    assert comm.size == 1 or mesh.topology.index_map(3).num_ghosts > 0
    return dataclasses.replace(body, mesh=mesh, source_geometry=mesh.geometry)


@pytest.mark.release
@pytest.mark.parallel([1, 2, 3])
def test_every_row_is_at_its_place(comm: MPI.Intracomm, meshes: Path, run_directory: Path) -> None:
    for body in bodies(comm, meshes, run_directory, ((1, None), (2, None))):
        assert_right(body)
        if body.source.path.suffix == ".vtu":
            assert_right(with_ghosts(body))
        # What the other ranks know of the source is everything but the values.
        for name, (on, components) in ARRAYS.items():
            array = body.source.data[name]
            rows = len(body.source.points if on == "nodes" else body.source.cells)
            assert (array.place, array.values.shape) == (on, (rows, components))
            assert comm.rank == 0 or rows == 0


def test_another_geometry_degree_keeps_every_row(comm: MPI.Intracomm, meshes: Path, tmp_path: Path) -> None:
    for body in bodies(comm, meshes, tmp_path, ((1, 2), (2, 1))):
        assert_right(body)


def test_a_written_shape_keeps_the_data_bit_for_bit(comm: MPI.Intracomm, meshes: Path, tmp_path: Path) -> None:
    for body in bodies(comm, meshes, tmp_path, ((1, None), (2, None))):
        for suffix in (".vtu", ".msh"):
            path = tmp_path / f"moved{suffix}"
            write_mesh(path, body, body.mesh.geometry.x * body.length_scale + MOVE)
            again = read_source(spec(path), path)
            assert np.array_equal(again.points, body.source.points + MOVE)
            assert again.data.keys() == ARRAYS.keys()
            for name, array in body.source.data.items():
                assert again.data[name].place == array.place
                assert np.array_equal(again.data[name].values, array.values)


@pytest.mark.parallel([1, 2])
def test_an_array_that_cannot_be_used_is_an_error_on_all_ranks(
    comm: MPI.Intracomm, meshes: Path, run_directory: Path
) -> None:
    vtu, msh = run_directory / "wrong.vtu", run_directory / "wrong.msh"

    def make() -> None:
        grid = pyvista.UnstructuredGrid([4, 0, 1, 2, 3], [pyvista.CellType.TETRA], np.array(TETRAHEDRON))
        grid.cell_data["stiffness"] = [np.inf]
        grid.point_data["sheet"] = np.array([[1, 0, 0], [0, 1, 0], [0, np.nan, 1], [0, 0, 1]])
        grid.save(vtu)
        write_msh22(msh, [*TETRAHEDRON, (1, 1, 1)], [(4, 1, 1, [1, 2, 3, 4]), (4, 1, 1, [2, 3, 4, 5])])
        with msh.open("a") as file:
            file.write('$ElementData\n1\n"stiffness"\n1\n0\n3\n0\n1\n1\n2 7.5\n$EndElementData\n')

    on_root(comm, make)
    body = build_body(spec(vtu), {}, comm)
    with pytest.raises(MeshError, match=r"wrong.vtu: no data array 'stifness'. Did you mean 'stiffness'\?") as caught:
        distribute(body, "stifness")
    assert "sheet (nodes, 3)" in caught.value.advice
    assert "stiffness (cells, 1)" in caught.value.advice
    with pytest.raises(MeshError, match=r"'stiffness' is missing or not finite on 1 of 1 cells \(first: cell 1\)"):
        distribute(body, "stiffness")
    with pytest.raises(MeshError, match=r"'sheet' is missing or not finite on 1 of 4 nodes \(first: node 3\)"):
        distribute(body, "sheet")
    body = build_body(spec(msh), {}, comm)
    with pytest.raises(MeshError, match=r"'stiffness' is missing or not finite on 1 of 2 cells \(first: cell 1\)"):
        distribute(body, "stiffness")
    with pytest.raises(MeshError, match="The mesh has none"):
        distribute(build_body(spec(meshes / "box.py"), {}, comm), "stiffness")


def test_of_a_vtu_file_only_numbers_of_others_are_data(tmp_path: Path) -> None:
    grid = pyvista.UnstructuredGrid([4, 0, 1, 2, 3], [pyvista.CellType.TETRA], np.array(TETRAHEDRON))
    grid.cell_data["region:body"] = [1]
    grid.cell_data["cell_tag"] = [12]
    grid.cell_data["vtkGhostType"] = np.zeros(1, dtype=np.uint8)
    grid.cell_data["kind"] = ["muscle"]
    grid.cell_data["layer"] = np.array([3], dtype=np.int16)
    grid.cell_data["fibre"] = [[0.0, 0.0, 1.0]]
    grid.point_data["fibre"] = np.array(TETRAHEDRON, dtype=np.float32)
    grid.point_data["node_tag"] = [5, 6, 7, 8]
    grid.point_data["parameters"] = np.zeros((4, 2))
    grid.save(tmp_path / "many.vtu")
    source = read_source(spec(tmp_path / "many.vtu"), tmp_path / "many.vtu")
    assert {name: (a.place, a.values.tolist()) for name, a in source.data.items()} == {
        "layer": ("cells", [[3.0]]),
        "fibre (cells)": ("cells", [[0.0, 0.0, 1.0]]),
        "fibre (nodes)": ("nodes", [list(p) for p in TETRAHEDRON]),
    }
    assert [g.name for g in source.groups] == ["body"]
    assert source.node_tags.tolist() == [5, 6, 7, 8]


XDMF = """<Xdmf><Domain><Grid Name="mesh"><Topology TopologyType="Tetrahedron">
<DataItem Dimensions="1 4" NumberType="Int" Format="XML">0 1 2 3</DataItem></Topology>
<Geometry><DataItem Dimensions="4 3" Format="XML">0 0 0 1 0 0 0 1 0 0 0 1</DataItem></Geometry>
<Attribute Name="E" Center="Cell"><DataItem Dimensions="1" Format="XML">1500.0</DataItem></Attribute>
<Attribute Name="part" Center="Cell"><DataItem Dimensions="1" NumberType="Int" Format="XML">4</DataItem></Attribute>
<Attribute Name="layer" Center="Cell"><DataItem Dimensions="1" NumberType="Int" Format="XML">2</DataItem></Attribute>
<Attribute Name="T" Center="Node"><DataItem Dimensions="4 1" Format="XML">1 2 3 4</DataItem></Attribute>
<Attribute Name="all" Center="Grid"><DataItem Dimensions="1" Format="XML">1</DataItem></Attribute>
<Attribute Name="fewer" Center="Node"><DataItem Dimensions="3 1" Format="XML">1 2 3</DataItem></Attribute>
</Grid></Domain></Xdmf>
"""


def test_tags_in_the_grid_of_an_xdmf_mesh_are_integers_and_what_else_is_there_is_data(tmp_path: Path) -> None:
    path = tmp_path / "many.xdmf"
    path.write_text(XDMF)
    source = read_source(spec(path), path)
    assert [g.name for g in source.groups] == ["mesh-4"]
    assert {name: (a.place, a.values.tolist()) for name, a in source.data.items()} == {
        "E": ("cells", [[1500.0]]),
        "layer": ("cells", [[2.0]]),
        "T": ("nodes", [[1.0], [2.0], [3.0], [4.0]]),
    }


def test_views_of_a_generator_are_not_data(tmp_path: Path, meshes: Path) -> None:
    # As a script has them that lets a field of sizes guide the mesh.
    view = "    gmsh.view.addListData(gmsh.view.add('h'), 'SP', 1, [0.0] * 4)\n"
    generator = tmp_path / "sizes.py"
    generator.write_text((meshes / "box.py").read_text() + view)
    assert read_source(spec(generator), generator).data == {}


@pytest.mark.parametrize("hexahedra", [False, True])
def test_new_nodes_have_what_the_vertices_interpolate_there(meshes: Path, hexahedra: bool) -> None:
    flat = block(meshes, hexahedra, 1)
    random = np.random.default_rng(3)
    at_nodes = DataArray("sheet", "nodes", random.normal(size=(len(flat.points), 3)))
    in_cells = DataArray("fibre", "cells", random.normal(size=(len(flat.cells), 3)))
    source = dataclasses.replace(flat, data={"sheet": at_nodes, "fibre": in_cells})
    raised = change_degree(source, 2)
    shape = scalar_element(flat.kind, 1).tabulate(0, scalar_element(flat.kind, 2).points)[0, :, :, 0]
    expected = np.einsum("nv,cvi->cni", shape, at_nodes.values[flat.cells])
    assert np.abs(raised.data["sheet"].values[raised.cells] - expected).max() < 1e-14
    assert np.array_equal(raised.data["fibre"].values, in_cells.values)
    back = change_degree(raised, 1)
    assert all(np.array_equal(back.data[name].values, array.values) for name, array in source.data.items())
