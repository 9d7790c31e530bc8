"""Regions by labels of cells, faces and nodes, by face files, and by groups that overlap."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
import pyvista
from helpers.mesh_cases import spec
from helpers.schemas import refusals

from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.base.quantity.spatial_fields import ByRegion
from hpcinv.errors import JobError, MeshError
from hpcinv.job.job import Job, parse
from hpcinv.mesh import build_body, read_source
from hpcinv.mesh.distributed.partition import partitioned
from hpcinv.mesh.distributed.partitioned import write_partitioned
from hpcinv.mesh.facet_groups import add_facets
from hpcinv.mesh.io.vtu import read_vtu, save_vtu
from hpcinv.mesh.label_groups import integer_arrays
from hpcinv.mesh.mesh_files import save
from hpcinv.mesh.source import DataArray, Group, MeshSource, distinct_tags
from hpcinv.model.fields import BodyFields, law_cells

pytestmark = pytest.mark.usefixtures("warm_reader")

MATERIAL = {"law": "neo-hookean", "young": "1 kPa", "poisson": 0.3}


def bar(material: np.ndarray) -> MeshSource:
    """Cubes in a row."""
    count = len(material)
    points = np.array([[i, j, k] for i in range(count + 1) for j in (0.0, 1.0) for k in (0.0, 1.0)])
    cells = 4 * np.arange(count)[:, None] + np.array([0, 4, 2, 6, 1, 5, 3, 7])
    arrays = [
        DataArray("material", "cells", material[:, None]),
        DataArray("wall", "nodes", points[:, :1]),
        DataArray("height", "nodes", points[:, :1] + 0.5),
    ]
    return MeshSource(
        path=Path("bar.vtu"),
        kind="hexahedron",
        degree=1,
        points=points,
        node_tags=np.arange(1, len(points) + 1),
        cells=cells,
        cell_tags=np.arange(1, count + 1),
        facets=np.zeros((0, 4), dtype=np.int64),
        data={array.name: array for array in arrays},
    )


def job(directory: Path, labels: dict[str, Any], **changes: Any) -> Job:
    sections = {
        "mesh": {"file": "bar.vtu"} | ({"labels": labels} if labels else {}),
        "material": MATERIAL,
        "supports": [{"region": "boundary", "fix": ["x", "y", "z"]}],
    }
    return parse(sections | changes, directory / "job.yaml")


@pytest.fixture
def directory(tmp_path: Path) -> Path:
    path = tmp_path / "bar.vtu"
    source = bar(np.array([1, 1, 2, 7, 7, 7]))
    save_vtu(path, source, source.points)
    assert read_vtu(path).data.keys() == {"material", "wall", "height"}
    return tmp_path


def counts(given: Job) -> dict[str, int]:
    body = build_body(given.mesh, given.regions, MPI.COMM_SELF, resolve=given.resolve)
    return {name: region.cell_count for name, region in body.regions.items() if region.cell_count}


def test_values_of_an_array_are_regions(directory: Path) -> None:
    assert counts(job(directory, {"array": "material"})) == {"material-1": 2, "material-2": 1, "material-7": 3}
    names = {"plaque": 2, "wall": [1, 7]}
    by_name = job(directory, {"array": "material", "names": names}, material={"plaque": MATERIAL, "wall": MATERIAL})
    assert counts(by_name) == {"plaque": 1, "wall": 5}
    union = job(directory, {"array": "material"}, regions={"soft": ["material-1", "material-2"]})
    assert counts(union) == {"material-1": 2, "material-2": 1, "material-7": 3, "soft": 3}
    assert not refusals(by_name.data)


@pytest.mark.parametrize(
    ("labels", "message", "advice"),
    [
        (
            {"array": "materal"},
            "mesh.labels: the mesh has no array 'materal'. Did you mean 'material'",
            "material (in cells: 1, 2, 7)",
        ),
        (
            {"array": "height"},
            "mesh.labels: the array 'height' does not have integers",
            "Arrays of integers: material (in cells: 1, 2, 7); wall (in nodes: 0, 1, 2, 3, 4, 5, 6).",
        ),
        (
            {"array": "material", "names": {"plaque": 3}},
            "mesh.labels.names.plaque: no cells of the mesh have the value 3",
            "Its values are 1, 2, 7.",
        ),
    ],
)
def test_unknown_arrays_and_values_are_listed(
    labels: dict[str, Any], message: str, advice: str, directory: Path
) -> None:
    with pytest.raises(MeshError) as refused:
        counts(job(directory, labels))
    assert message in refused.value.message
    assert advice in refused.value.advice


def test_unknown_regions_list_the_arrays(directory: Path) -> None:
    given = job(directory, {"array": "material"}, regions={"soft": ["material-3"]})
    with pytest.raises(MeshError) as refused:
        counts(given)
    assert "no region 'material-3'" in refused.value.message
    assert (
        "Arrays of integers can be regions (mesh.labels: {array: …}): material (in cells: 1, 2, 7); wall (in nodes:"
        in refused.value.advice
    )


def test_labels_of_arrays_are_for_meshes_and_numbers(directory: Path) -> None:
    for labels, message in (
        ({"array": "material", "names": {"plaque": "two"}}, r"mesh\.labels\.names\.plaque: must be"),
        ({"array": "material", "names": {"boundary": 1}}, r"mesh\.labels\.names\.boundary: is the name of another"),
        ({"array": "material", "name": {"a": 1}}, "unknown key"),
    ):
        with pytest.raises(JobError, match=message):
            job(directory, labels)


def test_arrays_of_other_numbers_are_not_labels() -> None:
    assert list(integer_arrays(bar(np.array([0.5, 1.0])))) == ["wall (in nodes: 0, 1, 2)"]
    assert next(integer_arrays(bar(np.arange(20.0)))) == "material (in cells: 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, …)"


def test_values_may_be_in_several_regions_but_materials_not(directory: Path) -> None:
    names = {"plaque": 2, "soft": [1, 2], "stiff": 7}
    labels = {"array": "material", "names": names}
    assert counts(job(directory, labels)) == {"plaque": 1, "soft": 3, "stiff": 3}
    given = job(directory, labels, material=dict.fromkeys(names, MATERIAL))
    body = build_body(given.mesh, given.regions, MPI.COMM_SELF, resolve=given.resolve)
    value = ByRegion({"plaque": 1.0, "soft": 2.0, "stiff": 3.0})
    with pytest.raises(MeshError, match="some cells are in 'soft' and in 'plaque', which are both groups of the mesh"):
        BodyFields(body).function(value, 1.0, "material")
    parts = {"body": ["soft", "stiff"], "rest": ["body", "not plaque"]}
    given = job(directory, labels, material={"plaque": MATERIAL, "rest": MATERIAL}, regions=parts)
    body = build_body(given.mesh, given.regions, MPI.COMM_SELF, resolve=given.resolve)
    assert [len(cells) for cells in law_cells(body, given.laws)] == [1, 5]


def test_cells_without_a_group_have_the_law_elsewhere(directory: Path) -> None:
    labels = {"array": "material", "names": {"plaque": 2, "wall": 7}}  # two cells have the value 1
    given = job(directory, labels, material={"plaque": MATERIAL, "elsewhere": MATERIAL})
    body = build_body(given.mesh, given.regions, MPI.COMM_SELF, resolve=given.resolve)
    assert [len(cells) for cells in law_cells(body, given.laws)] == [1, 5]
    with pytest.raises(MeshError, match=r"material: 2 cells are in none of its regions \(plaque, wall\)"):
        law_cells(body, job(directory, labels, material={"plaque": MATERIAL, "wall": MATERIAL}).laws)


def test_values_in_nodes_are_boundary_facets_and_cells(directory: Path) -> None:
    given = job(directory, {"array": "wall", "names": {"left": 0, "ends": [0, 6], "first": [0, 1]}})
    regions = build_body(given.mesh, given.regions, MPI.COMM_SELF, resolve=given.resolve).regions
    counted = {name: (regions[name].facet_count, regions[name].cell_count) for name in ("left", "ends", "first")}
    assert counted == {"left": (1, 0), "ends": (2, 0), "first": (5, 1)}
    assert "wall-3" not in regions  # no facet of the boundary has only nodes in the middle of the bar
    with pytest.raises(MeshError, match=r"names\.middle: is not at all vertices of any cell or boundary facet"):
        counts(job(directory, {"array": "wall", "names": {"middle": 3}}))


def test_values_in_surface_cells_are_facets(tmp_path: Path) -> None:
    """As meshio writes them: one array for triangles and tetrahedra."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    cells = np.array([4, 0, 1, 2, 3, 3, 0, 1, 2, 3, 0, 1, 3])
    grid = pyvista.UnstructuredGrid(cells, [10, 5, 5], points)
    grid.cell_data["gmsh:physical"] = np.array([1, 1, 4], dtype=np.int32)
    grid.save(tmp_path / "bar.vtu")
    given = job(tmp_path, {"array": "gmsh:physical", "names": {"base": 4}})
    regions = build_body(given.mesh, given.regions, MPI.COMM_SELF, resolve=given.resolve).regions
    assert (regions["base"].facet_count, regions["base"].cell_count) == (1, 0)
    assert (regions["gmsh:physical-1"].facet_count, regions["gmsh:physical-1"].cell_count) == (1, 1)


