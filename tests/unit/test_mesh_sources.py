"""Every source of a mesh ends in the same plain arrays, in the order and with the tags of its file."""

from __future__ import annotations

import resource
import runpy
from dataclasses import replace
from pathlib import Path

import dolfinx
import gmsh
import numpy as np
import pytest
import pyvista
import vtk
from helpers.mesh_cases import TETRAHEDRON, spec, write_msh22
from mpi4py import MPI

from hpcinv.errors import MeshError, OutputError
from hpcinv.job.mesh_file import FORMATS
from hpcinv.mesh import MeshSource, read_source
from hpcinv.mesh.cells import FACET_KIND, coordinate_element, scalar_element, vtk_order
from hpcinv.mesh.checks import check
from hpcinv.mesh.io.gmsh_model import ElementType, save_msh, session
from hpcinv.mesh.mesh_files import SAVERS, save
from hpcinv.mesh.readers import FILES, GENERATORS
from hpcinv.mesh.source import DataArray

pytestmark = pytest.mark.usefixtures("warm_reader")

FACES = {"x0", "x1", "y0", "y1", "z0", "z1"}


def box(meshes: Path, hexahedra: bool, degree: int) -> MeshSource:
    parameters = {"lx": 2, "nx": 3, "ny": 2, "nz": 2, "hexahedra": hexahedra}
    return read(meshes / "box.py", parameters=parameters, geometry_degree=degree)


def read(path: Path, **settings: object) -> MeshSource:
    return read_source(spec(path, **settings), path)


def assert_nodes_in_dolfinx_order(source: MeshSource) -> None:
    """Nodes of straight cells and facets lie where the (tri)linear map of the vertices takes the reference nodes."""
    for kind, nodes in ((source.kind, source.cells), (FACET_KIND[source.kind], source.facets)):
        at_reference = scalar_element(kind, 1).tabulate(0, scalar_element(kind, source.degree).points)[0, :, :, 0]
        vertices = source.points[nodes[:, : at_reference.shape[1]]]
        assert np.abs(np.einsum("pv,cvi->cpi", at_reference, vertices) - source.points[nodes]).max() < 1e-11


def volume(source: MeshSource) -> float:
    """Sum of det J at the centres, exact for the straight bricks and tetrahedra here."""
    centre = np.full((1, 3), 0.25 if source.kind == "tetrahedron" else 0.5)
    gradients = scalar_element(source.kind, source.degree).tabulate(1, centre)[1:, 0, :, 0]
    jacobians = np.einsum("cni,dn->cid", source.points[source.cells], gradients)
    return float(np.abs(np.linalg.det(jacobians)).sum()) / (6 if source.kind == "tetrahedron" else 1)


def groups(source: MeshSource) -> dict[tuple[str, int], set[frozenset[int]]]:
    """Groups as sets of node sets."""
    nodes = {3: source.cells, 2: source.facets}
    return {(g.name, g.dim): {frozenset(row.tolist()) for row in nodes[g.dim][g.members]} for g in source.groups}


@pytest.mark.everyday("False-1")
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("hexahedra", [False, True])
def test_a_box_is_the_same_through_every_format(meshes: Path, tmp_path: Path, hexahedra: bool, degree: int) -> None:
    made = box(meshes, hexahedra, degree)
    check(made)
    assert made.degree == degree
    assert_nodes_in_dolfinx_order(made)
    assert volume(made) == pytest.approx(2.0, rel=1e-14)
    assert {g.name for g in made.groups} == FACES | {"block"}
    for axis, low, high in ((0, "x0", "x1"), (1, "y0", "y1"), (2, "z0", "z1")):
        for name, value in ((low, 0.0), (high, made.points[:, axis].max())):
            (group,) = (g for g in made.groups if g.name == name)
            assert np.all(made.points[made.facets[group.members]][..., axis] == value)

    # gmsh's own files, from gmsh's own reading of the generator's model
    written = []
    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    build = runpy.run_path(str(meshes / "box.py"))["build"]
    build(gmsh, lx=2, nx=3, ny=2, nz=2, hexahedra=hexahedra)
    gmsh.model.mesh.setOrder(degree)
    for version, binary in ((2.2, 0), (2.2, 1), (4.1, 0), (4.1, 1)):
        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        gmsh.option.setNumber("Mesh.Binary", binary)
        written.append(tmp_path / f"box-{version}-{binary}.msh")
        gmsh.write(str(written[-1]))
    gmsh.model.mesh.partition(3)  # a file that gmsh has cut for other programs is put together again
    written.append(tmp_path / "box-cut.msh")
    gmsh.write(str(written[-1]))
    gmsh.option.setNumber("Mesh.PartitionSplitMeshFiles", 1)
    gmsh.write(str(tmp_path / "part.msh"))
    gmsh.finalize()
    with pytest.raises(MeshError, match="lacks 2 of 3 partitions"):
        read(tmp_path / "part_1.msh")
    for path in written:
        again = read(path)
        assert np.allclose(again.points, made.points, rtol=1e-15, atol=1e-15)
        assert np.array_equal(again.cells, made.cells)
        assert groups(again) == groups(made)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("kind", ["tetrahedron", "hexahedron"])
