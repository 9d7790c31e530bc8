"""A body on 1, 2 and 3 ranks: who owns what, which facets are in which region, and the order in the file."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.mesh_cases import conditions, spec
from helpers.partitions import facet_sets, input_vertex_sets, owners, slow_edge_cut

from hpcinv.base.parallel.runtime import MPI, on_root
from hpcinv.errors import OutputError
from hpcinv.job.job import load
from hpcinv.job.mesh_section import MeshSpec
from hpcinv.mesh import Body, build_body, read_source, reorder_to_source, write_mesh
from hpcinv.mesh.cells import vertex_count
from hpcinv.mesh.checks import check
from hpcinv.mesh.io.gmsh_model import metis
from hpcinv.preparation import is_cut_held_or_loaded

TWO_BLOCKS = """
def build(gmsh, *, size=0.5):
    occ = gmsh.model.occ
    left, right = occ.addBox(0, 0, 0, 1, 1, 1), occ.addBox(1, 0, 0, 1, 1, 1)
    occ.fragment([(3, left)], [(3, right)])
    occ.synchronize()
    for volume, name in ((left, "left"), (right, "right")):
        gmsh.model.addPhysicalGroup(3, [volume], name=name)
    between = gmsh.model.getEntitiesInBoundingBox(0.9, -1, -1, 1.1, 2, 2, 2)
    gmsh.model.addPhysicalGroup(2, [s for _, s in between], name="interface")
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    gmsh.model.mesh.generate(3)
"""


@pytest.mark.release
@pytest.mark.parallel([1, 2, 3])
def test_each_rank_owns_its_equal_part_by_metis(
    comm: MPI.Intracomm, meshes: Path, record_property: Callable[[str, object], None]
) -> None:
    cases = (
        ("pdms_beam.py", {"length": "8 cm", "size": "3 mm"}, 2),
        ("box.py", {"nx": 8, "ny": 7, "nz": 6}, 1),
        ("box.py", {"nx": 8, "ny": 7, "nz": 6, "hexahedra": True}, 2),
    )
    for file, parameters, degree in cases:
        cut = {}
        for method in ("metis", "scotch"):
            mesh = spec(meshes / file, parameters=parameters, geometry_degree=degree, partition=method)
            body = build_body(mesh, {}, comm)
            cells = body.mesh.topology.index_map(3)
            assert (cells.size_local, cells.num_ghosts) == (body.partition.cells[comm.rank], 0)
            owner = owners(body)
            cut[method] = body.partition.edge_cut

            def against_the_source(body: Body = body, owner: np.ndarray = owner, method: str = method) -> None:
                source = body.source
                assert sum(body.partition.cells) == len(source.cells)
                assert body.partition.edge_cut == slow_edge_cut(source, owner.tolist())
                if method == "metis":
                    assert body.partition.imbalance <= 0.05
                    said = metis(source.cells[:, : vertex_count(source.kind)], source.kind, comm.size)
                    assert np.array_equal(owner, said)

            on_root(comm, against_the_source)
        line = f"{file} {parameters} on {comm.size}: edge cut METIS {cut['metis']}, PT-SCOTCH {cut['scotch']}"
        record_property("edge cut", line)
        if comm.rank == 0:
            print(line)
        assert cut["metis"] <= 1.5 * cut["scotch"]


@pytest.mark.release
@pytest.mark.parallel([1, 2, 3])
def test_regions_hold_the_same_entities_on_any_number_of_ranks(
    comm: MPI.Intracomm, meshes: Path, run_directory: Path
) -> None:
    # A beam: the physical groups, against conditions that say the same.
    same = {"clamp": "x <= 0", "tip": "x >= 182 mm"}
    named = {f"{name}-too": text for name, text in same.items()} | {"half": "x < 91 mm"}
    for degree in (1, 2):
        mesh = spec(meshes / "pdms_beam.py", parameters={"size": "4 mm"}, geometry_degree=degree)
        body = build_body(mesh, conditions(**named), comm)
        for name in same:
            assert np.array_equal(body.facets(name), body.facets(f"{name}-too"))
            assert body.regions[name].facet_count == len(input_vertex_sets(body, 2, body.facets(name))) > 5
        assert comm.allreduce(len(body.cells("silicone"))) == body.regions["silicone"].cell_count
        ends = len(input_vertex_sets(body, 2, np.concatenate([body.facets(n) for n in ("clamp", "tip", "side")])))
        assert ends == body.regions["boundary"].facet_count
        half = input_vertex_sets(body, 3, body.cells("half"))

        def against_the_source(body: Body = body, half: set[frozenset[int]] = half) -> None:
            points, corners = body.source.points, body.source.cells[:, :4]
            inside = (points[corners][..., 0] < 0.091).all(axis=1)
            assert half == {frozenset(c) for c in corners[inside].tolist()}
            count = Counter(f for facets in facet_sets(body.source) for f in facets)
            assert body.regions["boundary"].facet_count == sum(n == 1 for n in count.values())

        on_root(comm, against_the_source)

    # Two blocks: volumes of different name, and a surface inside the body, which ranks on both sides must know.
    generator = run_directory / "blocks.py"
    if comm.rank == 0:
        generator.write_text(TWO_BLOCKS)
    comm.barrier()
    body = build_body(spec(generator), {}, comm)
    inner = input_vertex_sets(body, 2, body.facets("interface"))
    assert len(inner) == body.regions["interface"].facet_count > 4
    x = body.mesh.geometry.x * body.length_scale
    for name, low, high in (("left", 0, 1), ("right", 1, 2)):
        cells = body.cells(name)
        assert len(input_vertex_sets(body, 3, cells)) == body.regions[name].cell_count
        where = x[body.mesh.geometry.dofmaps[0][cells]][..., 0]
        assert np.all((where >= low) & (where <= high))

    def interface_of_the_source() -> None:
        (group,) = (g for g in body.source.groups if g.name == "interface")
        assert inner == {frozenset(f) for f in body.source.facets[group.members].tolist()}
        assert np.all(body.source.points[body.source.facets[group.members]][..., 0] == 1)

    on_root(comm, interface_of_the_source)


@pytest.mark.release
@pytest.mark.parallel([1, 2, 3])
def test_written_meshes_are_read_back_bit_for_bit(comm: MPI.Intracomm, meshes: Path, run_directory: Path) -> None:
    cases = (
        ("pdms_beam.py", {"length": "3 cm", "size": "4 mm"}, 2),
        ("box.py", {"hexahedra": True}, 2),
        ("box.py", {"lx": 1 / 3}, 1),
        ("single_tetrahedron.msh", {}, 1),
    )
    for file, parameters, degree in cases:
        body = build_body(spec(meshes / file, parameters=parameters, geometry_degree=degree), {}, comm)
        assert np.log2(body.length_scale) % 1 == 0
        diagonal = on_root(comm, lambda body=body: np.linalg.norm(np.ptp(body.source.points, axis=0)))
        assert 0.7 < diagonal / body.length_scale < 1.5
        given = body.mesh.geometry.x * body.length_scale
        moved = given + 0.01 * np.sin(7 * given[:, [1, 2, 0]] / body.length_scale) * body.length_scale
        for suffix in (".msh", ".vtu"):
            path = run_directory / f"moved{suffix}"
            write_mesh(path, body, moved)
            again = build_body(spec(path, partition="scotch"), {}, comm)
            assert (again.source.kind, again.source.degree) == (body.source.kind, body.source.degree)
            expected = reorder_to_source(body, moved)
            nodes = reorder_to_source(again, again.mesh.geometry.x * again.length_scale)
            assert len(expected) == len(body.source.points)
            assert (len(expected) == 0) == (comm.rank > 0)
            assert np.array_equal(nodes, expected)
            for array in ("node_tags", "cells", "cell_tags"):
                assert np.array_equal(getattr(again.source, array), getattr(body.source, array)), array
            assert list(run_directory.glob(".*partial*")) == []
            for dim, select in ((2, Body.facets), (3, Body.cells)):
                for group in (g for g in body.source.groups if g.dim == dim):
                    sets = [input_vertex_sets(b, dim, select(b, group.name)) for b in (body, again)]
                    assert sets[0] == sets[1]
            tags = [{(g.name, g.dim, g.tag) for g in b.source.groups} for b in (body, again)]
            assert tags[0] == tags[1]


@pytest.mark.parallel([2])
def test_a_mesh_that_cannot_be_written_is_an_error_on_all_ranks(
    comm: MPI.Intracomm, meshes: Path, run_directory: Path
) -> None:
    body = build_body(spec(meshes / "single_tetrahedron.msh"), {}, comm)
    for suffix in (".msh", ".vtu"):
        with pytest.raises(OutputError, match="cannot be written"):
            write_mesh(run_directory / "none" / f"mesh{suffix}", body, body.mesh.geometry.x)


def test_the_paths_of_a_job_are_resolved_before_reading(comm: MPI.Intracomm, meshes: Path) -> None:
    mesh = MeshSpec.model_validate({"file": "box.py"}, context={"directory": meshes})
    body = build_body(mesh, {}, comm, resolve=lambda file: meshes / file)
    assert body.source.path == meshes / "box.py"


@pytest.mark.release
def test_a_hundred_thousand_cells_are_checked_in_seconds(comm: MPI.Intracomm, meshes: Path) -> None:
    source = read_source(spec(meshes / "box.py", parameters={"nx": 26, "ny": 26, "nz": 26}), meshes / "box.py")
    started = time.perf_counter()
    check(source)
    assert len(source.cells) > 100_000
    assert time.perf_counter() - started < 10


@pytest.mark.parallel([1, 2])
def test_a_cut_on_which_nothing_acts_is_seen(comm: MPI.Intracomm, run_directory: Path) -> None:
    """Half of a ball at the border of an image: its flat side is the region 'cut'."""
    SimpleITK = pytest.importorskip("SimpleITK")

    def write() -> str:
        x, y, z = np.indices((8, 16, 16)) - 7.5
        path = run_directory / "half.mha"
        half = ((x + 7.5) ** 2 + y**2 + z**2 < 49).astype(np.uint8)
        SimpleITK.WriteImage(SimpleITK.GetImageFromArray(half.transpose()), str(path))
        return str(path)

    file = on_root(comm, write)
    sections = {
        "mesh": {"image": file, "labels": {"half": 1}, "size": "4 mm"},
        "material": {"law": "neo-hookean", "young": "5 kPa", "poisson": 0.4},
        "regions": {"side": "x > 4 mm", "flat": "x < 1 mm"},
    }
    held = {"side": False, "flat": True, "cut": True, "boundary": True}
    body: Body | None = None
    for region, acts in held.items():
        job = load(sections | {"supports": [{"region": region, "fix": ["x", "y", "z"]}]})
        body = body or build_body(job.mesh, job.regions, comm, resolve=job.resolve)
        assert is_cut_held_or_loaded(job, body) == acts, region
    push = {"effect": "pressure", "region": "flat", "pressure": "1 Pa"}
    job = load(sections | {"supports": [{"region": "side", "fix": ["x", "y", "z"]}], "effects": [push]})
    assert is_cut_held_or_loaded(job, body)