def test_faces_in_files_of_their_own_are_regions(tmp_path: Path) -> None:
    """As SimVascular's mesh-complete, with coordinates of 7 digits and overlapping faces, for both degrees."""
    block = pyvista.ImageData(dimensions=(3, 3, 3), spacing=(0.1, 0.1, 0.1)).to_tetrahedra(5)
    block.save(tmp_path / "bar.vtu")
    faces = pyvista.UnstructuredGrid(block).extract_surface(algorithm="dataset_surface").triangulate()
    middles = faces.cell_centers().points
    for name, chosen in {
        "inlet": middles[:, 0] < 1e-6,
        "wall": middles[:, 0] > 1e-6,
        "low": middles[:, 2] < 1e-6,
    }.items():
        faces.extract_cells(chosen).extract_surface(algorithm="dataset_surface").save(tmp_path / f"{name}.vtp")
    mesh = {
        "file": "bar.vtu",
        "unit": "mm",
        "faces": {"inlet": "inlet.vtp", "low": "low.vtp", "all": ["inlet.vtp", "wall.vtp"]},
    }
    for degree in (1, 2):
        rest = {"rest": ["boundary", "not inlet", "not low"], "foot": "x < 1e-9 m"}
        given = job(tmp_path, {}, mesh=mesh | {"geometry_degree": degree}, regions=rest)
        regions = build_body(given.mesh, given.regions, MPI.COMM_SELF, resolve=given.resolve).regions
        assert regions["all"].facet_count == regions["boundary"].facet_count == 48
        assert regions["inlet"].facet_count == regions["low"].facet_count == 8
        assert set(regions["inlet"].facets) == set(regions["foot"].facets)
        assert regions["rest"].facet_count == 48 - 16
    assert not refusals(given.data)
    moved = pyvista.read(tmp_path / "inlet.vtp").translate((0.01, 0, 0))
    moved.save(tmp_path / "inlet.vtp")
    with pytest.raises(MeshError, match=r"inlet\.vtp: 8 of 8 triangles of mesh\.faces\.inlet are not facets"):
        counts(given)
    with pytest.raises(JobError, match=r"mesh\.faces\.inlet: .*there is no file"):
        job(tmp_path, {}, mesh=mesh | {"faces": {"inlet": "outlet.vtp"}})