def test_xdmf_of_dolfinx_keeps_nodes_and_tags(tmp_path: Path, kind: str, degree: int) -> None:
    cube = dolfinx.mesh.create_unit_cube(MPI.COMM_SELF, 2, 2, 2, dolfinx.mesh.CellType[kind])
    space = dolfinx.fem.functionspace(cube, ("Lagrange", degree, (3,)))
    cells = np.asarray(space.dofmap.list)
    nodes = space.tabulate_dof_coordinates()
    mesh = dolfinx.mesh.create_mesh(MPI.COMM_SELF, cells.astype(np.int64), coordinate_element(kind, degree), nodes)
    mesh.topology.create_connectivity(2, 3)
    facets = dolfinx.mesh.locate_entities_boundary(mesh, 2, lambda x: x[0] < 1e-9)
    tags = dolfinx.mesh.meshtags(mesh, 2, facets, np.full(len(facets), 7, dtype=np.int32))
    tags.name = "left"
    solid = dolfinx.mesh.meshtags(mesh, 3, np.arange(len(cells), dtype=np.int32), np.ones(len(cells), dtype=np.int32))
    solid.name = "solid"
    for encoding in (dolfinx.io.XDMFFile.Encoding.HDF5, dolfinx.io.XDMFFile.Encoding.ASCII):
        path = tmp_path / f"{encoding.name}.xdmf"
        with dolfinx.io.XDMFFile(MPI.COMM_SELF, str(path), "w", encoding=encoding) as file:
            file.write_mesh(mesh)
            file.write_meshtags(tags, mesh.geometry)
            file.write_meshtags(solid, mesh.geometry)
        source = read(path)
        check(source)
        assert (source.kind, source.degree) == (kind, degree)
        assert_nodes_in_dolfinx_order(source)
        assert volume(source) == pytest.approx(1.0, rel=1e-12)
        assert {(g.name, g.dim, len(g.members)) for g in source.groups} == {
            ("left-7", 2, len(facets)),
            ("solid-1", 3, len(cells)),
        }
        assert np.all(source.points[source.facets][..., 0] < 1e-9)


VTK_CELLS = {
    ("tetrahedron", 1): ("TETRA", "LAGRANGE_TETRAHEDRON"),
    ("tetrahedron", 2): ("QUADRATIC_TETRA", "LAGRANGE_TETRAHEDRON"),
    ("hexahedron", 1): ("HEXAHEDRON", "LAGRANGE_HEXAHEDRON"),
    ("hexahedron", 2): ("TRIQUADRATIC_HEXAHEDRON", "LAGRANGE_HEXAHEDRON"),
}


@pytest.mark.release
@pytest.mark.parametrize(("kind", "degree"), VTK_CELLS)
def test_vtu_cells_of_vtk_are_read_in_dolfinx_order(tmp_path: Path, kind: str, degree: int) -> None:
    size = scalar_element(kind, degree).dim
    for name in VTK_CELLS[kind, degree]:
        cell_type = pyvista.CellType[name]
        generic = vtk.vtkGenericCell.InstantiateCell(int(cell_type))
        generic.GetPointIds().SetNumberOfIds(size)
        generic.GetPoints().SetNumberOfPoints(size)
        if hasattr(generic, "SetUniformOrderFromNumPoints"):
            generic.SetUniformOrderFromNumPoints(size)
        generic.Initialize()
        coordinates = generic.GetParametricCoords()
        nodes = np.array([coordinates[i] for i in range(3 * size)]).reshape(size, 3)
        path = tmp_path / f"{name}.vtu"
        pyvista.UnstructuredGrid(np.array([size, *range(size)]), [cell_type], nodes).save(path)
        source = read(path)
        check(source)
        assert (source.kind, source.degree) == (kind, degree)
        assert np.abs(source.points[source.cells[0]] - scalar_element(kind, degree).points).max() < 1e-12