def sizes(source: MeshSource) -> dict[str, tuple[int, int, float]]:
    """Dimension, number of members, and sum of the coordinates of their middles, of each group."""
    middles = {3: source.points[source.cells].mean(axis=1), 2: source.points[source.facets].mean(axis=1)}
    return {g.name: (g.dim, len(g.members), float(middles[g.dim][g.members].sum().round(9))) for g in source.groups}


@pytest.mark.parametrize("suffix", [".msh", ".vtu", ".bp"])
def test_overlapping_groups_are_saved_and_read(suffix: str, tmp_path: Path) -> None:
    ends = {"left": [[0, 2]], "right": [[2, 3]], "ends": [[0, 2], [2, 3]]}
    source = add_facets(bar(np.ones(3)), {name: np.array(rows) for name, rows in ends.items()})
    cells = [Group("all", 3, 7, np.arange(3)), Group("first", 3, 8, np.arange(2))]
    source = dataclasses.replace(source, groups=distinct_tags([*source.groups, *cells]), data={})
    assert source.groups_overlap(2)
    assert source.groups_overlap(3)
    path = tmp_path / f"bar{suffix}"
    if suffix == ".bp":
        write_partitioned(path, MPI.COMM_SELF, partitioned(source, 2)[0])
    else:
        save(path, source, source.points)
    assert sizes(read_source(spec(path), path)) == sizes(source)


@pytest.mark.parallel([2, 3])
def test_overlapping_groups_are_regions_on_several_ranks(comm: MPI.Intracomm, run_directory: Path) -> None:
    source = add_facets(bar(np.ones(6)), {"left": np.array([[0, 2]]), "ends": np.array([[0, 2], [5, 3]])})
    cells = [Group("all", 3, 7, np.arange(6)), Group("first", 3, 8, np.arange(2))]
    source = dataclasses.replace(source, groups=distinct_tags([*source.groups, *cells]), data={})
    path = run_directory / "bar.bp"
    on_root(comm, lambda: write_partitioned(path, MPI.COMM_SELF, partitioned(source, 2)[0]))
    expected = {"left": (1, 0), "ends": (2, 0), "all": (0, 6), "first": (0, 2)}
    for given in (source if comm.rank == 0 else source.header(), None):
        body = build_body(spec(path), {}, comm, replacement=given)
        regions = {name: (body.regions[name].facet_count, body.regions[name].cell_count) for name in expected}
        assert regions == expected


def test_written_files_open_in_meshio(tmp_path: Path) -> None:
    """It refuses VTU files of a version above 1.0."""
    source = bar(np.array([1, 1, 2]))
    save_vtu(tmp_path / "bar.vtu", source, source.points)
    mesh = meshio.read(tmp_path / "bar.vtu")
    assert np.array_equal(mesh.points, source.points)
    assert [(block.type, len(block.data)) for block in mesh.cells] == [("hexahedron", 3)]
    assert mesh.cell_data["material"][0].ravel().tolist() == [1, 1, 2]