def test_generated_nodes_of_degree_2_lie_on_the_curved_side(meshes: Path) -> None:
    beam = read(meshes / "pdms_beam.py", parameters={"size": "4 mm"}, geometry_degree=2)
    check(beam)
    (side,) = (g for g in beam.groups if g.name == "side")
    radius = np.linalg.norm(beam.points[beam.facets[side.members]][..., 1:], axis=-1)
    assert np.abs(radius - 4.25e-3).max() < 1e-12
    assert beam.points[:, 0].max() == pytest.approx(0.182, rel=1e-15)


@pytest.mark.everyday("False")
@pytest.mark.parametrize("hexahedra", [False, True])
def test_a_file_of_degree_1_becomes_degree_2_with_straight_edges_and_back(
    meshes: Path, tmp_path: Path, hexahedra: bool
) -> None:
    flat = box(meshes, hexahedra, 1)
    path = tmp_path / "flat.msh"
    save_msh(path, flat, flat.points)
    raised = read(path, geometry_degree=2)
    check(raised)
    assert_nodes_in_dolfinx_order(raised)
    assert len(raised.points) == len(box(meshes, hexahedra, 2).points)
    assert {g.name for g in raised.groups} == FACES | {"block"}
    save_msh(path, raised, raised.points)
    lowered = read(path, geometry_degree=1)
    assert np.array_equal(lowered.points, flat.points)
    assert np.array_equal(lowered.node_tags, flat.node_tags)
    assert np.array_equal(lowered.cells, flat.cells)
    assert groups(lowered) == groups(flat)


@pytest.mark.parametrize("suffix", SAVERS)
def test_a_full_disk_is_reported_and_leaves_nothing(suffix: str, meshes: Path, tmp_path: Path) -> None:
    """A limit on the size of files stands for it, in the mesh and in the last section of the data."""
    source = box(meshes, False, 1)
    values = np.arange(9.0 * len(source.points)).reshape(-1, 9)
    source = replace(source, data={"array": DataArray("array", "nodes", values)})
    save(tmp_path / f"whole{suffix}", source, source.points)
    size = (tmp_path / f"whole{suffix}").stat().st_size
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    for limit in (size // 4, size - 100):
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
        try:
            with pytest.raises(OutputError, match="cannot be written"):
                save(tmp_path / f"part{suffix}", source, source.points)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert [path.name for path in tmp_path.iterdir()] == [f"whole{suffix}"]


def test_a_generated_mesh_is_the_same_every_time(meshes: Path) -> None:
    once, again = (read(meshes / "pdms_beam.py", parameters={"size": 0.004}) for _ in range(2))
    assert np.array_equal(once.points, again.points)
    assert np.array_equal(once.cells, again.cells)


def test_geo_parameters_reach_the_script(meshes: Path) -> None:
    block = read(meshes / "block.geo", parameters={"lx": "3 m", "size": 0.5})
    check(block)
    assert block.points.max(axis=0) == pytest.approx([3, 1, 1])
    assert volume(block) == pytest.approx(3.0, rel=1e-12)
    assert {g.name for g in block.groups} == FACES | {"block"}


def test_a_geo_script_may_be_in_another_unit(meshes: Path) -> None:
    block = read(meshes / "block.geo", unit="mm", geometry_degree=2)
    check(block)
    assert block.points.max(axis=0) == pytest.approx([1e-3] * 3)
    assert len(block.cells) == len(read(meshes / "block.geo").cells)


def test_a_broken_script_spoils_no_later_one(meshes: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken.geo"
    broken.write_text('SetFactory("OpenCASCADE");\nBox(1) = {0, 0, 0, 1, 1, q};\n')
    with pytest.raises(MeshError, match="line 2: Unknown variable 'q'"):
        read(broken)
    assert len(read(meshes / "block.geo", parameters={"size": 1}).cells)


def test_an_error_in_a_generator_names_its_line(tmp_path: Path) -> None:
    generator = tmp_path / "broken.py"
    generator.write_text("def build(gmsh, *, n=1):\n    raise ValueError(f'{n} is too few')\n")
    with pytest.raises(MeshError, match=r"broken\.py, line 2: ValueError: 1 is too few"):
        read(generator)
    generator.write_text("import sys\ndef build(gmsh):\n    sys.exit(3)\n")
    with pytest.raises(MeshError, match=r"broken\.py, line 3: SystemExit: 3"):
        read(generator)
    generator.write_text("def build(gmsh):\n    gmsh.finalize()\n")
    with pytest.raises(MeshError, match="finalised gmsh"):
        read(generator)
    generator.write_text("def build(gmsh):\n    gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)\n")
    with pytest.raises(MeshError, match="no solid cells"):
        read(generator)


@pytest.mark.release
def test_units_and_unused_nodes_of_a_file(tmp_path: Path) -> None:
    path = write_msh22(tmp_path / "t.msh", [(9, 9, 9), *TETRAHEDRON], [(4, 1, 1, [2, 3, 4, 5])])
    source = read(path, unit="mm")
    assert np.array_equal(source.points, np.array(TETRAHEDRON) * 1e-3)
    assert source.node_tags.tolist() == [2, 3, 4, 5]
    assert [g.name for g in source.groups] == ["volume-1"]


def test_nodes_of_higher_degree_and_serendipity_cells_are_refused(tmp_path: Path) -> None:
    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    box_tag = gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
    gmsh.model.occ.synchronize()
    gmsh.model.addPhysicalGroup(3, [box_tag])
    gmsh.option.setNumber("Mesh.MeshSizeMin", 1)
    gmsh.model.mesh.generate(3)
    gmsh.model.mesh.setOrder(3)
    gmsh.write(str(tmp_path / "cubic.msh"))
    gmsh.finalize()
    with pytest.raises(MeshError, match="tetrahedrons of 20 nodes are not supported"):
        read(tmp_path / "cubic.msh")


def test_the_node_orders_of_gmsh_and_vtk_are_those_that_dolfinx_uses() -> None:
    with session("orders") as running:
        for kind, degree in VTK_CELLS:
            size = scalar_element(kind, degree).dim
            expected = dolfinx.io.gmsh.cell_perm_array(dolfinx.mesh.CellType[kind], size)
            assert ElementType.query(running, kind, degree).order.tolist() == list(expected)
            assert sorted(vtk_order(kind, degree)) == list(range(size))


def test_files_that_cannot_be_read_say_so(tmp_path: Path) -> None:
    cases = {
        "text.msh": ("$MeshFormat\nnonsense", "gmsh cannot read it"),
        "short.msh": ("$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 3", "gmsh cannot read it"),
        "empty.msh": ("$MeshFormat\n", "gmsh cannot read it"),
        "text.vtu": ("nonsense", "VTK cannot read it|has no unstructured grid"),
        "text.xdmf": ("nonsense", "is not valid XML"),
        "empty.xdmf": ("<Xdmf><Domain/></Xdmf>", "no grid with a topology"),
        "lost.xdmf": (
            '<Xdmf><Domain><Grid><Topology TopologyType="Tetrahedron"><DataItem Format="HDF">gone.h5:/t</DataItem>'
            + "</Topology><Geometry><DataItem>0</DataItem></Geometry></Grid></Domain></Xdmf>",
            r"there is no file .*gone.h5",
        ),
    }
    for name, (text, message) in cases.items():
        path = tmp_path / name
        path.write_text(text)
        with pytest.raises(MeshError, match=message) as caught:
            read(path)
        assert str(path) in caught.value.message
        assert caught.value.advice
    gone = spec(path)
    path.unlink()
    with pytest.raises(MeshError, match="no such file"):
        read_source(gone, path)


def test_a_job_may_name_every_format_that_can_be_read_and_no_other() -> None:
    assert set(FORMATS) == GENERATORS.keys() | FILES.keys()
